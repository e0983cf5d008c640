"""No room for another connection: the listener rests and says so, the caller goes on trying."""

import errno
import os
import resource
import socket

import pytest
from channel_helpers import SHORT, assert_alive, meet, ways

from spdz.channels import listening, reception, tcp
from spdz.channels.addresses import parse_address
from spdz.foundations.errors import ChannelTimeout


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_a_listener_without_free_descriptors_rests_and_says_so(folders, monkeypatch, kind):
    tries = []
    real = reception.accept_one

    def accept_one(door):
        tries.append(door)
        return real(door)

    monkeypatch.setattr(reception, "accept_one", accept_one)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with socket.socket() as caller:

        def use_up(address):
            lowest_free = os.dup(0)
            os.close(lowest_free)
            resource.setrlimit(resource.RLIMIT_NOFILE, (lowest_free, hard))
            caller.connect(parse_address(address))

        try:
            with pytest.raises(ChannelTimeout, match=r"[Tt]oo many open files"):
                ways(kind, folders)[0]("127.0.0.1:0", wait=4 * SHORT, on_listening=use_up)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert 0 < len(tries) <= 4 * SHORT / reception.RETRY_SECONDS + 2


def test_a_listener_takes_the_peer_once_there_is_room_again(monkeypatch):
    fails = [errno.EMFILE, errno.ENOBUFS, errno.ECONNABORTED]
    real = reception.accept_one

    class Full:
        def accept(self):
            raise OSError(fails.pop(0), "no room")

    monkeypatch.setattr(reception, "accept_one", lambda door: real(Full() if fails else door))
    a, b = meet(tcp.listen, tcp.connect)
    with a, b:
        assert_alive(a, b)
    assert not fails


def test_a_call_goes_on_while_there_are_no_descriptors(monkeypatch):
    class Scarce(socket.socket):
        left = 2

        def __init__(self, family=-1, *args, **options):
            if options.get("fileno") is None and args and Scarce.left:
                Scarce.left -= 1
                raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
            super().__init__(family, *args, **options)

    with tcp.open_listener("127.0.0.1:0") as listener:
        address = listening.address_of(listener)
        monkeypatch.setattr(socket, "socket", Scarce)
        with pytest.raises(ChannelTimeout, match="the greeting"):  # it got through: nobody accepts
            tcp.connect(address, timeout=SHORT, wait=8 * SHORT)
    assert Scarce.left == 0
