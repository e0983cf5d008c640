"""A folder of credentials is held against the tape before anybody is called."""

import shutil

import pytest
from channel_helpers import SHORT, free_address
from session_helpers import deal, state_dirs

from protocols.scores import S10
from spdz import ChannelTimeout, open_session
from spdz.channels.credentials import check_credentials
from spdz.tape import Tape


@pytest.fixture
def mixed(folders, tmp_path):
    """Makes a folder of files that come from several robots' folders."""

    def make(**sources):
        for name in ("ca", "cert", "key"):
            shutil.copy(folders / sources.get(name, "alice") / f"{name}.pem", tmp_path / f"{name}.pem")
        return tmp_path

    return make


def test_a_robots_own_folder_is_accepted(folders):
    for name in ("alice", "bob", "carol"):
        check_credentials(folders / name, name)


def test_a_folder_of_another_robot_is_refused_by_name(folders):
    with pytest.raises(ValueError, match=r"certificate in .*carol is of 'carol', the tape is of 'alice'"):
        check_credentials(folders / "carol", "alice")


def test_a_certificate_that_the_folders_authority_did_not_issue_is_refused(mixed):
    with pytest.raises(ValueError, match=r"cert\.pem was not issued by the authority in ca\.pem .*runs"):
        check_credentials(mixed(ca="other-alice"), "alice")


@pytest.mark.parametrize("name", ["ca.pem", "cert.pem", "key.pem"])
def test_a_missing_file_is_named(mixed, name):
    folder = mixed()
    (folder / name).unlink()
    with pytest.raises(ValueError, match=f"{name} is missing"):
        check_credentials(folder, "alice")


@pytest.mark.parametrize("content", [b"", b"\xff\x00", b"-----BEGIN CERTIFICATE-----\nAAAA\n"])
@pytest.mark.parametrize("name", ["ca.pem", "cert.pem"])
def test_a_file_that_is_no_certificate_is_named(mixed, name, content):
    folder = mixed()
    (folder / name).write_bytes(content)
    with pytest.raises(ValueError, match=rf"{name} cannot be used"):
        check_credentials(folder, "alice")


def test_open_session_checks_before_it_calls_and_gives_the_tape_back(folders, tmp_path):
    (tape, _), (state, _) = deal(tmp_path / "m", S10, ((4,), (4,)), 1), state_dirs(tmp_path)
    told, address = [], free_address()

    def attempt(folder):
        open_session(
            tape,
            connect=address,
            credentials=folders / folder,
            wait=2 * SHORT,
            state_dir=state,
            on_event=told.append,
        )

    with pytest.raises(ValueError, match="is of 'carol', the tape is of 'alice'"):
        attempt("carol")
    assert told == []
    with pytest.raises(ChannelTimeout):
        attempt("alice")
    assert len(told) == 1 and told[0].startswith(f"nobody answers at {address} yet (")
    Tape.open(tape, state_dir=state).close()


@pytest.mark.parametrize("way", ["listen", "connect"])
def test_open_session_tells_over_plain_tcp_too(tmp_path, way):
    (tape, _), (state, _) = deal(tmp_path / "m", S10, ((4,), (4,)), 1), state_dirs(tmp_path)
    told, where = [], {way: free_address()}
    with pytest.raises(ChannelTimeout):
        open_session(tape, insecure=True, wait=2 * SHORT, state_dir=state, on_event=told.append, **where)
    assert len(told) == 1 and where[way] in told[0]
