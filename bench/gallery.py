"""``python -m bench gallery``: many descriptors against many that stand, masked once and sent once."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from bench import gallery_tapes as tapes
from bench.gallery_new import NewRow, measure_new
from bench.gallery_pairs import GalleryRow, TileRow, measure_pairs
from bench.gallery_stream import StreamRow, measure_stream
from bench.recorded_batch import recorded_batches
from protocols.catalog import GalleryPurpose, parse_resolution
from spdz.console.command import CommandParser, run_command
from spdz.console.progress import progress_bar

_EPILOG = """\
Two processes on this machine, pinned to a core each where the system allows it, over TLS on loopback. Tapes
are dealt into a temporary folder, by one process on one core. Descriptors are random unit vectors, half of
those of the second side near one of the first, about the threshold. The score is the inner product (S10).

three questions:
  (nothing more)            all pairs of --rows and --columns descriptors that both sides hold masked already,
                            until the bits are checked and durable. A gallery's pairs are used once, so every
                            trial has a gallery of its own; one more, not counted, warms up
  --new 1 --stored 5000     a keyframe comes, and so many of the other robot's stand: how long until it is
                            masked, sent, proved and compared with all of them. And the memory that takes
  --stream 3 --seconds 600  so many keyframes a second on either side, all compared with all: do the robots
                            keep up, with what delay, and what memory do they take in the end

what is printed:
  pairs/s      of the slower process, the median trial
  B/pair       bytes that a party sends for a pair, and that the larger tape stores for it
  B/descr.     the same for a descriptor, the proof of its norm included
  dealt/s      pairs that one core deals in a second, slots included
  differ       decisions unlike the clear ones by more than the resolution: must be 0

--compare also runs the same pairs as jobs, tile by tile (`python -m spdz match`), in turn with the galleries,
and prints recorded figures of other engines. Those come from another machine: bytes compare exactly, times
roughly.

examples:
  python -m bench gallery --dim 1536 --rows 256 --columns 256 --security malicious semi-honest --compare
  python -m bench gallery --rows 256 --columns 256 --resolution exact --json
  python -m bench gallery --new 1 --stored 5000
  python -m bench gallery --stream 3 --seconds 600
