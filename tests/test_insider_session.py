"""Networked sessions of several jobs, one an insider's: it is caught, and the honest tape destroyed."""

from queue import SimpleQueue
from unittest.mock import patch

import pytest
from insider import Dealt, Insider, Ledger, truth
from insider_programs import PROGRAMS, X, Y
from lies import ELEMENT, FRAME, PAIR, element, frame, pair
from session_helpers import deal, run_pair, state_dirs

from spdz import MacCheckFailed, TapeDestroyed, run_clear
from spdz.channels.memory import MemoryChannel
from spdz.rounds.mac_check import MacCheck, drive
from spdz.tape import Tape

PAIRS = ((X, Y), (X, X - Y / 8))


class RushingEnd(MemoryChannel):
    """Receives first; what it sends may depend on that."""

    answer = None

    def _begin(self, frame):
        self.frame = frame
        if self.answer is None:
            super()._begin(frame)

    def _finish(self, reader, deadline):
        super()._finish(reader, deadline)
        if self.answer is not None:
            self._outgoing.put(bytes(self.frame[0]) + self.answer(bytes(reader.payload())))


def network_duel(folder, program, evil, lie, follow=True):
    """Two sessions with tapes of their own, one of them an insider's; returns what either came to."""
    paths, states = deal(folder / "mission", program, (X.shape, Y.shape), len(PAIRS)), state_dirs(folder)
    pipes = (SimpleQueue(), SimpleQueue())
    ends = [
        (RushingEnd if party == evil else MemoryChannel)(*pipes[:: 1 - 2 * party], 20.0) for party in (0, 1)
    ]

    def mac_check(alpha, party, session):
        return (Ledger if party == evil else MacCheck)(alpha, party, session)

    def frames(protocol, check, post):
        if not isinstance(check, Ledger):
            return drive(protocol, check, post)
        insider = Insider(protocol, check, lie, follow=follow)
        ends[evil].answer = insider.answer
        return insider.frames()

    def work(session):
        return session.run_many(program, [inputs[session.party] for inputs in PAIRS]).value

    with patch("spdz.session.agreement.MacCheck", mac_check), patch("spdz.session.session.drive", frames):
        outcomes = run_pair(paths, states, work, channels=ends)
    return outcomes, (paths[1 - evil], states[1 - evil])


@pytest.mark.parametrize("evil", [0, 1])
def test_a_session_with_an_insider_that_tells_the_truth_is_right(tmp_path, evil):
    program = PROGRAMS["S4 candidate"]
    outcomes, (path, state) = network_duel(tmp_path, program, evil, truth)
    assert outcomes[1 - evil] == [run_clear(program, *inputs).value for inputs in PAIRS] == [False, True]
    Tape.open(path, state_dir=state).close()


@pytest.mark.parametrize("follow", [False, True])
@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("name", ["dot", "S2 candidate", "beaver_dot"])
def test_a_session_catches_an_insider_and_destroys_its_tape(tmp_path, name, evil, follow):
    for number, size in Dealt(PROGRAMS[name], *PAIRS).honest.openings.items():
        lies = {
            "in the last lane": element(number, size - 1, ELEMENT["plus 1"]),
            "cancelling between the lanes": pair(number, 0, size // 2, PAIR["cancelling"], 1 | 1 << 60),
            "in all lanes": frame(number, FRAME["all plus a random number"], 1 | 1 << 60),
        }
        for what, lie in lies.items():
            outcomes, (path, state) = network_duel(
                tmp_path / f"{number} {what}", PROGRAMS[name], evil, lie, follow
            )
            assert type(outcomes[1 - evil]) is MacCheckFailed, (number, what, outcomes)
            with pytest.raises(TapeDestroyed):
                Tape.open(path, state_dir=state)
