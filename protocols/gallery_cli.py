"""``python -m spdz match`` on a gallery's tape: one step, with what is new since the last."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from typing import Any

import numpy as np

from protocols.catalog import GalleryPurpose
from protocols.descriptors import load_descriptors
from protocols.gallery import Gallery
from protocols.memory import in_bytes
from protocols.thresholds import is_hopeless, threshold_warning
from spdz.console.command import say_error
from spdz.console.progress import progress_bar
from spdz.foundations.errors import ChannelError, SpdzError, TapeDestroyed, TapeInUse
from spdz.session import Block, Step

_NAME = "python -m spdz match"


def run_gallery(options: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    gallery = None
    try:
        descriptors = load_descriptors(options.descriptors)
        with progress_bar("comparing", quiet=options.quiet) as progress:
            done = [0]

            def count(block: Block) -> None:
                done[0] += block.results.size
                progress(done[0], done[0])

            gallery = Gallery(
                options.tape,
                options.threshold,
                listen=options.listen,
                connect=options.connect,
                credentials=options.credentials,
                insecure=options.insecure_plain_tcp,
                wait=options.wait,
                timeout=options.timeout,
                state_dir=options.state_dir,
                on_block=count,
                on_event=lambda sentence: say(sentence, options.quiet),
            )
            purpose = GalleryPurpose.from_json(gallery.header.program)
            if warning := threshold_warning(purpose, options.threshold):
                if is_hopeless(purpose, options.threshold):
                    raise ValueError(f"{warning}. A gallery answers its first threshold for ever")
                say(f"warning: {warning}")
            gallery.check(descriptors)
            unfinished, held = gallery.unfinished, 0 if options.append else gallery.holds(descriptors)
            new = len(descriptors) - held
            gallery.require_room(new)
            say(f"{gallery.rule}: looking for {gallery.header.peer} for {options.wait:g} s", options.quiet)
            with closing(gallery):
                gallery.connect()
                if unfinished:
                    say("an earlier run was interrupted: this one goes on where it was", options.quiet)
                if held:
                    say(f"the gallery holds {held} of these descriptors, {new} are new", options.quiet)
                gallery.add(descriptors[held:])
                started = time.perf_counter()
                step = gallery.step()
                seconds = time.perf_counter() - started
                every = list(gallery.results())
                earlier = every if options.all else step.blocks
                hidden = len(Step(blocks=every).matches) - len(Step(blocks=step.blocks).matches)
                if hidden > 0 and not options.all and purpose.reveal == "bit":
                    say(f"{hidden} matches of earlier runs are not shown: --all", options.quiet)
                try:
                    more = {"slots_left": gallery.room, "ms": round(seconds * 1e3, 3)}
                    _print(options, gallery, step, earlier, more)
                finally:
                    gallery.finish()
    except (SpdzError, ValueError, OSError, KeyboardInterrupt) as error:
        if gallery is not None:
            gallery.abandon(error)
        _print_failure(options, gallery, error)
        if isinstance(error, KeyboardInterrupt):
            raise
        unusable = gallery is None and not isinstance(error, (TapeInUse, TapeDestroyed))
        return 1 if isinstance(error, SpdzError) and not unusable else 2
    return 0


def say(sentence: str, quiet: bool = False) -> None:
    """Tell the user something that is no result."""
    if not quiet:
        print(sentence, file=sys.stderr, flush=True)


def _print_failure(options: argparse.Namespace, gallery: Gallery | None, error: BaseException) -> None:
    """Print what there is, and why there is no more."""
    kind, message = type(error).__name__, str(error) or "stopped before the end"
    step = gallery.partial if gallery is not None else None
    if gallery is not None and step is not None and isinstance(error, (ChannelError, KeyboardInterrupt)):
        say("run it again on both robots: it goes on where it was", options.quiet)
    if gallery is not None and step is not None and (step.blocks or options.json):
        more = {"error": kind, "message": message} if options.json else {}
        _print(options, gallery, step, step.blocks, more)
        if options.json:
            return
    if not isinstance(error, KeyboardInterrupt) or options.json:
        text = message if options.json else f"{kind}: {message}"
        say_error(_NAME, kind, text, as_json=options.json)


def _print(
    options: argparse.Namespace,
    gallery: Gallery,
    step: Step,
    blocks: Sequence[Block],
    more: dict[str, Any],
) -> None:
    """Print results, or what there is of them."""
    header = gallery.header
    purpose = GalleryPurpose.from_json(header.program)
    bits, pairs = purpose.reveal == "bit", sum(block.results.size for block in blocks)
    found = Step(blocks=list(blocks)).matches if bits else []
    if options.json:
        summary = {
            "robot": header.name,
            "peer": header.peer,
            "security": header.security,
            "score": purpose.score,
            "threshold": options.threshold,
            "resolution": purpose.step_text,
            "new": step.own,
            "peer_new": step.peer,
            "decided": pairs,
            **step.stats.as_dict(),
            **more,
        }
        print(json.dumps(summary | ({"matches": found} if bits else {"scores": _scores(blocks)})))
        return
    for own, peer in found:
        print(f"match: {header.name} {own}  {header.peer} {peer}")
    if not bits:
        for own, peer, score in _scores(blocks):
            print(f"{header.name} {own}  {header.peer} {peer}: {score:.6g}")
    if not step.blocks:
        print("nothing was compared: there was no new pair")
    if bits and blocks:
        so_far = " so far" if options.all and "ms" in more else ""
        print(f"{len(found)} of {pairs} pairs match{so_far} ({gallery.rule}, {header.security})")
    spent = f"{more['ms']:.1f} ms, " if "ms" in more else ""
    new = f"{len(step.own)} new here and {len(step.peer)} there"
    left = f"; {more['slots_left']} of {header.capacity[header.party]} slots left" if "ms" in more else ""
    print(f"{spent}{in_bytes(step.stats.bytes_sent)} sent, {step.stats.rounds} rounds; {new}{left}")


def _scores(blocks: Sequence[Block]) -> list[tuple[int, int, float]]:
    """Own slot, the peer's slot and the score of every pair."""
    return [
        (block.own.start + int(i), block.peer.start + int(j), float(score))
        for block in blocks
        for (i, j), score in np.ndenumerate(block.results)
        if np.isfinite(score)
    ]
