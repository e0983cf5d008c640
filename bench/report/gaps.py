"""How the figures came about, and what is missing of them, in sentences."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator

from bench.recorded_ratios import recorded_ratios
from bench.report import ratios
from bench.report.cells import MODELS, Key
from bench.report.folder import Results
from bench.report.paper import ENGINE
from bench.sweep.cells import PROTOCOLS, SIZES
from protocols.scores import SCORES


def run_words(results: Results) -> str:
    """By what command, of what commit, when and where it was measured."""
    about, machine = results.about, results.about["machine"]
    commit = about.get("commit") or "an unknown commit"
    dirty = " with changes that were not committed" if about.get("dirty") else ""
    told = [f"{machine.get('cpu')}, {machine.get('cores')} cores, {machine.get('system')}"]
    told += [f"{name} {machine[name]}" for name in ("python", "numpy", "spdz") if machine.get(name)]
    told.append(machine.get("compiler") or "no C++ compiler")
    errors = [cell.error for cell in results.cells.values() if cell.protocol in MODELS]
    known = [error for error in errors if error is not None]
    far = f" No score was further from the clear one than {max(known):.1e}." if known else ""
    return (
        f"Measured by `{about['command']}` at {commit}{dirty}, begun {about.get('started')}, ended "
        f"{about.get('finished') or 'not yet'}, on {'; '.join(told)}. {about['trials']} trials a cell.{far}"
    )


def gap_words(results: Results) -> Iterator[str]:
    """What of the paper's sweep was not run, or not to its end; nothing of a whole one."""
    quick = "A quick run. " if results.about["quick"] else ""
    missing = results.missing()
    if missing:
        whole = len(PROTOCOLS) * len(SIZES) * len(SCORES)
        yield (
            f"{quick}{len(missing)} of {whole} cells were not run: {cell_words(missing)}. Nothing stands in "
            "their place."
        )
    short = results.short()
    if short:
        yield f"With fewer than {results.about['trials']} trials: {cell_words(short)}."


def product_words(results: Results) -> Iterator[str]:
    """How ratios of time are to be taken, and which products there are."""
    base = recorded_ratios().base[:7]
    yield (
        "Bytes and rounds compare exactly. Times were recorded on other machines and compare roughly; the "
        "product of two ratios, each measured within one run on one machine, compares better."
    )
    if results.versus_base is None:
        command = f"python -m bench versus {base}"
        yield f"The product was not measured: run `{command}` with this folder as `--out`."
        return
    if not ratios.same_base(results):
        yield (
            f"versus.json compares with {results.versus_base}; {ENGINE} was recorded beside {base}, so that "
            "there is no product."
        )
        return
    both = (results.versus_commit, results.about.get("commit"))
    ours, swept = (commit or "unknown" for commit in both)
    if not (ours.startswith(swept) or swept.startswith(ours)):  # one of them may be short
        yield f"versus.json is of {ours[:7]}, the sweep of {swept[:7]}."
    found = {(row.security, row.score, row.n) for row in results.versus}
    wanted = [(security, score, n) for score, n, security in recorded_ratios().ratios]
    absent = [key for key in wanted if key not in found]
    if absent:
        yield f"Without a product, since versus.json lacks them: {cell_words(absent)}."
    yield ratios.smallest(results)


def cell_words(keys: Iterable[Key]) -> str:
    """Cells in words, those with the same scores and lengths together."""
    scores: dict[tuple[str, int], list[str]] = defaultdict(list)
    for protocol, score, n in keys:
        scores[protocol, n].append(score)
    lengths: dict[tuple[str, str], list[int]] = defaultdict(list)
    for (protocol, n), names in sorted(scores.items(), key=lambda item: item[0][1]):
        names.sort(key=list(SCORES).index)
        words = "all scores" if len(names) == len(SCORES) else " ".join(names)
        lengths[protocol, words].append(n)
    protocols: dict[str, list[str]] = defaultdict(list)
    for protocol in PROTOCOLS:
        words = ", ".join(
            f"{names} at {'all N' if tuple(sizes) == SIZES else 'N = ' + ' '.join(map(str, sizes))}"
            for (name, names), sizes in lengths.items()
            if name == protocol
        )
        if words:
            protocols[words].append(protocol)
    return "; ".join(f"{', '.join(names)}: {words}" for words, names in protocols.items())
