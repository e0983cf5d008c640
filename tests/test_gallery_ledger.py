import os
import random
import shutil
import sqlite3
import stat
import subprocess
import sys
import threading
import time

import pytest
from ledger_helpers import TAPE, Model, facts, head, mark_of, open_ledger, run

from spdz.foundations.errors import TapeDamaged, TapeDestroyed, TapeError, TapeInUse, TapeMismatch
from spdz.gallery.ledger import Ledger
from spdz.gallery.mark_file import MarkFile
from spdz.gallery.strip import Strip

TEXT = b"S10 at 0.8"
A, B, C = b"a" * 30, b"b" * 30, b"c" * 30


@pytest.fixture(autouse=True)
def no_sync(quick_disk, monkeypatch):
    monkeypatch.setattr("spdz.gallery.store._SETTINGS", ("synchronous=OFF",))


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "gallery"


@pytest.fixture
def ledger(folder):
    with open_ledger(folder) as ledger:
        yield ledger


def fill(ledger, rows, columns, start=(0, 0)):
    for owner, count in enumerate((rows, columns)):
        entries = [(start[owner] + k, b"%d %d" % (owner, start[owner] + k)) for k in range(count)]
        ledger.slots[owner].fill(entries)


def strip(rows, columns):
    return Strip(range(*rows), range(*columns))


def restore(folder, backup):
    shutil.copy(backup, folder / "t.ledger")


def backup(folder, name="backup"):
    return shutil.copy(folder / "t.ledger", folder / name)


def test_new_ledger_is_empty(ledger, folder):
    assert facts(ledger) == Model().facts()
    assert not ledger.rolled_back
    assert mark_of(folder).exists()


def test_everything_survives_closing(folder):
    with open_ledger(folder) as ledger:
        ledger.slots[0].fill([(0, A), (1, None), (2, B)])
        ledger.slots[1].fill([(0, C)])
        ledger.note(({2: b"proof", 0: b""}, {}))
        ledger.pin_text(TEXT)
        ledger.begin(strip((0, 2), (0, 1)))
        ledger.commit(strip((0, 2), (0, 1)), b"yes")
        ledger.begin(strip((2, 3), (0, 1)))
        before = facts(ledger)
        assert before["eps 0"] == [A, None, B]
        assert before["notes 0"] == [b"", None, b"proof"]
        assert (before["done"], before["flight"]) == ((2, 1), strip((2, 3), (0, 1)))
    with open_ledger(folder) as ledger:
        assert facts(ledger) == before
        assert not ledger.rolled_back


def test_heads_are_chained_over_number_void_and_bytes(ledger):
    ledger.slots[0].fill([(0, A), (1, None)])
    ledger.slots[0].fill([(2, bytes(32))])
    ledger.slots[1].fill([(0, A)])
    assert [ledger.slots[0].head(k) for k in range(4)] == [
        head(0, [A, None, bytes(32)][:k]) for k in range(4)
    ]
    assert ledger.slots[1].head(1) == head(1, [A]) != ledger.slots[0].head(1)
    for count in (-1, 4):
        with pytest.raises(ValueError, match="has filled 3 slots"):
            ledger.slots[0].head(count)


def test_both_parties_name_the_same_heads(tmp_path):
    with open_ledger(tmp_path / "0") as one, open_ledger(tmp_path / "1", party=1) as two:
        for ledger in (one, two):
            fill(ledger, 2, 3)
        for owner, count in ((0, 2), (1, 3)):
            assert one.slots[owner].head(count) == two.slots[owner].head(count)


@pytest.mark.parametrize("slots", [[0], [2], [-1], [1, 3], [1, 1], [2, 1]])
def test_slots_are_filled_in_order_and_once(ledger, slots):
    ledger.slots[0].fill([(0, A)])
    before = facts(ledger)
    with pytest.raises(ValueError, match="the next of party 0 is 1"):
        ledger.slots[0].fill([(slot, B) for slot in slots])
    assert facts(ledger) == before


