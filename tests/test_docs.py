"""The documentation: its examples run, its links and names exist, and it names what there is to name."""

import argparse
import dataclasses
import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bench.accuracy
import bench.agents.cli
import bench.attacks.cli
import bench.attacks.insider
import bench.attacks.paths
import bench.attacks.probes
import bench.attacks.scans
import bench.check.cli
import bench.cli
import bench.gallery
import bench.gallery_pairs
import bench.links.cli
import bench.oracle
import bench.recorded_accuracy
import bench.report.cli
import bench.sweep.cli
import bench.sweep.results
import bench.versus
import dealer.cli
import protocols.check
import spdz
import spdz.__main__
from bench.parties import free_port
from spdz.foundations import errors

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")])
WITH_EXAMPLES = [ROOT / "README.md", *(ROOT / "docs" / f"{p}.md" for p in ("tutorial", "how-to", "scores"))]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FOREIGN_OPTIONS = {
    "--help",
    "--version",
    "--protocol",
    "--tls-ca-file",
    "--nthreads",
    "--nworkers",
}  # of Dask
_AGENT = "spdz agent "
ERRORS = [key for key, item in vars(errors).items() if isinstance(item, type)]


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def read(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def prose(page: Path) -> str:
    """A page without its fenced blocks."""
    return FENCE.sub("", read(page))


def blocks(page: Path, language: str) -> list[str]:
    return [body for kind, body in FENCE.findall(read(page)) if kind == language]


def code_spans(page: Path) -> list[str]:
    return re.findall(r"`([^`\n]+)`", prose(page))


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def run_commands(commands: list[str], folder: Path) -> str:
    """Run a page's commands in order; agents, and a listening robot and who calls it, run together."""
    waiting: list[tuple[str, subprocess.Popen[str]]] = []
    outputs = []
    for command, after in zip(commands, [*commands[1:], ""], strict=True):
        program, *arguments = shlex.split(command)
        assert program == "python", command
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        process = subprocess.Popen([sys.executable, *arguments], cwd=folder, text=True, **pipes)
        waiting.append((command, process))
        if "--listen" in arguments or (_AGENT in command and _AGENT in after):
            continue
        for shown, running in waiting:
            try:
                output, _ = running.communicate(timeout=60)
            finally:
                running.kill()
            assert running.returncode == 0, f"{shown}\n{output}"
            outputs.append(output)
        waiting = []
    assert not waiting, "a robot listens and nobody connects"
    return "\n".join(outputs)


class Printed:
    """Stands for ``print`` in a page's blocks and keeps what each line of them prints."""

    def __init__(self) -> None:
        self.lines: dict[tuple[str, int], list[str]] = {}

    def __call__(self, *things: object) -> None:
        caller = sys._getframe(1)
        place = caller.f_code.co_filename, caller.f_lineno
        self.lines.setdefault(place, []).append(" ".join(map(str, things)))


def shown(comment: str) -> tuple[str, bool] | None:
    """The output that a comment behind a ``print`` shows, and whether all of it; None if it only explains.

    Output begins as a number, a list, a truth value or a score's name does. It ends at dots, which stand for
    the rest, or where an explanation begins: a comma or a colon, and a word.
    """
    if not re.match(r"-?\d|[\[({]|True\b|False\b|S\d", comment):
        return None
    output, dots, _ = comment.partition("...")
    return (output, False) if dots else (re.split(r"[,:] (?=[a-z])", comment)[0], True)


def wrong_comments(source: str, block: str, printed: Printed) -> list[str]:
    """Lines ``print(...)  # output`` of a block that has run, where the output was another."""
    wrong = []
    for number, line in enumerate(source.splitlines(), 1):
        found = re.fullmatch(r"\s*print\(.*\)  # (.*)", line)
        expected = shown(found[1]) if found else None
        if expected is not None:
            text = ", ".join(printed.lines.get((block, number), ["nothing"]))
            output, whole = expected
            if text != output if whole else not text.startswith(output):
                wrong.append(f"{block}: {line.strip()}, but it prints {text}")
    return wrong


def follow(page: Path, folder: Path) -> None:
    """Run a page in a folder: Python blocks share one namespace, commands run where they stand between them.

    What a comment behind a ``print`` shows is printed there; lines ``match: ...`` and ``verified: ...`` are
    printed by a command.
    """
    shown_by_python = Printed()
    namespace: dict[str, object] = {"__name__": "example", "print": shown_by_python}
    ran, printed = 0, ""
    for number, (language, body) in enumerate(FENCE.findall(read(page))):
        source = body
        for address in ("127.0.0.1:9000", "127.0.0.1:9001"):
            source = source.replace(address, f"127.0.0.1:{free_port()}")
        if language == "python":
            block = f"{name(page)}, block {number}"
            exec(compile(source, block, "exec"), namespace)
            assert wrong_comments(source, block, shown_by_python) == []
        elif language == "bash":
            printed += run_commands(source.splitlines(), folder)
        ran += language in ("python", "bash")
    assert ran >= 4
    for line in re.findall(r"match: \w+ \d+  \w+ \d+|^verified: .+$", read(page), re.MULTILINE):
        assert line in printed


@pytest.mark.parametrize(
    ("comment", "output"),
    [
        ("0.96001..., the score", ("0.96001", False)),
        ("True, and nothing else", ("True", True)),
        ("5: input, opening", ("5", True)),
        ("[[1 2]]", ("[[1 2]]", True)),
        ("{'a': 1, 'b c': 2}", ("{'a': 1, 'b c': 2}", True)),
        ("S2 [1, 2], S8 [3, 4]", ("S2 [1, 2], S8 [3, 4]", True)),
        ("several numbers near 0.96", None),
        ("Trueish", None),
    ],
)
def test_output_is_told_from_explanation(comment, output):
    assert shown(comment) == output


@pytest.mark.parametrize(
    ("line", "right"),
    [
        ("print(1 / 3)  # 0.333..., a third", True),
        ("print(1 / 3)  # 0.334..., a third", False),
        ("print(True, 5)  # True 5", True),
        ("print(True, 5)  # True", False),
        ("for i in range(2):\n    print(i, [i])  # 0 [0], 1 [1]", True),
        ("for i in range(2):\n    print(i, [i])  # 0 [0]", False),
        ("if 0:\n    print(0)  # 0", False),
        ("print(0)  # whatever", True),
    ],
)
def test_a_comment_that_shows_other_output_is_found(line, right):
    printed = Printed()
    exec(compile(line, "block", "exec"), {"print": printed})
    assert (wrong_comments(line, "block", printed) == []) is right


@pytest.mark.timeout(600)
def test_all_pages_can_be_followed_in_one_clone_and_leave_nothing_that_git_would_show(tmp_path, monkeypatch):
    clone = tmp_path / "clone"
    clone.mkdir()
    shutil.copy(ROOT / ".gitignore", clone)
    monkeypatch.chdir(clone)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    for page in WITH_EXAMPLES:
        follow(page, clone)
    assert len(list(clone.iterdir())) > len(WITH_EXAMPLES)
    assert git_shows(clone) == {".gitignore"}


def git_shows(folder: Path) -> set[str]:
    """What git would show as new in a folder, going by its ``.gitignore`` alone."""
    if shutil.which("git") is None:
        pytest.skip("git is not installed")
    nobody = os.environ | {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1"}
    git = ["git", "-C", str(folder)]
    subprocess.run([*git, "init", "--quiet", "--template="], env=nobody, check=True)
    status = subprocess.run(
        [*git, "status", "--porcelain"], env=nobody, check=True, capture_output=True, text=True
    )
    return {line.removeprefix("?? ") for line in status.stdout.splitlines()}


def test_no_two_commands_of_the_pages_deal_into_one_folder_and_git_ignores_each(tmp_path):
    shutil.copy(ROOT / ".gitignore", tmp_path)
    folders = [folder for page in WITH_EXAMPLES for folder in re.findall(r"--out (\S+)", read(page))]
    assert len(folders) == len(set(folders)) >= 3
    for folder in [*folders, "demo-output", "attacks-output"]:
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "file").touch()
    assert git_shows(tmp_path) == {".gitignore"}


@pytest.mark.parametrize("page", WITH_EXAMPLES, ids=name)
def test_examples_are_short(page):
    for block in blocks(page, "python"):
        assert block.count("\n") <= 40, block


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_relative_link_leads_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.is_file(), target
        if anchor:
            assert anchor in anchors(there), target


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_file_and_module_that_is_named_exists(page):
    for span in code_spans(page):
        if re.fullmatch(r"(?:spdz|protocols|dealer|bench|tests|docs)/[\w./-]+", span):
            assert (ROOT / span).exists(), span
        elif re.match(r"(?:spdz|protocols|dealer|bench)\.[\w.]+(?:\(|$)", span):
            resolve(span.partition("(")[0])


def resolve(dotted: str) -> object:
    """Import a module or fetch an attribute of one; raises if there is none."""
    module, _, attribute = dotted.rpartition(".")
    try:
        return importlib.import_module(dotted)
    except ModuleNotFoundError:
        return getattr(importlib.import_module(module), attribute)


def known_options() -> set[str]:
    """Every option of every command."""
    commands = spdz.__main__.parser()
    (subparsers,) = (one for one in commands._actions if isinstance(one, argparse._SubParsersAction))
    parsers = [dealer.cli.parser(), bench.cli.parser(), bench.gallery.parser()]
    parsers += [bench.accuracy.parser(), bench.agents.cli.parser(), bench.attacks.cli.parser()]
    parsers += [bench.oracle.parser(), bench.report.cli.parser(), bench.sweep.cli.parser()]
    parsers += [bench.links.cli.parser(), bench.versus.parser(), bench.check.cli.parser()]
    parsers += [commands, *subparsers.choices.values()]
    return {option for one in parsers for action in one._actions for option in action.option_strings}


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_option_that_is_named_exists(page):
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", read(page)))
    assert named - known_options() - FOREIGN_OPTIONS == set()


def test_the_reference_names_every_option():
    named = set(re.findall(r"--[a-z][a-z-]*", read(ROOT / "docs" / "reference.md")))
    assert {option for option in known_options() if option.startswith("--")} - named <= FOREIGN_OPTIONS


def test_the_reference_names_everything_public():
    text = read(ROOT / "docs" / "reference.md")
    section = text.partition("### Package `spdz`")[2].partition("###")[0]
    entries = re.findall(r"`(?:await )?(\w+)", " ".join(re.findall(r"^\|([^|]*)\|", section, re.MULTILINE)))
    tree = text.partition("## Errors")[2].partition("## ")[0]
    assert set(spdz.__all__) - set(ERRORS) <= set(entries)
    assert set(ERRORS) <= set(re.findall(r"\w+", tree))


def test_the_reference_names_every_field_of_the_benchmark_and_every_counter():
    spans = set(code_spans(ROOT / "docs" / "reference.md"))
    rows = (bench.cli.Row, bench.gallery_pairs.GalleryRow, bench.accuracy.AccuracyRow, bench.oracle.OracleRow)
    attacks = (
        bench.attacks.paths.PathRow,
        bench.attacks.scans.ScanRow,
        bench.attacks.probes.ProbeRow,
        bench.attacks.insider.RefusalRow,
    )
    sweep = (bench.sweep.results.Trial, bench.sweep.results.About)
    links = (bench.links.cli.LinkRow, bench.versus.VersusRow)
    described = (protocols.check.Standing, protocols.check.Form, protocols.check.Norms)
    for kind in (
        *rows,
        *attacks,
        *sweep,
        *links,
        *described,
        bench.recorded_accuracy.RecordedRow,
        spdz.Stats,
    ):
        assert {field.name for field in dataclasses.fields(kind)} <= spans


def test_how_to_says_what_to_do_about_every_error():
    rows = re.findall(r"^\| `(\w+)` \|", read(ROOT / "docs" / "how-to.md"), re.MULTILINE)
    assert set(ERRORS) - {"SpdzError", "TapeError"} <= set(rows)


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "decisions").glob("*.md")), ids=name)
def test_decision_records_are_short_and_say_what_follows(page):
    text = read(page)
    assert text.count("\n") < 25
    for part in ("**Context.**", "**Decision.**", "**Consequences.**"):
        assert part in text
