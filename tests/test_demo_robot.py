"""One robot of the demo: what it reads, what it shows and accepts, and what becomes of one that fails."""

import sys
import time

import numpy as np
import pytest
from geometry_helpers import hall, seen_from

from bench.demo import exchange
from bench.demo.exchange import DemoFailed
from bench.demo.local_map import payload_of
from bench.demo.plan import DESCRIPTOR, STRIKES, plan_text
from bench.demo.robot import Clock, Verification, read_bag, write_bag
from bench.demo.scan_context import DIMENSION, Background, polar_grid
from protocols.agent import Event, Keyframe, Meeting
from protocols.mission import Mission

pytest.importorskip("scipy")
POSE = (0.7, -0.4, 0.0)


@pytest.fixture(scope="module")
def public():
    generator = np.random.default_rng(31)
    return Background.fit(np.stack([polar_grid(generator.normal(0, 6, (3000, 2))) for _ in range(4)]))


def keyframe(number, points, public):
    return Keyframe(number, public.describe(polar_grid(points)[None])[0], payload_of(points, 0.0))


def test_bag_is_read_as_it_was_written(tmp_path):
    vectors = np.random.default_rng(32).normal(size=(3, 5))
    payloads = (b"one", b"", bytes(range(256)))
    write_bag(tmp_path / "bag.npz", vectors, payloads)
    read = list(read_bag(tmp_path / "bag.npz"))
    np.testing.assert_array_equal([vector for vector, _ in read], vectors)
    assert tuple(payload for _, payload in read) == payloads


def test_submaps_of_one_place_are_verified(public):
    own, other = keyframe(4, hall(1), public), keyframe(9, seen_from(hall(2), POSE), public)
    verification = Verification(public)
    verdict = verification(Meeting("bob", DESCRIPTOR, own, other))
    assert verdict.accepted and verdict.weight > 0.9
    np.testing.assert_allclose(verdict.transform, POSE, atol=0.02)
    assert verification.shown == {9: len(other.payload)} and verification.found == {(4, 9): verdict}
    assert len(verification.seconds) == 1


def test_submap_of_another_place_than_the_one_compared_is_rejected(public):
    own = keyframe(4, hall(1), public)
    elsewhere = np.random.default_rng(33).normal(0, 6, (3000, 2))
    compared = keyframe(9, elsewhere, public).vector
    shown = payload_of(seen_from(hall(2), POSE), 0.0)  # fits, but is not what was compared
    verdict = Verification(public)(Meeting("bob", DESCRIPTOR, own, Keyframe(9, compared, shown)))
    assert not verdict.accepted and "not of the place that was compared" in verdict.why


@pytest.mark.parametrize("payload", [b"", b"nonsense", b"\x80\x04pickle"])
def test_payload_that_is_no_submap_is_rejected(payload, public):
    own = keyframe(4, hall(1), public)
    other = Keyframe(9, np.zeros(DIMENSION), payload)
    assert not Verification(public)(Meeting("bob", DESCRIPTOR, own, other)).accepted


def test_robot_notes_when_it_met_its_peer_and_the_first_trouble():
    clock = Clock()
    for name in ("waiting", "connected", "candidate", "lost", "refused"):
        clock(Event(name, f"it was {name}"))
    assert clock.connected is not None and clock.trouble == "it was lost"


def test_plan_is_one_that_the_dealer_takes(tmp_path):
    pytest.importorskip("rtbdata")
    from test_demo_data import robot

    alice, bob = robot([(0, 0)] * 3), robot([(0, 0)] * 5)
    object.__setattr__(alice, "name", "alice")
    for security in ("malicious", "semi-honest"):
        (tmp_path / "mission.toml").write_text(plan_text(alice, bob, security))
        mission = Mission.load(tmp_path / "mission.toml")
        (gallery,) = mission.galleries
        assert mission.security == security and mission.budgets.strikes == STRIKES
        assert gallery.slots(("alice", "bob")) == (3, 5)
        assert (gallery.descriptors[0].purpose.dim, gallery.descriptors[0].threshold) == (1200, 0.42)


# --- processes that fail ---------------------------------------------------------------------------------


def command(code):
    return [sys.executable, "-c", code]


GOOD = command("print('{\"matches\": []}', flush=True); input()")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ('print(\'{"error": "the line was lost"}\')', "the line was lost"),
        ("raise SystemExit(3)", "see above"),
        ("print('no JSON')", "said what is no answer"),
    ],
)
def test_robot_that_fails_ends_the_demo_with_its_words(code, words, capfd):
    for commands in ([command(code), GOOD], [GOOD, command(code)]):
        with pytest.raises(DemoFailed, match=words):
            exchange._run(commands)


def test_robot_that_hangs_is_ended(monkeypatch):
    monkeypatch.setattr(exchange, "TIMEOUT", 0.5)
    began = time.monotonic()
    with pytest.raises(DemoFailed):
        exchange._run([GOOD, command("import time; time.sleep(600)")])
    assert time.monotonic() - began < 60


def test_robots_are_let_go_when_both_have_told():
    assert (
        exchange._run([command("print('{\"matches\": [1]}', flush=True); input()")] * 2)
        == [{"matches": [1]}] * 2
    )


def test_match_whose_other_half_was_not_shown_ends_the_demo():
    with pytest.raises(DemoFailed, match="keyframe 3 matches, but the peer's was not shown: gone"):
        exchange._verdicts({"matches": [[3, None, "withheld", "gone", None, None]]})