def test_filling_nothing_writes_nothing(ledger, folder):
    before = mark_of(folder).read_bytes()
    ledger.slots[0].fill([])
    ledger.slots[0].void([])
    ledger.note(({}, {}))
    assert mark_of(folder).read_bytes() == before


def test_void_slots_stay_void_and_change_the_heads_as_if_always_void(ledger, folder):
    fill(ledger, 4, 1)
    ledger.note(({1: b"n"}, {}))
    ledger.slots[0].void([2, 1])
    kept = [b"0 0", None, None, b"0 3"]
    assert ledger.slots[0].eps(0, 4) == kept
    assert ledger.slots[0].voids == [1, 2]
    assert ledger.slots[0].noted(1) is None
    assert [ledger.slots[0].head(k) for k in range(5)] == [head(0, kept[:k]) for k in range(5)]
    with pytest.raises(ValueError, match="takes no note"):
        ledger.note(({1: b"n"}, {}))
    before = mark_of(folder).read_bytes()
    ledger.slots[0].void([1])
    assert mark_of(folder).read_bytes() == before


@pytest.mark.parametrize("slot", [-1, 2])
def test_slots_that_are_not_filled_have_nothing(ledger, slot):
    fill(ledger, 2, 2)
    slots = ledger.slots[1]
    for use in (
        lambda: slots.void([slot]),
        lambda: ledger.note(({}, {slot: b""})),
        lambda: slots.noted(slot),
        lambda: slots.eps(slot, slot + 1),
    ):
        with pytest.raises(ValueError, match=rf"slot {slot} of party 1 is not filled: 2 are"):
            use()


def test_note_is_kept_for_ever(ledger):
    fill(ledger, 2, 0)
    ledger.note(({0: b"x"}, {}))
    ledger.note(({0: b"x", 1: b"y"}, {}))
    with pytest.raises(TapeMismatch, match="slot 0 of party 0"):
        ledger.note(({0: b"z"}, {}))
    assert [ledger.slots[0].noted(slot) for slot in (0, 1)] == [b"x", b"y"]


def test_notes_of_both_parties_and_the_strip_after_them_are_one_step(ledger, folder):
    fill(ledger, 2, 2)
    ledger.pin_text(TEXT)
    before = sequence(folder)
    ledger.begin(strip((0, 2), (0, 2)), ({0: b"x"}, {1: b"y"}))
    assert sequence(folder) == before + 1
    assert ledger.flight == strip((0, 2), (0, 2))
    ledger.note(({1: b"z"}, {0: b"z"}))
    assert sequence(folder) == before + 2
    assert [[slots.noted(slot) for slot in (0, 1)] for slots in ledger.slots] == [[b"x", b"z"], [b"z", b"y"]]
    ledger.begin(strip((0, 2), (0, 2)), ({0: b"x"}, {}))
    ledger.note(({0: b"x"}, {}))
    assert sequence(folder) == before + 2


def test_refused_notes_or_strips_change_nothing(ledger, folder):
    fill(ledger, 2, 2)
    ledger.note(({}, {1: b"y"}))
    before = sequence(folder), facts(ledger)
    with pytest.raises(ValueError, match="pin what"):
        ledger.begin(strip((0, 2), (0, 2)), ({0: b"x"}, {}))
    assert (sequence(folder), facts(ledger)) == before
    ledger.pin_text(TEXT)
    before = sequence(folder), facts(ledger)
    for error, which, notes in (
        (TapeMismatch, strip((0, 2), (0, 2)), ({0: b"x"}, {1: b"z"})),
        (ValueError, strip((0, 2), (0, 2)), ({0: b"x"}, {2: b"z"})),
        (ValueError, strip((0, 3), (0, 2)), ({0: b"x"}, {})),
    ):
        with pytest.raises(error):
            ledger.begin(which, notes)
        assert (sequence(folder), facts(ledger)) == before


