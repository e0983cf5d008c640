"""Two sessions over a memory channel, each in its own thread."""

from concurrent.futures import ThreadPoolExecutor

from dealer.tapes import deal_tapes
from spdz.channels import memory_pair
from spdz.session import Session
from spdz.tape import Tape

AGENTS = ("alice", "bob")


def deal(folder, program, shapes, jobs, security="malicious", description=None):
    """Deal into ``folder`` and return both tape paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = (folder / "alice.tape", folder / "bob.tape")
    deal_tapes(paths, AGENTS, program, shapes, jobs, security, description=description)
    return paths


def state_dirs(folder):
    """Two robots do not share a home."""
    return [folder / "state-alice", folder / "state-bob"]


def run_pair(paths, states, *works, channels=None, timeout=5.0):
    """Open a session a party and run ``works[i](session)``; returns results or exceptions, in order."""
    ends = channels or memory_pair(timeout=timeout)
    works = works if len(works) == 2 else works * 2

    def party(index):
        try:
            with Session(Tape.open(paths[index], state_dir=states[index]), ends[index]) as session:
                return works[index](session)
        except Exception as error:
            return error
        finally:
            ends[index].close()

    with ThreadPoolExecutor(2) as pool:
        futures = [pool.submit(party, index) for index in (0, 1)]
        return [future.result(timeout=30) for future in futures]
