"""``python -m spdz check``: how a user's own descriptors stand, before the mission."""

from __future__ import annotations

import argparse
import json
import textwrap
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from protocols.check.description import NEIGHBOURS, describe
from protocols.check.percent import percent
from protocols.check.standing import Form, Standing
from protocols.descriptors import load_descriptors
from protocols.scores import SCORES
from spdz.console.command import say_error

_WIDTH = 100
_EPILOG = """\
A candidate bit hides a descriptor only as far as nobody can guess it, and that is a property of your
descriptors. Give those of a whole drive, in the order in which they were taken, and with --foreign some
thousands of the same kind from another place: they stand for what anybody has who wants to guess yours.

What is told:
  effective dimension   (sum of the covariance's eigenvalues)^2 / (sum of their squares), from pairs of rows
                        that are no neighbours: N if descriptors differ in all their numbers alike, 5 if in
                        five directions. The smaller, the fewer bits it takes to guess one
  matches               how often at the threshold: a random unit vector; an all-equal one; a descriptor of
                        another place; two of your own that are no neighbours (places visited twice count)
  probe bits            to a guess of cosine 0.9 after a first match, by cos^2 = t^2 + 0.64 (1 - t^2) bits / d
                        with d the effective dimension; python -m bench attacks --only probes holds it against
                        a prober
  mean subtracted, whitened   the same if a public mean were subtracted, or the descriptors whitened (by the
                        inverse root of their covariance plus 0.3 of its mean variance), and then normalised.
                        Learnt from half of the foreign descriptors, else from half of your own
  thresholds            where one makes sense, whatever your data's labels: from what one pair in 10^4 of
                        different places reaches, to what half of the direct neighbours do

examples:
  python -m spdz check keyframes.npy --threshold 0.8 --foreign other-city.npy
  python -m spdz check keyframes.npy --score S6 --threshold 0.25 --max-norm 2 --json
Nothing leaves this machine. Exit status: 0, or 2 for bad input.
"""


def add_check(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the ``check`` command."""
    arguments = commands.add_parser(
        "check",
        help="how your own descriptors stand: norms, how easily they are guessed, thresholds",
        description="Say how descriptors stand before they are compared privately.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("descriptors", type=Path, metavar="DESCRIPTORS.npy", help="array of shape (n, N), in their order")
    add("--foreign", type=Path, metavar="OTHER.npy", help="the same kind, of another place: shape (m, N)")
    add("--score", default="S10", choices=SCORES, metavar="S", help="S1 to S10 (S10)")
    add("--threshold", type=float, metavar="T", help="of a match (default: the laxest that makes sense)")
    add("--max-norm", type=float, default=1.0, metavar="R", help="largest norm you would deal for (1)")
    add(
        "--neighbours",
        type=int,
        default=NEIGHBOURS,
        metavar="K",
        help=f"rows at most so far apart may show one place ({NEIGHBOURS})",
    )
    add("--plot", type=Path, metavar="FILE", help="write the scores as a picture (needs matplotlib)")
    add("--json", action="store_true", help="one JSON object on standard output")
    arguments.set_defaults(run=run_check)


def run_check(options: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    try:
        if options.neighbours < 0:
            raise ValueError("--neighbours is not negative")
        own = load_descriptors(options.descriptors)
        foreign = None if options.foreign is None else load_descriptors(options.foreign)
        standing = describe(
            own,
            foreign=foreign,
            score=options.score,
            threshold=options.threshold,
            max_norm=options.max_norm,
            neighbours=options.neighbours,
        )
        if options.plot is not None:
            from protocols.check.picture import draw

            draw(options.plot, own, foreign, standing, options.neighbours)
    except ImportError:
        message = "--plot needs matplotlib: python -m pip install matplotlib"
        say_error("python -m spdz check", "ImportError", message, as_json=options.json)
        return 2
    except (ValueError, OSError) as error:
        say_error("python -m spdz check", type(error).__name__, str(error), as_json=options.json)
        return 2
    if options.json:
        print(json.dumps({"file": str(options.descriptors), **asdict(standing)}))
    else:
        print(f"{options.descriptors}: {standing.count} descriptors of {standing.dim} numbers")
        print("\n".join(_lines(standing)))
    return 0


def _lines(standing: Standing) -> Iterator[str]:
    norms = standing.norms
    yield f"  norms             {norms.least:.4g} to {norms.most:.4g}, median {norms.median:.4g}"
    needs = f"; these need --max-norm {norms.advised:g}" if norms.outside else ""
    yield f"                    {norms.outside} outside --max-norm {norms.max_norm:g}{needs}"
    yield (
        f"  damaged           {standing.unusable} with NaN or infinity, {standing.zero} all zero, "
        f"{standing.duplicates} equal to an earlier one"
    )
    yield (
        f"  rounding          to 2^-16 moves a score by {standing.rounding:.2g} at most; "
        f"{percent(standing.vanished)} of the numbers vanish"
    )
    if standing.threshold is not None:
        source = "" if standing.threshold_given else " (none was given: the laxest that makes sense)"
        yield f"  threshold         {standing.score}, {standing.threshold:.4g}{source}"
    yield f"  mean, covariance  from {standing.statistics_of}"
    yield ""
    yield f"  {'':37}{'as they are':>18}{'mean subtracted':>19}{'whitened':>19}"
    forms = (standing.as_is, standing.centred, standing.whitened)
    yield _row("effective dimension", [f"{form.effective_dimension:.0f}" for form in forms])
    if standing.threshold is not None:
        yield _row("a random unit vector matches", [_share(form.random) for form in forms])
        yield _row("an all-equal vector matches", [_share(form.equal) for form in forms])
        yield _row("a foreign descriptor matches", [_share(form.foreign) for form in forms])
        yield _row("own ones match that are no neighbours", [_share(form.own) for form in forms])
        yield _row("probe bits to cosine 0.9", [_bits(form) for form in forms])
    yield _row("thresholds that make sense", [_ends(form) for form in forms])
    if standing.threshold is None:
        yield "  no threshold makes sense as they are: give --threshold to see how often they match"
    yield ""
    for sentence in standing.advice:
        yield textwrap.fill(
            f"{sentence[0].upper()}{sentence[1:]}", _WIDTH, initial_indent="- ", subsequent_indent="  "
        )


def _row(name: str, cells: list[str]) -> str:
    return f"  {name:37}{cells[0]:>18}{cells[1]:>19}{cells[2]:>19}"


def _share(share: float | None) -> str:
    return "-" if share is None else percent(share)


def _bits(form: Form) -> str:
    return "-" if form.bits is None else f"{form.bits:.0f}"


def _ends(form: Form) -> str:
    return "none" if form.thresholds is None else " to ".join(f"{end:.4g}" for end in form.thresholds)
