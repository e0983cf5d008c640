"""A robot that is killed in the middle of its steps, on a real disk and a real connection, comes back."""

import random
import subprocess
import sys
import threading
import time
from pathlib import Path
from queue import SimpleQueue

import numpy as np
from gallery_session_helpers import no_errors, table
from gallery_worker import SLOTS, TERMS, descriptors, missing, some_steps

from spdz.channels import tcp
from spdz.foundations.errors import SpdzError

KILLS = 5


def meet_worker(mission, kill_after):
    """One session with a worker, which is killed after so many seconds of it; both sides' errors are told."""
    found, outcome = SimpleQueue(), []

    def side():
        try:
            channel = tcp.listen("127.0.0.1:0", timeout=10, wait=20, on_listening=found.put)
            with mission.open(1, channel) as session:
                started.set()
                outcome.append(some_steps(session))
        except SpdzError as error:
            outcome.append(error)
        finally:
            started.set()

    started = threading.Event()
    thread = threading.Thread(target=side, daemon=True)
    thread.start()
    script = Path(__file__).with_name("gallery_worker.py")
    command = [sys.executable, str(script), str(mission.folder), found.get(timeout=10)]
    worker = subprocess.Popen(command, cwd=script.parents[1], stderr=subprocess.PIPE, text=True)
    try:
        if kill_after is not None:
            started.wait(30)
            time.sleep(kill_after)
            worker.kill()
        thread.join(60)
        errors = worker.communicate(timeout=30)[1]
    finally:
        worker.kill()
        worker.wait()
    assert not thread.is_alive()
    return outcome[0], errors


def test_a_robot_that_is_killed_again_and_again_loses_nothing(galleries):
    mission, rng = galleries(TERMS, SLOTS), random.Random(7)
    for _ in range(KILLS):
        outcome, errors = meet_worker(mission, rng.uniform(0.0, 0.15))
        assert isinstance(outcome, list | SpdzError), (outcome, errors)
    for _ in range(4):
        outcome, errors = meet_worker(mission, None)
        assert not isinstance(outcome, SpdzError), (outcome, errors)
    found = no_errors(mission.meet(look))
    (first, rows), (second, columns) = found
    first, second = first[np.ix_(rows, columns)], second[np.ix_(columns, rows)].T
    score = descriptors(0) @ descriptors(1).T
    assert np.array_equal(first, second) and (first != -1).all()
    assert (first == (score >= 0.5))[np.abs(score - 0.5) > 2e-4].all()


def look(session):
    assert not missing(session)
    place = {row.tobytes(): s for s, row in zip(session.filled, session.plain(session.filled), strict=True)}
    rows = np.rint(descriptors(session.party) * 65536).astype(np.int64)
    return table(session, session.results()), [place[row.tobytes()] for row in rows]
