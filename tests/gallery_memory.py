"""A gallery dealt to files, read back by both parties, filled and compared in this process."""

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from dealer.gallery import deal_gallery
from dealer.gallery_trial import Both, Couple, Streams
from spdz.foundations.errors import Unsent
from spdz.gallery import GalleryTape
from spdz.readings.gallery import Terms
from spdz.readings.records import slot_stream
from spdz.readings.sections import encode_sections
from spdz.session.pairs import read_pairs

DELTA = 16  # bytes of a slot's pad that are its Delta


class TwoTapes:
    """Both parties' tapes, open."""

    def __init__(self, stack: ExitStack, folder: Path, terms: Terms, slots: tuple[int, int]) -> None:
        paths = folder / "0.tape", folder / "1.tape"
        deal_gallery(paths, ("alice", "bob"), terms, slots)
        states = [folder / f"state {party}" for party in (0, 1)]
        opened = [GalleryTape.open(path, state_dir=at) for path, at in zip(paths, states, strict=True)]
        self.tapes = [stack.enter_context(tape) for tape in opened]
        self.terms = terms
        alphas = tuple(int.from_bytes(tape.alpha, "little") for tape in self.tapes)
        self.couple = Couple(terms, alphas if terms.security == "malicious" else None)

    def slot_streams(self, owner: int, numbers: range) -> Streams:
        """What either party draws for slots."""
        first, second = ([tape.slot(owner, i) for i in numbers] for tape in self.tapes)
        return _slots(first), _slots(second)

    def pair_streams(self, rows: range, columns: range) -> Streams:
        """What either party draws for a rectangle, cut out of the tiles that it reaches over."""
        first, second = (read_pairs(tape, rows, columns) for tape in self.tapes)
        return first, second

    def fill(self, owner: int, vectors: np.ndarray, start: int = 0) -> Both:
        """Fill slots from ``start`` on; all norms must be proved."""
        data = encode_sections(self.terms.sections, vectors)
        numbers = range(start, start + len(data))
        slots, proved = self.couple.fill(owner, data, self.slot_streams(owner, numbers))
        assert (
            proved is None if not self.terms.proves else proved.shape == (len(data), len(self.terms.sections))
        )
        if proved is not None and not proved.all():
            raise AssertionError(f"{proved} of the norms are proved")
        return slots

    def compare(self, rows: Both, columns: Both, at: tuple[int, int] = (0, 0)) -> np.ndarray:
        """Compare slots from ``at`` on."""
        where = (range(start, start + side[0].count) for start, side in zip(at, (rows, columns), strict=True))
        return np.asarray(self.couple.compare(rows, columns, self.pair_streams(*where)))


def _slots(records):
    pads = np.stack([record.pad for record in records])
    corrections = np.stack([np.frombuffer(record.correction, np.uint8) for record in records])
    deltas = np.ascontiguousarray(pads[:, :DELTA]).view("<u8")
    return slot_stream(pads[:, DELTA:], corrections, deltas, [record.hash_key for record in records])


def run_gallery(folder: Path, terms: Terms, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Deal, fill and compare all of x with all of y. Where a mask does not suit its vector, once more."""
    for attempt in range(5):
        with ExitStack() as stack:
            tapes = TwoTapes(stack, folder / str(attempt), terms, (len(x), len(y)))
            try:
                return tapes.compare(tapes.fill(0, x), tapes.fill(1, y))
            except Unsent:
                continue
    raise AssertionError("no mask suits")
