"""The dealer's command for galleries: ``--slots``."""

from __future__ import annotations

import argparse
import json
import time

from dealer import gallery_report as report
from dealer.gallery_mission import deal_galleries, gallery_mission_bytes
from dealer.gallery_plan import gallery_cost
from dealer.options import note
from dealer.words import each_pair, in_seconds
from protocols.catalog import GalleryPurpose, parse_resolution
from protocols.memory import in_bytes
from protocols.thresholds import resolution_warning
from spdz.console.progress import progress_bar

_DEFAULT = GalleryPurpose("S10", 1)
_LARGE = 100e6
_ZERO_IS_NEAR = ("S2", "S3", "S4", "S5", "S6")


def run(options: argparse.Namespace) -> None:
    """Plan or deal.

    Raises:
        ValueError: for bad input, or what there is no room for.
        OSError: if the folders cannot be written.
    """
    purpose = _purpose(options)
    for text in _advice(options, purpose):
        note(options, text)
    if options.plan:
        _show(options, purpose)
    else:
        _deal(options, purpose)


def _purpose(options: argparse.Namespace) -> GalleryPurpose:
    bits = _DEFAULT.resolution if options.resolution is None else parse_resolution(options.resolution)
    return GalleryPurpose(
        score=options.score,
        dim=options.dim,
        reveal=options.reveal,
        max_norm=_DEFAULT.max_norm if options.max_norm is None else options.max_norm,
        resolution=bits,
        min_norm=_DEFAULT.min_norm if options.min_norm is None else options.min_norm,
        proof=not options.no_norm_proof,
    )


def _advice(options: argparse.Namespace, purpose: GalleryPurpose) -> list[str | None]:
    malicious = options.security == "malicious"
    norm = near = unproved = None
    if options.max_norm is None:
        norm = "for descriptors of norm at most 1; --max-norm R gives another largest norm"
    if malicious and purpose.proof and purpose.score in _ZERO_IS_NEAR and not purpose.min_norm:
        near = (
            f"a short vector is near to all in {purpose.score}, and a peer may bring one: --min-norm R has "
            "every descriptor proved to be no shorter than R, at no cost"
        )
    if malicious and not purpose.proof:
        unproved = "norms are not proved: a peer may probe with vectors of any length"
    return [norm, near, unproved, resolution_warning(purpose)]


def _show(options: argparse.Namespace, purpose: GalleryPurpose) -> None:
    cost = gallery_cost((options.agents[0], options.agents[1]), purpose, options.slots, options.security)
    total = gallery_mission_bytes(options.agents, purpose, options.slots, options.security)
    if options.json:
        print(report.as_json(cost, purpose, options.security, total), flush=True)
        return
    for line in report.as_text(cost, purpose, options.security, options.agents, total):
        print(line, flush=True)


def _deal(options: argparse.Namespace, purpose: GalleryPurpose) -> None:
    started = time.perf_counter()
    size = gallery_mission_bytes(options.agents, purpose, options.slots, options.security)
    if size > _LARGE:
        note(options, f"writing about {in_bytes(size)} in all")
    with progress_bar("dealing", quiet=options.quiet) as progress:
        dealt = deal_galleries(
            options.out, options.agents, purpose, options.slots, options.security, progress=progress
        )
    seconds = time.perf_counter() - started
    if options.json:
        fields = {
            **purpose.as_json(),
            "slots": list(options.slots),
            "capacity": list(dealt.capacity),
            "pairs": dealt.pairs,
            "security": options.security,
            "seconds": round(seconds, 3),
            "bytes": {str(folder): size for folder, size in dealt.folders.items()},
        }
        print(json.dumps(fields))
        return
    rows, columns = dealt.capacity
    print(
        f"dealt a gallery of {rows:,} x {columns:,} descriptors {each_pair(dealt.pairs)}, "
        f"{options.security}, in {in_seconds(seconds)}"
    )
    for folder, size in dealt.folders.items():
        print(f"  {folder}: {in_bytes(size)}")
    print(report.enough_for(options.agents, options.slots))
    print("copy each folder to its robot, and keep no other copy of it")