def test_text_is_pinned_in_the_step_that_fills(ledger, folder):
    before = sequence(folder)
    ledger.slots[0].fill([(0, A)], text=TEXT)
    assert (sequence(folder), ledger.text, ledger.slots[0].filled) == (before + 1, TEXT, 1)
    with pytest.raises(TapeMismatch, match="pinned to another"):
        ledger.slots[0].fill([(1, A)], text=b"another")
    assert ledger.slots[0].filled == 1
    ledger.slots[0].fill([], text=TEXT)
    assert sequence(folder) == before + 1


def test_text_is_pinned_even_if_nothing_is_filled_with_it(ledger):
    ledger.slots[0].fill([], text=TEXT)
    assert (ledger.text, ledger.slots[0].filled) == (TEXT, 0)


def sequence(folder):
    """How many durable steps there were."""
    return MarkFile(folder / "state", TAPE, 0).read().sequence


def test_text_is_pinned_once(folder):
    with open_ledger(folder) as ledger:
        with pytest.raises(ValueError, match="at most 65536 bytes"):
            ledger.pin_text(bytes(65537))
        ledger.pin_text(TEXT)
        ledger.pin_text(TEXT)
    with open_ledger(folder) as ledger:
        with pytest.raises(TapeMismatch, match="pinned to another program, threshold or resolution"):
            ledger.pin_text(b"S10 at 0.7")
        assert ledger.text == TEXT


def test_no_strip_begins_before_the_text_is_pinned(ledger):
    fill(ledger, 1, 1)
    with pytest.raises(ValueError, match="pin what the gallery computes"):
        ledger.begin(strip((0, 1), (0, 1)))
    assert ledger.flight is None


@pytest.mark.parametrize(
    ("rows", "columns", "why"),
    [
        ((0, 2), (0, 3), "not beside"),  # done
        ((1, 3), (0, 3), "not beside"),  # overlaps
        ((3, 4), (0, 3), "not beside"),  # leaves a gap
        ((2, 3), (0, 2), "not beside"),  # too short
        ((2, 3), (0, 4), "not beside"),  # a corner
        ((2, 3), (3, 4), "not beside"),
        ((0, 1), (3, 4), "not beside"),
        ((2, 6), (0, 3), "not all filled: 5 x 5 are"),
        ((0, 2), (3, 6), "not all filled"),
    ],
)
def test_strips_lie_beside_the_rectangle(ledger, rows, columns, why):
    fill(ledger, 5, 5)
    ledger.pin_text(TEXT)
    ledger.begin(strip((0, 2), (0, 3)))
    ledger.commit(strip((0, 2), (0, 3)), b"")
    for use in (ledger.begin, ledger.burn):
        with pytest.raises(ValueError, match=why):
            use(strip(rows, columns))
    assert (ledger.done, ledger.flight) == ((2, 3), None)


def test_first_strip_begins_at_the_corner(ledger):
    fill(ledger, 3, 3)
    ledger.pin_text(TEXT)
    for wrong in (strip((1, 2), (0, 1)), strip((0, 1), (1, 2))):
        with pytest.raises(ValueError, match="not beside"):
            ledger.begin(wrong)


@pytest.mark.parametrize(
    "slots", [(range(0), range(1)), (range(-1, 2), range(1)), (range(0, 4, 2), range(1))]
)
def test_strip_is_of_consecutive_slots(slots):
    for rows, columns in (slots, slots[::-1]):
        with pytest.raises(ValueError, match="consecutive"):
            Strip(rows, columns)


