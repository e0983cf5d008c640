"""One side of a gallery in a process of its own, which a test may kill: arguments are folder and address."""

import sys
from pathlib import Path

import numpy as np
from gallery_session_helpers import Mission, Product, unit_vectors

from spdz.channels import tcp
from spdz.readings.gallery import Terms

TERMS, SLOTS, STEPS = Terms(Product(), 4), (40, 40), 5


def descriptors(party):
    return unit_vectors(np.random.default_rng(party), 24, 4)


def missing(session):
    """Which descriptors are in no slot yet, once what was broken off is finished."""
    held = {row.tobytes() for row in session.plain(session.filled)}
    rows = np.rint(descriptors(session.party) * 65536).astype(np.int64)
    return [i for i, row in enumerate(rows) if row.tobytes() not in held]


def some_steps(session):
    """What either side does in a session: always as many steps."""
    session.step()
    for _ in range(STEPS):
        session.add(descriptors(session.party)[missing(session)[:3]])
        session.step()
    return missing(session)


if __name__ == "__main__":
    mission = Mission(Path(sys.argv[1]), TERMS)
    with mission.open(0, tcp.connect(sys.argv[2], timeout=10, wait=10)) as gallery:
        some_steps(gallery)
