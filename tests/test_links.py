"""Links: what a line does to packets, emulations over true sockets, and the figures beside a comparison."""

import json
import os
import socket
import struct
import subprocess
import sys
import threading

import pytest
from channel_helpers import together

from bench.links import cli
from bench.links.emulation import VIAS, carried, possible
from bench.links.link import LINKS, QUEUE, Line, Link
from bench.links.measuring import Cell, LinkError, Timed, checked_probe, figures, trials_for
from bench.links.netem import commands
from bench.links.proxy import proxy_link
from bench.links.tun import PORT, exchanged, from_party
from bench.parties import free_port
from bench.recorded import recorded
from bench.sweep.floor import bare_socket, bare_trials
from spdz import Stats

SLOW = Link("slow", mbit=8, delay_ms=10)  # a byte a microsecond


def links(*words, **variables):
    return subprocess.run(
        [sys.executable, "-m", "bench", "links", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
        env={**os.environ, **variables},
    )


# What a link is


def test_packets_leave_one_after_the_other_and_arrive_after_the_delay():
    line = Line(SLOW, 0)
    assert line.arrival(5.0, 1000) == pytest.approx(5.011)
    assert line.arrival(5.0, 1000) == pytest.approx(5.012)  # waits for the first
    assert line.arrival(6.0, 500) == pytest.approx(6.0105)  # the line is free again


def test_a_full_queue_drops_what_comes():
    line = Line(SLOW, 0)
    assert None not in [line.arrival(0.0, 1000) for _ in range(QUEUE)]
    assert line.arrival(0.0, 1000) is None
    assert line.arrival(1.0, 1000) is not None


def test_so_many_packets_are_lost_as_the_link_loses():
    line = Line(Link("l", 1000, 0, loss=0.02), 1)
    lost = sum(line.arrival(float(number), 100) is None for number in range(20_000))
    assert 300 < lost < 500


@pytest.mark.parametrize(
    "wrong", [(0, 1, 0), (-1, 1, 0), (float("inf"), 1, 0), (1, -1, 0), (1, 1, 1), (1, 1, -0.1)]
)
def test_what_no_link_is_cannot_be(wrong):
    with pytest.raises(ValueError, match="a link needs"):
        Link("l", *wrong)


def test_the_least_time_is_the_delays_and_what_the_bytes_take():
    assert SLOW.least_ms(3, 2000) == pytest.approx(32.0)


def test_mp_spdz_takes_half_its_calls_and_all_its_bytes_at_least():
    (figure,) = (one for one in recorded("S4", 1536, "malicious") if one.engine.startswith("MP-SPDZ"))
    radio = LINKS["radio"]
    expected = figure.rounds / 2 * radio.delay_ms + figure.bytes_sent * 8 / 1000
    assert cli.mp_spdz_least(radio, "S4", 1536, "malicious") == pytest.approx(expected)
    assert cli.mp_spdz_least(radio, "S4", 17, "malicious") is None


def test_robots_have_thin_far_and_lossy_links():
    assert (LINKS["wifi"].mbit, LINKS["wifi"].delay_ms) == (20, 5)
    assert (LINKS["radio"].mbit, LINKS["radio"].delay_ms) == (1, 50)
    assert 2 * LINKS["satellite"].delay_ms == 600
    assert LINKS["lossy"].loss == 0.02


# Emulations


def packet(source, destination, from_port, to_port):
    """A packet of TCP over IPv4 without checksums."""
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 40, 0, 0, 64, 6, 0, bytes(source), bytes(destination))
    return ip + struct.pack(">HHIIBBHHH", from_port, to_port, 0, 0, 0x50, 0, 0, 0, 0)


def ones_sum(data):
    total = sum(struct.unpack(f">{len(data) // 2}H", data))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return total


def test_exchanged_addresses_leave_every_checksum_right():
    here, there = (
        packet((10, 77, 0, 1), (10, 77, 0, 2), 40000, PORT),
        packet((10, 77, 0, 2), (10, 77, 0, 1), 40000, PORT),
    )
    assert exchanged(here) == there and exchanged(there) == here
    assert ones_sum(here[:20]) == ones_sum(there[:20])


def test_the_sender_of_a_packet_is_known_by_the_listeners_port():
    assert from_party(packet((1, 1, 1, 1), (2, 2, 2, 2), PORT, 40000)) == 0
    assert from_party(packet((1, 1, 1, 1), (2, 2, 2, 2), 40000, PORT)) == 1
    assert from_party(b"\x60" + bytes(60)) is None  # IPv6
    assert from_party(b"\x45" + bytes(60)) is None  # not TCP


def test_netem_is_told_rate_delay_and_loss_for_either_direction():
    text = "\n".join(commands(LINKS["lossy"]))
    assert text.count("netem limit 1000 delay 5ms rate 20000000bit loss 2.0%") == 2
    assert f"sport {PORT}" in text and "loss" not in "\n".join(commands(LINKS["wifi"]))