def test_one_strip_is_in_flight_and_may_be_begun_again(ledger, folder):
    fill(ledger, 3, 3)
    ledger.pin_text(TEXT)
    ledger.begin(strip((0, 1), (0, 3)))
    before = mark_of(folder).read_bytes()
    ledger.begin(strip((0, 1), (0, 3)))
    assert mark_of(folder).read_bytes() == before
    for use in (ledger.begin, ledger.burn):
        with pytest.raises(ValueError, match="rows 0 to 0 x columns 0 to 2 are in flight"):
            use(strip((0, 1), (0, 2)))
    with pytest.raises(ValueError, match="not in flight"):
        ledger.commit(strip((0, 1), (0, 2)), b"")
    ledger.commit(strip((0, 1), (0, 3)), b"r")
    with pytest.raises(ValueError, match="not in flight, but nothing"):
        ledger.commit(strip((0, 1), (0, 3)), b"r")
    ledger.burn(strip((1, 3), (0, 3)))
    assert (ledger.done, ledger.burnt()) == ((3, 3), [strip((1, 3), (0, 3))])
    assert list(ledger.results()) == [(strip((0, 1), (0, 3)), b"r")]


@pytest.mark.parametrize("seed", range(30))
def test_random_operations_and_restored_backups(folder, seed):
    """Backups come back at any time; what was sent is never filled anew, and no pair is used twice."""
    rng, model = random.Random(seed), Model()
    backups, sent, texts, used = [], {}, set(), set()
    ledger = open_ledger(folder)
    for _ in range(120):
        action = model.random_action(rng)
        if action is not None:
            run(ledger, *action)
            model.apply(*action)
            if action[0] == "fill":
                for slot, eps in action[2]:
                    assert (action[1], slot) not in sent, "a slot was filled twice"
                    sent[action[1], slot] = eps
            if action[0] == "begin":
                pairs = {(row, column) for row in action[1].rows for column in action[1].columns}
                assert not pairs & used, "a pair was used twice"
                used |= pairs
            texts |= {model.text} - {None}
        if rng.random() < 0.2:
            ledger.close()
            if rng.random() < 0.4:
                backups.append((backup(folder, f"backup {len(backups)}"), model.copy(), model.facts()))
            restored = rng.random() < 0.5 and bool(backups)
            if restored:
                path, old, _ = rng.choice(backups)
                restore(folder, path)
                behind = old.facts() != model.facts()
                model = model.restored(old) if behind else model
            ledger = open_ledger(folder)
            assert not behind or ledger.rolled_back if restored else not ledger.rolled_back
        if rng.random() < 0.3 or action is None:
            assert facts(ledger) == model.facts()
        for owner, slot in sent:
            assert slot < ledger.slots[owner].filled
        for owner in (0, 1):
            for slot, eps in enumerate(ledger.slots[owner].eps(0, ledger.slots[owner].filled)):
                assert eps in (None, sent[owner, slot])
    assert facts(ledger) == model.facts()
    assert len(texts) == 1
    ledger.close()


def test_flight_that_the_backup_knows_is_run_again(folder):
    with open_ledger(folder) as ledger:
        fill(ledger, 2, 2)
        ledger.pin_text(TEXT)
        ledger.begin(strip((0, 2), (0, 2)))
    copy = backup(folder)
    with open_ledger(folder) as ledger:
        fill(ledger, 1, 1, (2, 2))
    restore(folder, copy)
    with open_ledger(folder) as ledger:
        assert ledger.rolled_back
        assert ledger.flight == strip((0, 2), (0, 2))
        assert [slots.voids for slots in ledger.slots] == [[2], [2]]
        ledger.commit(strip((0, 2), (0, 2)), b"again")


def test_lost_ledger_leaves_all_that_was_used_void(folder):
    with open_ledger(folder) as ledger:
        fill(ledger, 3, 2)
        ledger.pin_text(TEXT)
        ledger.begin(strip((0, 2), (0, 2)))
        ledger.commit(strip((0, 2), (0, 2)), b"r")
        ledger.begin(strip((2, 3), (0, 2)))
    (folder / "t.ledger").unlink()
    with open_ledger(folder) as ledger:
        assert ledger.rolled_back
        assert [slots.voids for slots in ledger.slots] == [[0, 1, 2], [0, 1]]
        assert (ledger.done, ledger.flight, ledger.text) == ((3, 2), None, TEXT)
        assert ledger.burnt() == [strip((0, 2), (0, 2)), strip((2, 3), (0, 2))]
        fill(ledger, 1, 1, (3, 2))
    with open_ledger(folder) as ledger:
        assert not ledger.rolled_back
        assert ledger.slots[0].eps(3, 4) == [b"0 3"]


