import os
from dataclasses import replace

import pytest
from tape_helpers import ALPHA, CHAIN, HEADER, corrections, deal, skip_sync

from spdz.tape import TapeWriter


@pytest.fixture(autouse=True)
def no_sync(monkeypatch):
    skip_sync(monkeypatch)


@pytest.fixture
def state(tmp_path):
    return tmp_path / "state"


@pytest.fixture
def path(tmp_path):
    return deal(tmp_path / "mission" / "bob.tape")


def test_dealt_tape_is_never_overwritten(path):
    before = path.read_bytes()
    with pytest.raises(FileExistsError, match="never overwritten"):
        TapeWriter(path, HEADER, CHAIN, ALPHA)
    assert path.read_bytes() == before


@pytest.mark.parametrize("hard_links", [True, False])
def test_tape_that_appears_meanwhile_is_not_overwritten(tmp_path, monkeypatch, hard_links):
    if not hard_links:
        monkeypatch.setattr(os, "link", lambda *args: (_ for _ in ()).throw(PermissionError(1, "no links")))
    path = tmp_path / "t.tape"
    with pytest.raises(FileExistsError), TapeWriter(path, HEADER, CHAIN, ALPHA) as writer:
        for correction in corrections(HEADER):
            writer.append(correction)
        path.write_bytes(b"somebody else's")
    assert path.read_bytes() == b"somebody else's"
    assert list(tmp_path.iterdir()) == [path]
    path.unlink()
    assert deal(path).exists()
    assert list(tmp_path.iterdir()) == [path]


def test_wrong_number_or_size_of_corrections_leaves_no_file(tmp_path):
    path = tmp_path / "t.tape"
    with pytest.raises(ValueError, match="9 jobs were written instead of 10"):
        with TapeWriter(path, HEADER, CHAIN, ALPHA) as writer:
            for correction in corrections(HEADER)[:9]:
                writer.append(correction)
    with pytest.raises(ValueError, match="takes 40 bytes, not 39"):
        with TapeWriter(path, HEADER, CHAIN, ALPHA) as writer:
            writer.append(bytes(39))
    with pytest.raises(ValueError, match="all 1 jobs are written"):
        with TapeWriter(path, replace(HEADER, jobs=1), CHAIN, ALPHA) as writer:
            writer.append(bytes(40))
            writer.append(bytes(40))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="closed"):
        writer.append(bytes(40))


def test_secrets_of_wrong_length_are_refused(tmp_path):
    for chain, alpha in ((CHAIN[1:], ALPHA), (CHAIN, ALPHA + b"x")):
        with pytest.raises(ValueError, match="chain takes 32 bytes and alpha 16"):
            TapeWriter(tmp_path / "t.tape", HEADER, chain, alpha)
    assert list(tmp_path.iterdir()) == []


def test_overlong_header_is_refused(tmp_path):
    with pytest.raises(ValueError, match="at most 65536"):
        TapeWriter(tmp_path / "t.tape", replace(HEADER, program={"x": "y" * 70000}), CHAIN, ALPHA)