def test_the_proxy_holds_both_directions_as_the_link_does():
    target = free_port()
    with proxy_link(SLOW, target) as port:
        start = threading.Barrier(2)

        def party(index, where):
            with bare_socket(index, where) as sock:
                start.wait(10)
                return bare_trials(sock, index, [(1, 0), (0, 1), (20_000, 20_000)], 1, 0)

        seconds = together(lambda: party(0, target), lambda: party(1, port))
    least = SLOW.least_ms(3, 20_000) / 1e3
    assert max(max(one) for one in seconds) >= 0.95 * least


def test_the_proxy_carries_the_end_of_a_connection():
    with (
        socket.create_server(("127.0.0.1", 0)) as listener,
        proxy_link(SLOW, listener.getsockname()[1]) as port,
    ):
        with socket.create_connection(("127.0.0.1", port), timeout=10) as caller:
            taken, _ = listener.accept()
            with taken:
                caller.sendall(b"last words")
                caller.shutdown(socket.SHUT_WR)
                taken.settimeout(10)
                assert taken.makefile("rb").read() == b"last words"


def test_a_proxy_loses_nothing_and_says_so():
    assert carried(LINKS["lossy"], "proxy").loss == 0.0
    assert carried(LINKS["lossy"], "tun").loss == 0.02


def test_a_link_that_is_too_quick_is_refused():
    trip = checked_probe(SLOW, 1000, [0.021, 0.5, 0.022], 0.03, 0.03)
    assert trip == pytest.approx(22.0)
    with pytest.raises(LinkError, match="too quick"):
        checked_probe(SLOW, 1000, [0.012], 0.03, 0.03)
    with pytest.raises(LinkError, match="--via"):
        checked_probe(SLOW, 100_000, [0.021], 0.2, 0.03)


# Measuring


def test_a_trial_is_the_slower_partys_and_the_median_counts():
    first = Timed([0.001, 0.005, 0.002], [0.001] * 3, Stats(rounds=3, bytes_sent=10))
    second = Timed([0.002, 0.003, 0.003], [0.002] * 3, Stats(rounds=3, bytes_sent=12))
    found = figures(first, second)
    assert (found.ms, found.max_ms, found.floor_ms, found.trials) == (3.0, 5.0, 2.0, 3)
    assert (found.bytes_sent, found.rounds) == (12, 3)


def test_a_slow_link_gets_fewer_trials_and_at_least_one():
    cell = Cell("S10", 1536, "malicious")
    assert trials_for(cell, LINKS["wifi"], 10, 4.0) == 10
    assert 1 <= trials_for(cell, LINKS["satellite"], 10, 4.0) < 10
    assert trials_for(cell, LINKS["satellite"], 10, 0.01) == 1
    assert trials_for(Cell("S10", 1536, None), LINKS["satellite"], 10, 4.0) == 10


@pytest.mark.parametrize("via", VIAS)
def test_a_comparison_over_a_link_takes_as_long_as_its_rounds_at_least(via):
    if not possible(via):
        pytest.skip(f"this machine does not let this user emulate a link by {via}")
    words = "--rate 100 --delay 4 --loss 0.001 --score S10 --dim 16 --trials 3 --json".split()
    result = links(*words, "--via", via)
    assert result.returncode == 0, result.stderr
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [row["security"] for row in rows] == ["malicious", "semi-honest"]
    for row in rows:
        assert set(row) == set(cli.LinkRow.__slots__)
        assert (row["link"], row["delay_ms"], row["via"]) == ("own", 4.0, via)
        assert row["loss"] == (0.0 if via == "proxy" else 0.001)
        assert row["ms"] >= 0.95 * 4 * row["rounds"] and row["max_ms"] >= row["ms"]
        assert row["floor_ms"] >= 0.95 * 4 * row["rounds"] and row["plain_ms"] >= 0.95 * 4
        assert row["round_trip_ms"] >= 0.95 * 8
        assert row["mp_spdz_least_ms"] == pytest.approx(
            cli.mp_spdz_least(Link("own", 100, 4), "S10", 16, row["security"])
        )


def test_the_table_says_what_is_not_emulated():
    result = links(*"--rate 100 --delay 1 --loss 0.5 --score S10 --dim 16 --trials 1 --via proxy".split())
    assert result.returncode == 0, result.stderr
    assert "NOT emulated" in result.stdout and "by proxy" in result.stdout


@pytest.mark.parametrize(
    "words", ["--delay 3", "--loss 0.1", "--rate 0", "--rate 1 --loss 1", "--trials 0", "--dim 0"]
)
def test_what_cannot_be_measured_is_refused(words):
    result = links(*words.split())
    assert result.returncode == 2 and "usage" in result.stderr


def test_a_machine_without_the_tools_uses_the_proxy_and_refuses_the_others(tmp_path):
    assert links(*"--rate 9 --via tun".split(), PATH=str(tmp_path)).returncode == 2
    words = "--rate 100 --delay 1 --score S10 --dim 16 --trials 1 --security malicious --json".split()
    result = links(*words, PATH=str(tmp_path))
    assert result.returncode == 0 and json.loads(result.stdout)["via"] == "proxy"


def test_help_teaches():
    text = links("--help").stdout
    assert "ONE WAY" in text and "NO LOSS" in text and "calls / 2 x delay" in text and "examples:" in text