def test_ledger_that_came_without_its_mark_gets_one(folder):
    with open_ledger(folder) as ledger:
        fill(ledger, 2, 2)
        before = facts(ledger)
    copy = backup(folder)
    for count in range(2):
        restore(folder, copy)
        with open_ledger(folder, state_dir=folder / "other") as ledger:
            assert ledger.rolled_back is bool(count)
            if not count:
                assert facts(ledger) == before
                fill(ledger, 1, 0, (2, 2))
            assert ledger.slots[0].filled == 3


def test_mark_that_is_behind_is_brought_up(folder):
    with open_ledger(folder) as ledger:
        fill(ledger, 2, 2)
    old = mark_of(folder).read_bytes()
    with open_ledger(folder) as ledger:
        fill(ledger, 1, 0, (2, 2))
        ledger.slots[1].void([0])
        before = facts(ledger)
        new = MarkFile(folder / "state", TAPE, 0).read()
    mark_of(folder).write_bytes(old)
    with open_ledger(folder) as ledger:
        assert not ledger.rolled_back
        assert facts(ledger) == before
    assert MarkFile(folder / "state", TAPE, 0).read() == new


@pytest.mark.parametrize("more_here", [0, 1, 2])
@pytest.mark.parametrize("more_there", [0, 1, 2])
def test_mark_of_another_history_is_refused(tmp_path, folder, more_here, more_there):
    for place, text, more in ((folder, A, more_here), (tmp_path / "other", B, more_there)):
        with open_ledger(place) as ledger:
            ledger.slots[0].fill([(0, text)])
            for _ in range(more):
                fill(ledger, 0, 1, (0, ledger.slots[1].filled))
    shutil.copy(mark_of(tmp_path / "other"), mark_of(folder))
    with pytest.raises(TapeDamaged, match=r"not those of its mark|mark holds|ledger holds") as caught:
        open_ledger(folder)
    assert "Deal new tapes" in str(caught.value)


def text(data):
    return lambda ledger: ledger.pin_text(data)


def slots(action, *values):
    return lambda ledger: getattr(ledger.slots[0], action)(*values)


def note(notes):
    return lambda ledger: ledger.note((notes, {}))


FILLED = slots("fill", [(0, A), (1, B)])
MORE = [slots("fill", [(slot, C)]) for slot in (2, 3)]
COLUMN = [FILLED, lambda ledger: ledger.slots[1].fill([(0, A)])]


def burn(rows):
    return lambda ledger: ledger.burn(strip((0, rows), (0, 1)))


@pytest.mark.parametrize(
    ("here", "there"),
    [
        ([text(A)], [text(B)]),
        ([text(A), FILLED], [text(B)]),
        ([text(A)], [text(B), FILLED]),
        ([FILLED, *MORE], [text(B)]),
        ([FILLED], [slots("fill", [(0, A)])]),
        ([FILLED], [slots("fill", [(0, A)]), text(A)]),
        ([FILLED, text(A)], [FILLED, *MORE, text(B)]),
        ([*COLUMN, burn(2)], [*COLUMN, burn(1), *MORE]),
        ([*COLUMN, burn(1), *MORE], [*COLUMN, burn(2)]),
        ([slots("fill", [(0, A)])], [FILLED]),
        ([FILLED], [slots("fill", [(0, B), (1, B)]), slots("void", [1])]),
        ([FILLED, *MORE], [FILLED, slots("void", [0])]),
        ([FILLED, *MORE], [FILLED, note({0: b"n"})]),
        ([FILLED, note({0: b"n"})], [FILLED, *MORE]),
        ([FILLED, slots("void", [1])], [FILLED, *MORE]),
    ],
)
def test_ledger_and_mark_of_two_histories_are_refused(tmp_path, folder, here, there):
    for place, actions in ((folder, here), (tmp_path / "other", there)):
        with open_ledger(place) as ledger:
            for action in actions:
                action(ledger)
    shutil.copy(mark_of(tmp_path / "other"), mark_of(folder))
    with pytest.raises(TapeDamaged, match="Deal new tapes"):
        open_ledger(folder)