"""


def parser() -> argparse.ArgumentParser:
    """The arguments of ``python -m bench gallery``."""
    arguments = CommandParser(
        prog="python -m bench gallery",
        description="Measure many descriptors against many that stand, masked once and sent once.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("--dim", type=int, default=1536, metavar="N", help="descriptor length (1536)")
    add("--rows", type=int, default=256, help="descriptors of one side (256)")
    add("--columns", type=int, default=256, help="descriptors of the other (256)")
    add("--security", nargs="+", default=["malicious"], choices=("malicious", "semi-honest"))
    add("--resolution", default="2^-16", metavar="R", help="2^-16 (default), another, or exact")
    add("--threshold", type=float, default=0.8, help="of the decisions (0.8)")
    add("--trials", type=int, default=3, help="counted galleries, or counted arrivals of --new (3)")
    add("--no-proof", action="store_true", help="do not prove the norms of descriptors")
    add("--seed", type=int, default=1, help="seed of the descriptors (1)")
    add("--new", type=int, metavar="K", help="keyframes that come at a time, against --stored")
    add("--stored", type=int, default=5000, help="descriptors that stand, for --new (5000)")
    add("--stream", type=float, metavar="RATE", help="keyframes a second on either side")
    add("--seconds", type=float, default=60.0, help="of --stream (60)")
    add("--compare", action="store_true", help="the same as jobs, and recorded figures of other engines")
    add("--json", action="store_true", help="one JSON object a line")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    arguments = parser()
    options = arguments.parse_args(argv)
    counts = [options.dim, options.rows, options.columns, options.trials, options.stored]
    if min(counts) < 1 or options.seed < 0 or (options.new is not None and options.new < 1):
        arguments.error("lengths, numbers and --trials must be positive, and --seed not negative")
    if options.stream is not None and not (options.stream > 0 and options.seconds > 0):
        arguments.error("--stream and --seconds must be positive")
    if options.new is not None and options.stream is not None:
        arguments.error("--new and --stream are two questions: ask one at a time")
    try:
        resolution = parse_resolution(options.resolution)
        purpose = GalleryPurpose("S10", options.dim, resolution=resolution, proof=not options.no_proof)
        asked = [tapes.Asked(purpose, options.threshold, one, options.seed) for one in options.security]
        for one in asked:
            _ = one.terms  # raises for what cannot be asked
        return run_command("python -m bench gallery", lambda: _run(options, asked), as_json=options.json)
    except ValueError as error:
        arguments.error(str(error))


def _run(options: argparse.Namespace, asked: Sequence[tapes.Asked]) -> int:
    measure = _stream if options.stream is not None else _pairs if options.new is None else _new
    for one in asked:
        measure(options, one)
    return 0


def _pairs(options: argparse.Namespace, asked: tapes.Asked) -> None:
    with progress_bar(asked.security, quiet=options.json) as report:
        row, tiles = measure_pairs(
            asked,
            (options.rows, options.columns),
            options.trials,
            tiles=options.compare,
            report=report,
        )
    others = _beside(row) if options.compare else []
    if options.json:
        extra = {"tiles": None if tiles is None else asdict(tiles), "recorded": others}
        print(json.dumps({**asdict(row), **(extra if options.compare else {})}), flush=True)
    else:
        _print_pairs(row, tiles, others)


def _beside(row: GalleryRow) -> list[dict[str, Any]]:
    """Figures of the same length, and what a paper printed of another."""
    return [
        figure.beside(1e6 / row.pairs_per_s, row.bytes_per_pair)
        for figure in recorded_batches()
        if figure.security == row.security and (figure.n == row.n or figure.rows is None)
    ]


def _print_pairs(row: GalleryRow, tiles: TileRow | None, others: Sequence[dict[str, Any]]) -> None:
    print(
        f"{row.security}, N = {row.n}, {row.rows} x {row.columns}, resolution {row.resolution}: "
        f"{row.pairs_per_s:,.0f} pairs/s, {1e6 / row.pairs_per_s:.2f} us a pair (best "
        f"{1e6 / row.best_pairs_per_s:.2f})"
    )
    print(
        f"  B/pair {row.bytes_per_pair:g} sent, {row.tape_bytes_per_pair:g} stored; B/descr. "
        f"{row.bytes_per_descriptor:,.0f} sent, {row.tape_bytes_per_descriptor:,} stored "
        f"({row.tape_bytes_per_descriptor_unproved:,} without proof); dealt/s {row.dealt_pairs_per_s:,.0f}; "
        f"differ {row.differ}",
        flush=True,
    )
    if tiles is not None:
        print(
            f"  {'as jobs, ' + 'x'.join(map(str, tiles.tile)):36}{1e6 / tiles.pairs_per_s:9.2f} us"
            f"{tiles.bytes_per_pair:10.0f} B  {tiles.time_factor:.1f} x time, stored "
            f"{tiles.tape_bytes_per_pair:.0f} B",
            flush=True,
        )
    for other in others:
        size = "-" if other["rows"] is None else f"{other['rows']} x {other['columns']}"
        sent = "-" if other["bytes_per_pair"] is None else f"{other['bytes_per_pair']:.0f}"
        factor = "" if other["bytes_factor"] is None else f", {other['bytes_factor']:,.0f} x bytes"
        print(
            f"  {other['engine'] + ', ' + other['protocol']:36}{other['us_per_pair']:9.2f} us{sent:>10} B  "
            f"{other['time_factor']:,.1f} x time{factor} (N = {other['n']}, {size})",
            flush=True,
        )


def _new(options: argparse.Namespace, asked: tapes.Asked) -> None:
    with progress_bar(asked.security, quiet=options.json) as report:
        row = measure_new(asked, options.new, options.stored, options.trials, report=report)
    others = _one_row(row) if options.compare else []
    if options.json:
        print(json.dumps({**asdict(row), **({"recorded": others} if options.compare else {})}), flush=True)
        return
    print(
        f"{row.security}, N = {row.n}, {row.new} new against {row.stored}, resolution {row.resolution}: "
        f"{row.median_ms:.1f} ms ({row.min_ms:.1f} to {row.max_ms:.1f}), of which {row.comparing_ms:.1f} for "
        f"comparing; {row.bytes_sent:,} bytes sent; memory {row.max_rss_mb[0]:.0f} and "
        f"{row.max_rss_mb[1]:.0f} MB at most; differ {row.differ}",
        flush=True,
    )
    for other in others:
        name = f"{other['engine']}, {other['protocol']}"
        print(
            f"  {name:36}{other['us_per_pair_one_row']:9.1f} us a pair, {other['time_factor']:,.0f} x time",
            flush=True,
        )


def _one_row(row: NewRow) -> list[dict[str, Any]]:
    ours = row.median_ms * 1e3 / (row.new * row.stored)
    return [
        {**asdict(figure), "time_factor": round(figure.us_per_pair_one_row / ours, 1)}
        for figure in recorded_batches()
        if (figure.security, figure.n) == (row.security, row.n) and figure.us_per_pair_one_row is not None
    ]


def _stream(options: argparse.Namespace, asked: tapes.Asked) -> None:
    def show(row: StreamRow) -> None:
        if options.json:
            print(json.dumps(asdict(row)), flush=True)
            return
        print(
            f"{row.security:12}{row.second:8.0f} s{row.keyframes:8}{row.pairs:12,} pairs  backlog "
            f"{row.backlog:4}  delay {row.delay_ms[0]:7.0f}{row.delay_ms[1]:7.0f}{row.delay_ms[2]:7.0f} ms  "
            f"memory {row.rss_mb[0]:5.0f}{row.rss_mb[1]:5.0f} MB",
            flush=True,
        )

    if not options.json:
        print("delay: median, 95 %, largest of the keyframes since the line before; keyframes of both sides")
    measure_stream(
        asked,
        options.stream,
        options.seconds,
        dealing=progress_bar(f"{asked.security}: dealing", quiet=options.json),
        on_row=show,
    )


if __name__ == "__main__":
    sys.exit(main())
