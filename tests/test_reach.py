"""Galleries over channels that somebody else makes: a port for several of them, a call for each."""

import pytest
from channel_helpers import LONG, free_address, together
from stream_helpers import THRESHOLD, deal, expected, maps, table_of, tape

from protocols.catalog import GalleryPurpose
from spdz.channels import memory_pair
from spdz.channels.port import Port, dial
from spdz.session import open_gallery

TERMS = GalleryPurpose("S10", 4).terms(THRESHOLD, "malicious")


@pytest.fixture
def dealt(tmp_path):
    return deal(tmp_path / "mission")


def opened(folder, party, reach, terms=TERMS, **options):
    return open_gallery(
        tape(folder, party), terms, state_dir=folder / f"state-{party}", reach=reach, **options
    )


def one_step(session, party):
    with session:
        session.add(maps()[party])
        return list(session.step().blocks)


def test_a_gallery_is_met_over_a_port(dealt):
    with Port("127.0.0.1:0", dealt / "alice", ["bob"], ["lidar"]) as port:

        def taken(header, credentials):
            return port.take(header.peer, "lidar", LONG)

        def called(header, credentials):
            return dial(port.addresses[0], credentials, header.peer, "lidar", wait=LONG)

        results = together(
            lambda: one_step(opened(dealt, 0, taken), 0), lambda: one_step(opened(dealt, 1, called), 1)
        )
    for party, blocks in enumerate(results):
        table, known = table_of(blocks, expected(party).shape)
        assert (known == 1).all() and (table == expected(party)).all()


def test_what_makes_the_channel_gets_the_header_and_the_folder_of_the_credentials(dealt):
    seen = []

    def reach(header, credentials):
        seen.append((header.name, header.peer, header.slots, credentials))
        raise KeyError("nobody")

    with pytest.raises(KeyError):
        opened(dealt, 1, reach)
    with pytest.raises(KeyError):
        opened(dealt, 1, reach, credentials=str(dealt / "bob"))  # tape and ledger were closed again
    assert seen == [("bob", "alice", (8, 6), dealt / "bob")] * 2


def test_credentials_of_another_robot_are_refused_before_anybody_is_reached(dealt):
    with pytest.raises(ValueError, match="is of 'alice', the tape is of 'bob'"):
        opened(dealt, 1, pytest.fail, credentials=dealt / "alice")


def test_without_credentials_the_channel_is_whatever_it_is(dealt, tmp_path):
    ends = memory_pair(timeout=LONG)
    results = together(
        *(
            lambda party=party: one_step(
                opened(dealt, party, lambda *_: ends[party], insecure=True, credentials=tmp_path), party
            )
            for party in (0, 1)
        )
    )
    assert all(results)


@pytest.mark.parametrize("where", ["listen", "connect"])
def test_there_is_one_way_to_reach_the_peer(dealt, where):
    with pytest.raises(ValueError, match="reach= takes the place of listen= and connect="):
        opened(dealt, 0, pytest.fail, **{where: free_address()})
    with pytest.raises(ValueError, match="exactly one of listen= and connect="):
        opened(dealt, 0, None)