def test_destroyed_ledger_and_its_copies_are_refused(folder):
    with open_ledger(folder) as ledger:
        fill(ledger, 1, 1)
        copy = backup(folder)
        ledger.destroy()
        ledger.destroy()
        for use in (lambda: facts(ledger), lambda: fill(ledger, 1, 0, (1, 1)), lambda: ledger.pin_text(TEXT)):
            with pytest.raises(TapeDestroyed):
                use()
    destroyed = backup(folder, "destroyed")
    for path, state in ((destroyed, "none yet"), (copy, "state")):
        restore(folder, path)
        for _ in range(2):
            with pytest.raises(TapeDestroyed, match="MAC check failed"):
                open_ledger(folder, state_dir=folder / state)
    with pytest.raises(TapeDestroyed):  # opening has destroyed the copy as well
        open_ledger(folder, state_dir=folder / "neither")


def test_ledger_of_another_tape_or_party_is_refused(ledger, folder):
    for tape, party in (("cafe", 0), (TAPE, 1)):
        with pytest.raises(TapeMismatch, match=f"gallery {TAPE}, party 0, not of {tape}, party {party}"):
            Ledger.open(folder / "t.ledger", tape, party, state_dir=folder / "state")


@pytest.mark.parametrize("content", [b"x", b"SQLite format 3\0" + bytes(4000), "foreign", "cut"])
def test_file_that_is_no_ledger_is_refused(folder, content):
    with open_ledger(folder) as ledger:
        fill(ledger, 3, 3)
    path = folder / "t.ledger"
    if content == "cut":
        content = path.read_bytes()[:5000]
    elif content == "foreign":
        path.unlink()
        base = sqlite3.connect(path)
        base.execute("CREATE TABLE record (mark BLOB)")
        base.close()
        content = path.read_bytes()
    path.write_bytes(content)
    with pytest.raises(TapeDamaged, match=r"t\.ledger: the ledger is damaged .* Move it away"):
        open_ledger(folder)
    mark_of(folder).unlink()
    with pytest.raises(TapeDamaged, match="Deal new tapes"):
        open_ledger(folder)
    assert path.read_bytes() == content


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE slots SET digest = randomblob(32) WHERE key = 1",
        "UPDATE slots SET digest = NULL, eps = NULL WHERE key = 1",
        "UPDATE slots SET note = NULL WHERE key = 1",
        "DELETE FROM slots WHERE key = 1",
        "DELETE FROM slots WHERE key = 2",
        "INSERT INTO slots SELECT 3, digest, note, eps FROM slots WHERE key = 2",
        "DELETE FROM strips WHERE number = 2",
        "UPDATE strips SET row_end = 3 WHERE number = 2",
        "UPDATE strips SET col = 5 WHERE number = 2",
        "UPDATE record SET mark = replace(CAST(mark AS TEXT), '\"filled\":3', '\"filled\":2')",
        "UPDATE record SET mark = x''",
        "DELETE FROM record",
    ],
)
def test_contradiction_in_the_ledger_is_found_when_it_is_opened(folder, damage):
    change(folder, damage)
    with pytest.raises(TapeDamaged, match="the ledger is damaged"):
        open_ledger(folder)


