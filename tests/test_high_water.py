import pytest
from tape_helpers import ALPHA, CHAIN, chains, deal, skip_sync

from spdz.arithmetic import prf
from spdz.foundations.errors import TapeDamaged, TapeDestroyed, TapeError
from spdz.tape import Tape
from spdz.tape.high_water import default_state_dir


@pytest.fixture(autouse=True)
def no_sync(monkeypatch):
    skip_sync(monkeypatch)


@pytest.fixture
def state(tmp_path):
    return tmp_path / "state"


@pytest.fixture
def path(tmp_path):
    return deal(tmp_path / "mission" / "bob.tape")


def test_restored_tape_resumes_past_the_mark(path, state):
    backup = path.read_bytes()
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(4)
    path.write_bytes(backup)
    with Tape.open(path, state_dir=state) as tape:
        assert tape.rolled_back
        assert (tape.cursor, tape.alpha) == (4, ALPHA)
        job = tape.reserve(1)[0]
        assert (job.index, job.key) == (4, prf.job_key(chains(5)[4]))
    assert CHAIN not in path.read_bytes()
    with Tape.open(path, state_dir=state) as tape:
        assert not tape.rolled_back


def test_tape_that_came_without_its_mark_gets_one(path, state, tmp_path):
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(4)
    backup = path.read_bytes()
    with Tape.open(path, state_dir=tmp_path / "other") as tape:
        assert (tape.cursor, tape.rolled_back) == (4, False)
        tape.reserve(2)
    path.write_bytes(backup)
    with Tape.open(path, state_dir=tmp_path / "other") as tape:
        assert (tape.cursor, tape.rolled_back) == (6, True)


def test_destroyed_tape_keeps_no_secret_and_is_refused(path, state):
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(2)
        tape.destroy()
        tape.destroy()
        for use in (lambda: tape.reserve(1), lambda: tape.resume(3), lambda: tape.alpha):
            with pytest.raises(TapeDestroyed):
                use()
    content = path.read_bytes()
    assert ALPHA not in content
    assert not any(chain in content for chain in chains(10))
    for folder in (state, state / "elsewhere"):
        with pytest.raises(TapeDestroyed, match=r"bob\.tape"):
            Tape.open(path, state_dir=folder)


def test_restoring_a_destroyed_tape_does_not_resurrect_it(path, state):
    backup = path.read_bytes()
    with Tape.open(path, state_dir=state) as tape:
        tape.destroy()
    path.write_bytes(backup)
    with pytest.raises(TapeDestroyed):
        Tape.open(path, state_dir=state)
    assert ALPHA not in path.read_bytes()
    assert CHAIN not in path.read_bytes()


@pytest.mark.parametrize("damage", [b"", b"x", b"\xff" * 5000, None, "cursor"])
def test_damaged_mark_is_refused(path, state, damage):
    with Tape.open(path, state_dir=state) as tape:
        tape.reserve(2)
    mark = state / "beef-0.mark"
    content = mark.read_bytes()
    assert b" 0 2 live " in content
    if damage is None:
        damage = content[:-1]
    elif damage == "cursor":
        damage = content.replace(b" 0 2 live", b" 0 1 live")
    mark.write_bytes(damage)
    with pytest.raises(TapeDamaged, match=r"beef-0\.mark"):
        Tape.open(path, state_dir=state)


def test_mark_past_the_end_is_refused(path, state, tmp_path):
    with Tape.open(deal(tmp_path / "longer.tape", jobs=20), state_dir=state) as tape:
        tape.reserve(15)
    with pytest.raises(TapeDamaged, match="high-water mark 15 is past its 10 jobs"):
        Tape.open(path, state_dir=state)


def test_unwritable_state_folder_says_what_to_do(path, tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(TapeError, match=r"state_dir .* XDG_STATE_HOME"):
        Tape.open(path, state_dir=tmp_path / "file" / "state")


def test_default_state_folder_follows_xdg(path, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "xdg"))
    Tape.open(path).close()
    assert (tmp_path / "xdg" / "spdz" / "beef-0.mark").exists()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for ignored in ("relative", ""):
        monkeypatch.setenv("XDG_STATE_HOME", ignored)
        assert default_state_dir() == tmp_path / "home" / ".local" / "state" / "spdz"
