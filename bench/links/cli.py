"""``python -m bench links``: what a comparison takes over the links that robots have."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bench.links.emulation import VIAS, carried, congestion_control, enter_namespace, inside, possible
from bench.links.link import LINKS, Link
from bench.links.measuring import Cell, Figures, LinkError, measure_link
from bench.recorded import recorded
from protocols.scores import SCORES
from spdz.console.command import CommandParser, run_command, say_error
from spdz.console.progress import progress_bar

_NAME = "python -m bench links"
_EPILOG = """\
links (a rate and a queue of 1,000 packets each direction; the delay is ONE WAY, the round trip twice that):
{links}
  own         what --rate, --delay and --loss say

columns:
  ms          one comparison, from floats to the opened and (malicious) checked result, until the slower party
              has it, both starting together: the median of the trials
  most        the longest of the trials: lost packets show there first
  floor       the same frames, in sizes and order, over the same link in bare Python, with nothing computed
  plain       both send their descriptor as it is and compute in the clear
  MP-SPDZ >=  from the bytes and rounds that were recorded of it (bench/recorded.json), on this link, without
              any computing:  calls / 2 x delay + bytes x 8 / rate.  It counts every call to send, receive or
              broadcast, and an exchange is at most two calls. Headers, slow start and losses are left out, so
              it favours MP-SPDZ. -: this length was not recorded

how a link is emulated (--via; auto takes the first that this machine allows):
  netem       the kernel's emulator, in a network namespace that the command makes for itself (unshare, tc)
  tun         the same namespace, and packets held by this program between two addresses: where the kernel has
              no netem. In both, TCP runs over the link: slow start, lost packets sent again, delayed
              acknowledgements. Its congestion control is CUBIC, or Reno where a namespace has only that
  proxy       where no namespace may be made: a forwarder of TCP on loopback holds what was written. TCP does
              not see the link: no slow start, and NO LOSS: a lossy link is then measured as if it lost
              nothing, and its row says loss 0

Each link is probed first: the measured round trip is printed, and a link that is quicker than it should be
is refused. TCP is plain, as in `python -m bench`. Few trials: --trials at most, and fewer where --seconds
would be exceeded. All links with the ten scores take about ten minutes.

examples:
  python -m bench links
  python -m bench links --link satellite lossy --score S10 S4 --security malicious --json
  python -m bench links --rate 5 --delay 80 --loss 0.01 --score S10 --dim 16 8192