@pytest.mark.parametrize(
    ("damage", "use", "where"),
    [
        (
            "UPDATE slots SET eps = x'00' WHERE key = 1",
            lambda led: led.slots[0].eps(0, 3),
            "slot 1 of party 0",
        ),
        (
            "UPDATE slots SET eps = NULL WHERE key = 1",
            lambda led: led.slots[0].eps(0, 3),
            "slot 1 of party 0",
        ),
        (
            "UPDATE slots SET note = x'00' WHERE key = 1",
            lambda led: led.slots[0].noted(1),
            "slot 1 of party 0",
        ),
        (
            "UPDATE slots SET note = (SELECT note FROM slots WHERE key = 1) WHERE key = 2",
            lambda led: led.slots[0].noted(2),
            "slot 2 of party 0",
        ),
        (
            "UPDATE strips SET results = x'01' WHERE number = 1",
            lambda led: list(led.results()),
            "rows 0 to 0",
        ),
    ],
)
def test_damaged_bytes_are_found_when_they_are_read(folder, damage, use, where):
    change(folder, damage)
    with open_ledger(folder) as ledger, pytest.raises(TapeDamaged, match=where):
        use(ledger)


def change(folder, statement):
    """A ledger with some of everything, changed behind its back."""
    with open_ledger(folder) as ledger:
        fill(ledger, 3, 3)
        ledger.note(({1: b"n", 2: b"m"}, {}))
        ledger.pin_text(TEXT)
        for which in (strip((0, 1), (0, 2)), strip((1, 2), (0, 2))):
            ledger.begin(which)
            ledger.commit(which, b"r")
    base = sqlite3.connect(folder / "t.ledger")
    assert base.execute(statement).rowcount == 1
    base.commit()
    base.close()


@pytest.mark.parametrize(
    "damage", [b"", b"x", b"\xff" * 3000, "short", "changed", "in one sector", "other party"]
)
def test_damaged_mark_is_refused(folder, damage):
    with open_ledger(folder) as ledger:
        fill(ledger, 3, 3)
    content = mark_of(folder).read_bytes()
    if damage == "short":
        damage = content[:-1]
    elif damage == "changed":
        damage = content.replace(b'"filled":3', b'"filled":2')
    elif damage == "in one sector":
        damage = b"".join(content[k : k + 4096].rstrip(b"\n").ljust(2048, b"\n") for k in (0, 4096))
    elif damage == "other party":
        open_ledger(folder / "bob", party=1, state_dir=folder / "state").close()
        damage = (folder / "state" / f"{TAPE}-1.gallery").read_bytes()
    assert damage != content
    mark_of(folder).write_bytes(damage)
    with pytest.raises(TapeDamaged, match=r"beef-0\.gallery: the gallery's mark is damaged"):
        open_ledger(folder)


def test_files_are_private(folder, ledger):
    fill(ledger, 1, 1)
    for file in (*folder.glob("t.ledger*"), *(folder / "state").iterdir()):
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert stat.S_IMODE((folder / "state").stat().st_mode) == 0o700


def test_commits_are_synced(folder, monkeypatch):
    monkeypatch.undo()
    with open_ledger(folder) as ledger:
        base = ledger._journal._store
        assert base.all("PRAGMA synchronous") == [(2,)]
        assert base.all("PRAGMA journal_mode") == [("wal",)]
        assert base.all("PRAGMA wal_autocheckpoint") == [(1000,)]
        assert base.all("PRAGMA fullfsync") == [(1,)]


def test_disk_errors_say_what_failed_and_the_ledger_must_be_opened_again(folder):
    ledger = open_ledger(folder)
    fill(ledger, 1, 1)
    before = facts(ledger)
    ledger._journal._store.all("PRAGMA max_page_count = 1")
    with pytest.raises(TapeError, match=r"t\.ledger: .*full.* Nothing was sent"):
        ledger.slots[0].fill([(1, bytes(50_000))])
    for use in (lambda: ledger.slots[0].fill([(1, B)]), lambda: ledger.done, lambda: ledger.pin_text(TEXT)):
        with pytest.raises(TapeError, match="open it again"):
            use()
    ledger.close()
    with open_ledger(folder) as ledger:
        assert facts(ledger) == before


