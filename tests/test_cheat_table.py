"""Every round of every protocol, changed in transit towards either party: the exact error.

The table is party x round x tamper. In malicious mode a changed frame is caught before anything is output,
whichever bit it is; what differs is only by which name. The two transcripts then differ, so this says nothing
about what is opened: a party that lies keeps a transcript that fits, see ``test_insider.py``.
"""

import numpy as np
import pytest

from protocols import is_candidate
from protocols.scores import S6, S10, SCORES
from protocols.textbook import dot_with_scalar_triples, dot_with_vector_triple
from spdz import MacCheckFailed, ProtocolViolation, measure, run_local

X, Y = np.array([0.6, -0.8, 0.0]), np.array([0.0, 1.0, -0.25])
PROGRAMS = {
    "S6": S6,
    "S10": S10,
    "S6 candidate": is_candidate(S6, 1.5),
    "S10 candidate": is_candidate(S10, 0.5),
    "textbook vector triple": dot_with_vector_triple,
    "textbook scalar triples": dot_with_scalar_triples,
}
LONG = {name: score.within(2.0) for name, score in SCORES.items() if name not in ("S6", "S10")} | {
    "S8 candidate": is_candidate(SCORES["S8"].within(2.0), 0.5)
}
P_BYTES = ((1 << 127) - 1).to_bytes(16, "little")


def flip(bit):
    def tamper(frame: bytes) -> bytes:
        position = bit % (8 * len(frame))
        changed = bytearray(frame)
        changed[position // 8] ^= 1 << position % 8
        return bytes(changed)

    return tamper


def bits_changed(*bits):
    """Some bits of the first byte flipped."""
    return lambda frame: bytes([frame[0] ^ sum(1 << bit for bit in bits)]) + frame[1:]


def add_one(frame: bytes) -> bytes:
    """The smallest change that stays a well-formed field element, if the frame holds one."""
    value = (int.from_bytes(frame[:16], "little") + 1) % ((1 << 127) - 1)
    return value.to_bytes(16, "little") + frame[16:]


TAMPERS = {
    "lowest bit": (flip(0), MacCheckFailed),
    "a bit in the middle": (flip(77), MacCheckFailed),
    "last element": (flip(-128), MacCheckFailed),
    "plus one": (add_one, MacCheckFailed),
    "bit 127: not a field element": (flip(127), ProtocolViolation),
    "p itself: not canonical": (lambda frame: P_BYTES + frame[16:], ProtocolViolation),
    "one byte short": (lambda frame: frame[:-1], ProtocolViolation),
    "one byte long": (lambda frame: frame + b"\0", ProtocolViolation),
    "empty": (lambda frame: b"", ProtocolViolation),
    "zeros": (lambda frame: bytes(len(frame)), MacCheckFailed),
}
LENGTHS = {name: TAMPERS[name] for name in ("one byte short", "one byte long", "empty")}
BIT_TAMPERS = LENGTHS | {
    "the bit": (bits_changed(0), MacCheckFailed),
    "a bit beyond the last": (bits_changed(1), ProtocolViolation),
    "the last bit of the byte": (bits_changed(7), ProtocolViolation),
    "the bit and another": (bits_changed(0, 4), ProtocolViolation),
    "another bit": (lambda frame: bytes([1 - frame[0]]), MacCheckFailed),
    "every bit": (lambda frame: bytes([255 - frame[0]]), ProtocolViolation),
}
"""Of a round that opens one bit."""

CHECK_TAMPERS = {name: MacCheckFailed for name in TAMPERS} | {name: ProtocolViolation for name in LENGTHS}


def run_with(program, sender, number, tamper):
    """One run with one frame changed; it fails if the frame was not changed."""
    touched = []

    def attack(at: int, who: int, frame: bytes) -> bytes:
        if (at, who) != (number, sender):
            return frame
        changed = tamper(frame)
        touched.append(changed != frame)
        return changed

    try:
        return run_local(program, X, Y, tamper=attack)
    finally:
        assert touched == [True]


@pytest.mark.parametrize("name", PROGRAMS)
@pytest.mark.parametrize("sender", [0, 1])
def test_a_changed_frame_is_caught_in_every_round(name, sender):
    program = PROGRAMS[name]
    rounds = measure(program, (X.shape, Y.shape), "malicious").rounds
    # The last round is a check; so is the one before the output's if anything was opened before.
    checks = {rounds - 1} if program in (S6, S10) else {rounds - 3, rounds - 1}
    for number in range(rounds):
        tampers = BIT_TAMPERS if "candidate" in name and number == rounds - 2 else TAMPERS
        for what, (tamper, error) in tampers.items():
            with pytest.raises(CHECK_TAMPERS[what] if number in checks else error):
                run_with(program, sender, number, tamper)
                pytest.fail(f"{name}, party {sender}, round {number}, {what}: nothing was raised")


@pytest.mark.parametrize("name", LONG)
@pytest.mark.parametrize("sender", [0, 1])
def test_a_changed_frame_of_a_long_protocol_is_caught_in_every_round(name, sender):
    """Whatever is opened on the way: every round, one bit and one element."""
    program = LONG[name]
    rounds = measure(program, (X.shape, Y.shape), "malicious").rounds
    for number in range(rounds):
        one_bit = "candidate" in name and number == rounds - 2
        for what in ("the bit", "another bit") if one_bit else ("a bit in the middle", "plus one"):
            with pytest.raises(MacCheckFailed):
                run_with(program, sender, number, (TAMPERS | BIT_TAMPERS)[what][0])
                pytest.fail(f"{name}, party {sender}, round {number}, {what}: nothing was raised")


def test_a_hook_that_changes_nothing_raises_nothing():
    result = run_local(S10, X, Y, tamper=lambda number, sender, frame: frame)
    assert result.value == pytest.approx(-0.8, abs=1e-4)


def test_semi_honest_mode_does_not_notice_and_says_so_in_its_name():
    def attack(number: int, sender: int, frame: bytes) -> bytes:
        return add_one(frame) if (number, sender) == (1, 1) else frame

    honest = run_local(S10, X, Y, "semi-honest").value
    assert run_local(S10, X, Y, "semi-honest", tamper=attack).value != honest


def test_a_failed_check_names_no_secret():
    with pytest.raises(MacCheckFailed) as caught:
        run_local(S10, X, Y, tamper=lambda number, sender, frame: flip(0)(frame) if number == 1 else frame)
    assert "tape must not be used again" in str(caught.value)