"""


@dataclass(frozen=True, slots=True)
class LinkRow:
    """One comparison over one link. Times are in milliseconds; ``delay_ms`` is one way.

    Attributes:
        loss: The share of packets lost in each direction, 0 where the emulation cannot lose any.
        via: How the link was emulated.
        congestion: How TCP probed for the rate.
        round_trip_ms: The link's measured round trip.
        ms: Median of a comparison, until the slower party has the result.
        max_ms: The longest of the trials.
        floor_ms: The same frames over the same link in bare Python.
        plain_ms: The plaintext exchange of the same length over the same link.
        mp_spdz_least_ms: A lower bound for MP-SPDZ on this link, where its bytes and rounds were recorded.
    """

    link: str
    mbit: float
    delay_ms: float
    loss: float
    via: str
    congestion: str | None
    round_trip_ms: float
    score: str
    n: int
    security: str
    trials: int
    ms: float
    max_ms: float
    floor_ms: float
    plain_ms: float
    mp_spdz_least_ms: float | None
    bytes_sent: int
    rounds: int


def mp_spdz_least(link: Link, score: str, n: int, security: str) -> float | None:
    """What MP-SPDZ takes at least over a link, in milliseconds, without computing; None if not recorded."""
    least = [
        link.least_ms(figure.rounds / 2, figure.bytes_sent)
        for figure in recorded(score, n, security)
        if figure.engine.startswith("MP-SPDZ") and figure.rounds is not None
    ]
    return round(min(least), 3) if least else None


def cells_of(options: argparse.Namespace) -> list[Cell]:
    """The plaintext exchange of every length, and then what was asked for."""
    asked = [
        Cell(score, n, security)
        for n in options.dim
        for score in options.score
        for security in options.security
    ]
    return [Cell("S10", n, None) for n in options.dim] + asked


def parser() -> argparse.ArgumentParser:
    """The arguments of ``python -m bench links``."""
    links = "\n".join(
        f"  {link.name:12}{link.mbit:g} Mbit/s, {link.delay_ms:g} ms, {link.loss:.0%} loss: {link.what}"
        for link in LINKS.values()
    )
    arguments = CommandParser(
        prog=_NAME,
        description="Measure a comparison over links that robots have, beside what the link alone takes.",
        epilog=_EPILOG.format(links=links),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    both = ["malicious", "semi-honest"]
    add("--link", nargs="+", choices=LINKS, metavar="LINK", help=f"{', '.join(LINKS)} (all)")
    add("--rate", type=float, metavar="MBIT", help="of a link of your own, in Mbit/s")
    add("--delay", type=float, metavar="MS", help="its delay one way (0)")
    add("--loss", type=float, metavar="SHARE", help="its share of lost packets, 0.02 for 2 %% (0)")
    add("--score", nargs="+", default=list(SCORES), choices=SCORES, metavar="S", help="score functions (all)")
    add("--dim", nargs="+", type=int, default=[1536], metavar="N", help="descriptor lengths (1536)")
    add("--security", nargs="+", default=both, choices=both, help="default: both")
    add("--via", choices=("auto", *VIAS), default="auto", help="how links are emulated (auto)")
    add("--trials", type=int, default=10, help="counted comparisons at most (10)")
    add("--seconds", type=float, default=4.0, help="for the trials of a cell, at most, if above one (4)")
    add("--seed", type=int, default=1, help="seed of the descriptors (1)")
    add("--json", action="store_true", help="one JSON object a line")
    return arguments


def links_of(options: argparse.Namespace) -> list[Link]:
    """The links that were asked for.

    Raises:
        ValueError: if there is no such link.
    """
    own = []
    if options.rate is not None:
        own = [Link("own", options.rate, options.delay or 0.0, options.loss or 0.0)]
    elif options.delay is not None or options.loss is not None:
        raise ValueError("--delay and --loss are of a link of your own: give its --rate too")
    named = options.link if options.link is not None else () if own else LINKS
    return [*(LINKS[name] for name in named), *own]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    arguments = parser()
    options = arguments.parse_args(words)
    if min(options.dim) < 1 or options.trials < 1 or options.seed < 0 or not options.seconds > 0:
        arguments.error("--trials, --dim and --seconds must be positive, and --seed not negative")
    try:
        links = links_of(options)
    except ValueError as error:
        arguments.error(str(error))
    return run_command(_NAME, lambda: _run(options, links, words), as_json=options.json)


def _run(options: argparse.Namespace, links: Sequence[Link], words: Sequence[str]) -> int:
    via = inside()
    if via is None:
        asked = VIAS if options.via == "auto" else (options.via,)
        via = next((one for one in asked if possible(one)), None)
        if via is None:
            message = f"this machine does not let you emulate links by {options.via}: leave out --via"
            say_error(_NAME, "LinkError", message, as_json=options.json)
            return 2
        if via != "proxy":
            enter_namespace(via, words)
    try:
        _measure(options, links, via)
    except (LinkError, OSError, RuntimeError) as error:
        say_error(_NAME, type(error).__name__, str(error), as_json=options.json)
        return 1
    return 0


def _measure(options: argparse.Namespace, links: Sequence[Link], via: str) -> None:
    cells = cells_of(options)
    generator = np.random.default_rng(options.seed)
    inputs: dict[int, tuple[Any, Any]] = {}
    for n in options.dim:
        x, y = generator.standard_normal((2, n))
        inputs[n] = x / np.linalg.norm(x), y / np.linalg.norm(y)
    with progress_bar("links", quiet=options.json) as report:
        for number, link in enumerate(links):
            telling = _Telling(carried(link, via), link, via, options.json)

            def on_cell(
                cell: Cell, figures: Figures, trip: float, at: int = number, telling: _Telling = telling
            ) -> None:
                telling.tell(cell, figures, trip)
                report(at * len(cells) + telling.told, len(links) * len(cells))

            measure_link(link, via, cells, inputs, on_cell, most=options.trials, seconds=options.seconds)


class _Telling:
    """Prints the rows of one link as they come."""

    def __init__(self, link: Link, asked: Link, via: str, as_json: bool) -> None:
        self._link, self._asked, self._via, self._as_json = link, asked, via, as_json
        self._plain: dict[int, float] = {}
        self.told = 0

    def tell(self, cell: Cell, figures: Figures, trip: float) -> None:
        """Print a cell; the plaintext exchanges come first and are kept for the others' rows."""
        if not self.told and not self._as_json:
            self._head(trip)
        self.told += 1
        if cell.security is None:
            self._plain[cell.n] = figures.ms
            return
        row = self._row(cell, figures, trip)
        if self._as_json:
            print(json.dumps(asdict(row)), flush=True)
            return
        least = "-" if row.mp_spdz_least_ms is None else f"{row.mp_spdz_least_ms:.1f}"
        print(f"{row.score:6}{row.n:6}  {row.security:12}{row.ms:10.1f}{row.max_ms:10.1f}", end="")
        print(
            f"{row.floor_ms:10.1f}{row.plain_ms:10.1f}{least:>12}{row.bytes_sent:9}{row.rounds:8}{row.trials:8}",
            flush=True,
        )

    def _row(self, cell: Cell, figures: Figures, trip: float) -> LinkRow:
        link, security = self._link, str(cell.security)
        return LinkRow(
            link=link.name,
            mbit=link.mbit,
            delay_ms=link.delay_ms,
            loss=link.loss,
            via=self._via,
            congestion=congestion_control(),
            round_trip_ms=trip,
            score=cell.score,
            n=cell.n,
            security=security,
            trials=figures.trials,
            ms=figures.ms,
            max_ms=figures.max_ms,
            floor_ms=figures.floor_ms,
            plain_ms=self._plain[cell.n],
            mp_spdz_least_ms=mp_spdz_least(link, cell.score, cell.n, security),
            bytes_sent=figures.bytes_sent,
            rounds=figures.rounds,
        )

    def _head(self, trip: float) -> None:
        link = self._link
        print(
            f"{link.name}: {link.mbit:g} Mbit/s, {link.delay_ms:g} ms one way, {link.loss:.0%} loss", end=""
        )
        print(f", by {self._via}, TCP {congestion_control()}; measured round trip {trip:.1f} ms")
        if self._asked.loss and not link.loss:
            print(f"  its loss of {self._asked.loss:.0%} is NOT emulated: TCP would have to see it")
        print(f"{'score':6}{'N':>6}  {'security':12}{'ms':>10}{'most':>10}{'floor':>10}{'plain':>10}", end="")
        print(f"{'MP-SPDZ >=':>12}{'bytes':>9}{'rounds':>8}{'trials':>8}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