def test_mark_that_cannot_be_written_says_what_to_do(folder, monkeypatch):
    ledger = open_ledger(folder)

    def fail(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("spdz.gallery.mark_file.write_at", fail)
    with pytest.raises(TapeError, match=r"beef-0\.gallery \(No space left .* Nothing was sent"):
        fill(ledger, 1, 0)
    with pytest.raises(TapeError, match="open it again"):
        fill(ledger, 1, 0)
    with pytest.raises(TapeError, match="No space left"):
        ledger.destroy()
    monkeypatch.undo()
    mark_of(folder).unlink()
    with pytest.raises(TapeDestroyed):
        open_ledger(folder)
    ledger.close()


@pytest.mark.parametrize("where", ["missing/t.ledger", "."])
def test_ledger_that_cannot_be_opened_is_a_tape_error(tmp_path, where):
    with pytest.raises(TapeError, match="could not be read or written"):
        Ledger.open(tmp_path / where, TAPE, 0, state_dir=tmp_path)


def test_closed_ledger_refuses(folder):
    ledger = open_ledger(folder)
    ledger.close()
    ledger.close()
    for use in (lambda: ledger.slots[0].fill([(0, A)]), lambda: ledger.text, ledger.destroy):
        with pytest.raises(TapeError, match="closed"):
            use()
    for use in (ledger.burnt, lambda: list(ledger.results())):
        with pytest.raises(TapeError, match="closed"):
            use()


def test_repr_shows_only_what_was_done(ledger):
    ledger.slots[0].fill([(0, A)])
    assert repr(ledger) == "<ledger of gallery beef: 0 x 0 pairs done>"


def test_threads_may_share_a_ledger(ledger):
    fill(ledger, 40, 0)

    def note(slots):
        for slot in slots:
            ledger.note(({slot: b"%d" % slot}, {}))

    threads = [threading.Thread(target=note, args=(range(k, 40, 4),)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [ledger.slots[0].noted(slot) for slot in range(40)] == [b"%d" % slot for slot in range(40)]


FORKS = """
import os, sys, threading
from pathlib import Path
from spdz.foundations.errors import TapeInUse
from spdz.gallery.ledger import Ledger
folder = Path(sys.argv[1])
ledger = Ledger.open(folder / "t.ledger", "beef", 0, state_dir=folder / "state")
ended = threading.Event()
def fill():
    slot = 0
    while not ended.is_set():
        ledger.slots[0].fill([(slot, bytes(100_000))])
        slot += 1
thread = threading.Thread(target=fill)
thread.start()
for _ in range(40):
    child = os.fork()
    if child == 0:
        try:
            ledger.slots[1].fill([(0, b"fork")])
        except TapeInUse:
            ledger.close()
            del ledger
            sys.exit(7)  # with garbage collection
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
ended.set()
thread.join()
print(ledger.slots[0].filled)
"""


def test_fork_may_not_write_and_does_no_harm(folder):
    open_ledger(folder).close()
    script = [sys.executable, "-W", "ignore", "-c", FORKS, str(folder)]
    done = subprocess.run(script, capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == 0, done.stderr
    with open_ledger(folder) as ledger:
        assert ledger.slots[0].eps(0, ledger.slots[0].filled) == [bytes(100_000)] * int(done.stdout)
        assert ledger.slots[1].filled == 0


def test_fork_waits_until_no_ledger_is_at_work(ledger):
    entered, left = threading.Event(), []

    def work():
        with ledger._journal.at_work():
            entered.set()
            time.sleep(0.2)
            left.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    entered.wait()
    child = os.fork()
    if child == 0:
        os._exit(7 if left else 1)
    thread.join()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7


def test_fork_of_this_process_is_refused(ledger):
    child = os.fork()
    if child == 0:
        try:
            ledger.burnt()
        except TapeInUse:
            os._exit(7)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
