"""A ledger's facts, and a model of a gallery that keeps them in plain sets."""

import copy
import hashlib
import random
import struct
from pathlib import Path

from spdz.gallery.ledger import Ledger
from spdz.gallery.strip import Strip

TAPE = "beef"


def open_ledger(folder: Path, party: int = 0, **options) -> Ledger:
    folder.mkdir(exist_ok=True)
    return Ledger.open(folder / "t.ledger", TAPE, party, **{"state_dir": folder / "state", **options})


def mark_of(folder: Path) -> Path:
    return folder / "state" / f"{TAPE}-0.gallery"


def head(owner, slots):
    """The chained hash over slots, written out once more."""
    result = hashlib.sha256(f"spdz gallery head {owner} {TAPE}".encode()).digest()
    for slot, eps in enumerate(slots):
        digest = bytes(32) if eps is None else hashlib.sha256(eps).digest()
        result = hashlib.sha256(result + struct.pack("<Q", slot) + bytes([eps is None]) + digest).digest()
    return result


def facts(ledger: Ledger) -> dict[str, object]:
    """All that a ledger tells, read anew."""
    found: dict[str, object] = {}
    for owner, slots in enumerate(ledger.slots):
        found[f"eps {owner}"] = slots.eps(0, slots.filled)
        found[f"void {owner}"] = slots.voids
        found[f"notes {owner}"] = [slots.noted(slot) for slot in range(slots.filled)]
        found[f"heads {owner}"] = [slots.head(count) for count in range(slots.filled + 1)]
    found["text"], found["done"], found["flight"] = ledger.text, ledger.done, ledger.flight
    found["results"], found["burnt"] = list(ledger.results()), ledger.burnt()
    return found


class Model:
    """What a ledger should hold."""

    def __init__(self):
        self.eps = ([], [])
        self.notes = ([], [])
        self.text = None
        self.done = (0, 0)
        self.flight = None
        self.strips = []  # (strip, results or None), in order

    def facts(self):
        found = {}
        for owner in (0, 1):
            eps = self.eps[owner]
            found[f"eps {owner}"] = eps
            found[f"void {owner}"] = [slot for slot, held in enumerate(eps) if held is None]
            found[f"notes {owner}"] = [
                None if held is None else note for held, note in zip(eps, self.notes[owner], strict=True)
            ]
            found[f"heads {owner}"] = [head(owner, eps[:count]) for count in range(len(eps) + 1)]
        found["text"], found["done"], found["flight"] = self.text, self.done, self.flight
        found["results"] = [entry for entry in self.strips if entry[1] is not None]
        found["burnt"] = [strip for strip, results in self.strips if results is None]
        return found

    def copy(self):
        return copy.deepcopy(self)

    def apply(self, action, *values):
        """One operation; the names are those of ``run``."""
        if action == "fill":
            owner, entries, *text = values
            self.text = text[0] if text else self.text
            self.eps[owner].extend(eps for _, eps in entries)
            self.notes[owner].extend(None for _ in entries)
        elif action == "void":
            owner, slots = values
            for slot in slots:
                self.eps[owner][slot] = None
        elif action == "note":
            self._note(values[0])
        elif action == "pin_text":
            (self.text,) = values
        elif action == "begin":
            self.flight, *notes = values
            self._note(*notes)
        else:
            strip, results = (*values, None)[:2]
            self.strips.append((strip, results))
            self.done = max(self.done[0], strip.rows.stop), max(self.done[1], strip.columns.stop)
            self.flight = None

    def _note(self, notes=({}, {})):
        for owner, new in enumerate(notes):
            for slot, note in new.items():
                self.notes[owner][slot] = note

    def restored(self, backup):
        """What is left of this when a backup was copied back."""
        left = backup.copy()
        left.text = self.text
        for owner in (0, 1):
            for slot, (eps, note) in enumerate(zip(self.eps[owner], self.notes[owner], strict=True)):
                if slot >= len(left.eps[owner]):
                    left.eps[owner].append(None)
                    left.notes[owner].append(None)
                elif eps is None or note != left.notes[owner][slot]:
                    left.eps[owner][slot] = None
        rows, columns = self.done
        if left.done == (0, 0) and rows:
            left.strips.append((Strip(range(rows), range(columns)), None))
        elif rows:
            if rows > left.done[0]:
                left.strips.append((Strip(range(left.done[0], rows), range(left.done[1])), None))
            if columns > left.done[1]:
                left.strips.append((Strip(range(rows), range(left.done[1], columns)), None))
        left.done = self.done
        if self.flight != backup.flight or self.flight is None:
            left.flight = None
            if self.flight is not None:
                left.apply("burn", self.flight)
        return left

    def random_action(self, rng: random.Random):
        """Something that an honest caller may do now, or None."""
        owner = rng.randrange(2)
        filled = len(self.eps[owner])
        kind = rng.choice(["fill", "fill", "fill", "void", "note", "pin_text", "begin", "finish", "burn"])
        if kind == "fill":
            eps = [None if rng.random() < 0.1 else rng.randbytes(20) for _ in range(rng.randint(1, 3))]
            text = (rng.randbytes(9),) if self.text is None and rng.random() < 0.1 else ()
            return "fill", owner, list(enumerate(eps, filled)), *text
        if kind == "void" and filled and rng.random() < 0.5:
            return "void", owner, rng.sample(range(filled), rng.randint(1, min(2, filled)))
        if kind == "note":
            notes = self._random_notes(rng)
            return ("note", notes) if any(notes) else None
        if kind == "pin_text" and self.text is None:
            return "pin_text", rng.randbytes(9)
        if kind == "finish" and self.flight is not None:
            return "commit", self.flight, rng.randbytes(4)
        if kind == "burn" and self.flight is not None:
            return "burn", self.flight
        if kind in ("begin", "burn") and self.flight is None and self.text is not None:
            rows, columns = (
                rng.randint(done, len(eps)) for done, eps in zip(self.done, self.eps, strict=True)
            )
            if 0 in self.done:
                strip = Strip(range(rows), range(columns)) if rows and columns else None
            elif rng.random() < 0.5:
                strip = Strip(range(self.done[0], rows), range(self.done[1])) if rows > self.done[0] else None
            else:
                strip = (
                    Strip(range(self.done[0]), range(self.done[1], columns))
                    if columns > self.done[1]
                    else None
                )
            if kind == "begin" and strip and rng.random() < 0.5:
                return kind, strip, self._random_notes(rng)
            return strip and (kind, strip)
        return None

    def _random_notes(self, rng):
        """Notes of a slot or none of each party."""
        notes = []
        for eps, held in zip(self.eps, self.notes, strict=True):
            free = [slot for slot, note in enumerate(held) if eps[slot] is not None and note is None]
            some = free and rng.random() < 0.7
            notes.append({rng.choice(free): rng.randbytes(5)} if some else {})
        return tuple(notes)


def run(ledger: Ledger, action, *values):
    """Do one operation of :meth:`Model.apply` on a ledger."""
    if action in ("fill", "void"):
        owner, *rest = values
        getattr(ledger.slots[owner], action)(*rest)
    else:
        getattr(ledger, action)(*values)


def random_actions(seed: int, number: int):
    """A sequence of operations that an honest caller may do."""
    rng, model, actions = random.Random(seed), Model(), []
    while len(actions) < number:
        action = model.random_action(rng)
        if action is not None:
            actions.append(action)
            model.apply(*action)
    return actions
