"""Damage of a gallery's tape, ledger and mark, as ``python -m spdz tape`` finds it."""

import json
import os
import shutil

import pytest
from stream_helpers import deal, fresh, tape
from tape_gallery_helpers import begun, facts, ledger, opened, show

from spdz.foundations.errors import TapeDamaged, TapeError
from spdz.gallery.status import gallery_status, verify_gallery

pytestmark = pytest.mark.usefixtures("quick_disk")


@pytest.fixture(scope="module")
def dealt(tmp_path_factory):
    return deal(tmp_path_factory.mktemp("gallery") / "m")


@pytest.fixture
def mission(dealt, tmp_path):
    return fresh(dealt, tmp_path / "m")


def flip(path, offset):
    with open(path, "r+b") as file:
        file.seek(offset)
        byte = file.read(1)
        file.seek(offset)
        file.write(bytes([byte[0] ^ 1]))


def places(mission):
    """The first and last bytes of every sealed record, and its name."""
    with opened(mission) as one:
        layout, header = one._layout, one.header
    for owner in (0, 1):
        for slot in (0, header.capacity[owner] - 1):
            first = layout.slot_at(owner, slot)
            yield from (
                (at, f"slot {slot} of party {owner}") for at in (first, first + layout.slot_bytes[owner] - 1)
            )
    yield layout.tiles, "tile (0, 0)"
    yield layout.end - 1, "tile (0, 0)"


def test_verify_finds_damage_in_any_record_and_a_look_does_not(mission, capsys):
    reports = []
    verify_gallery(tape(mission, 0), lambda done, total: reports.append((done, total)))
    assert reports[-1][0] == reports[-1][1] and reports == sorted(reports)
    assert facts(capsys, mission, "--verify")["verified"] is True
    assert "and every record" in show(capsys, mission, "--verify")[1]
    for offset, name in list(places(mission)):
        flip(tape(mission, 0), offset)
        assert show(capsys, mission)[0] == 0
        status, out, err = show(capsys, mission, "--verify")
        assert (status, out) == (2, "") and f"{name} at byte" in err and "TapeDamaged" in err
        flip(tape(mission, 0), offset)
    assert show(capsys, mission, "--verify")[0] == 0


def test_verify_finds_a_damaged_key_and_passes_over_erased_ones(mission, capsys):
    with opened(mission) as one:
        at = one._layout.keys
    flip(tape(mission, 0), at)
    status, _, err = show(capsys, mission, "--verify")
    assert status == 2 and "key of row band 0" in err
    flip(tape(mission, 0), at)
    with opened(mission) as one:
        one.erase(rows=[0])
    flip(tape(mission, 0), one._layout.slot_at(0, 0))
    assert show(capsys, mission, "--verify")[0] == 0
    flip(tape(mission, 0), one._layout.slot_at(1, 0))
    assert "slot 0 of party 1" in show(capsys, mission, "--verify")[2]


def mark_of(path):
    (mark,) = (path.parent.parent / "state-0").glob("*.gallery")
    return mark


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda path, _: os.truncate(path, 9000), "truncated"),
        (lambda path, _: flip(path, 30), "checksum of the header"),
        (lambda path, _: path.with_suffix(".ledger").write_bytes(b"x" * 5000), "ledger is damaged"),
        (lambda path, other: shutil.copy(other, path.with_suffix(".ledger")), "of another gallery or party"),
        (lambda path, _: mark_of(path).write_text("x"), "mark is damaged"),
    ],
    ids=["cut", "header", "ledger", "foreign ledger", "mark"],
)
def test_damage_is_one_line_and_status_2(mission, capsys, spoil, says):
    begun(mission)
    ledger(mission, 1).close()
    spoil(tape(mission, 0), tape(mission, 1).with_suffix(".ledger"))
    status, out, err = show(capsys, mission)
    assert (status, out) == (2, "") and says in err and len(err.splitlines()) == 1
    with pytest.raises(TapeError):
        gallery_status(tape(mission, 0), mission / "state-0")
    status, out, err = show(capsys, mission, "--json")
    assert (status, err) == (2, "") and says in json.loads(out)["message"]


def test_a_state_that_is_not_whole_is_told(mission):
    with opened(mission) as one:
        layout = one._layout
    for place in range(2):
        flip(tape(mission, 0), layout.state + 4096 * place)
    with pytest.raises(TapeDamaged, match="checksums of the state"):
        gallery_status(tape(mission, 0), mission / "state-0")
