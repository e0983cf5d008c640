"""Missions dealt in tests: small plans, what every dealt mission must be, and two robots that meet in one."""

import os
import signal
import stat
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from bench.parties import free_port
from dealer.team.record import read_header
from dealer.team.room import ROOM, Room
from dealer.team.tasks import tasks_of
from protocols import Gallery
from protocols.mission import Folder, Mission

ROOT = Path(__file__).resolve().parent.parent

TEAM = """\
agents = [{ name = "alice" }, { name = "bob" }, { name = "carol" }]
[descriptors]
lidar = { score = "S10", dim = 6, threshold = 0.5, keyframes = { alice = 3, bob = 18, carol = 5 } }
camera = { score = "S10", dim = 4, threshold = 0.5, keyframes = 2 }
sonar = { score = "S6", dim = 4, threshold = 0.5, min_norm = 0.9, keyframes = 4, turns = 2 }
[places.both]
of = ["lidar", "camera"]
rule = "all"
"""
COUPLE = """\
agents = [{ name = "alice" }, { name = "bob" }]
[descriptors]
lidar = { score = "S10", dim = 3, threshold = 0.5, keyframes = 2 }
"""


def plan(folder, text=TEAM):
    path = folder / "mission.toml"
    path.write_text(text)
    return Mission.load(path)


def check_dealt(out, mission):
    """A finished mission: whole folders, two halves of one dealing for every task, and nothing else."""
    folders = {agent.name: Folder.open(out / agent.name) for agent in mission.agents}
    assert len({folder.mission_id for folder in folders.values()}) == 1
    assert all(folder.mission == mission for folder in folders.values())
    dealings = set()
    for task in tasks_of(mission):
        first, second = task.couple
        halves = [
            read_header(folders[own].tape(peer, task.gallery))
            for own, peer in ((first, second), (second, first))
        ]
        gallery, mission_id = mission.gallery(task.gallery), folders[first].mission_id
        for party, header in enumerate(halves):
            assert (header.agents, header.party, header.mission) == (task.couple, party, mission_id)
            assert header.slots == gallery.slots(task.couple) and header.security == mission.security
            assert header.program == gallery.description()
        assert halves[0].tape == halves[1].tape
        dealings.add(halves[0].tape)
    assert len(dealings) == len(tasks_of(mission))
    for name, folder in folders.items():
        tapes = {path.name for path in folder.tapes()}
        assert {path.name for path in (out / name).iterdir()} == tapes | {
            "ca.pem",
            "cert.pem",
            "key.pem",
            "plan.json",
        }
    room = Room(out, mission, folders[mission.agents[0].name].mission_id)
    left = {path.relative_to(room.path) for path in room.path.rglob("*") if path.is_file()}
    records = {Path("pairs") / task.key / "record.json" for task in tasks_of(mission)}
    assert left == records | {Path("plan.json"), Path("finished.json")}
    assert {path.name for path in out.iterdir()} == {*folders, ROOM, f"{ROOM}.lock"}
    assert_private(out)


def assert_private(out):
    for path in out.rglob("*"):
        mode = stat.S_IMODE(path.lstat().st_mode)
        assert mode == (0o700 if path.is_dir() else 0o600), path


def certificates(out):
    """The robots' certificates, wherever they are now."""
    return {path.parent.name: path.read_bytes() for path in out.rglob("cert.pem")}


def meet(out, mission, couple, gallery, state):
    """Two robots compare places over TLS; checks what they find against the clear decisions."""
    chosen = mission.gallery(gallery)
    places = [keyframes(chosen, count) for count in chosen.slots(couple)]
    port = free_port()

    def robot(party):
        own, peer = couple[party], couple[1 - party]
        where = {"listen" if party == 0 else "connect": f"127.0.0.1:{port}"}
        tape = Folder.open(out / own).tape(peer, gallery)
        terms = chosen.terms(mission.security)
        with Gallery(tape, terms=terms, wait=20, state_dir=state / own, **where) as one:
            one.add(places[party])
            return {tuple(map(int, match)) for match in one.step().matches}

    with ThreadPoolExecutor() as pool:
        first, second = pool.map(robot, (0, 1))
    thresholds = {one.name: one.threshold for one in chosen.descriptors}
    expected = {tuple(map(int, match)) for match in np.argwhere(chosen.purpose.plain(*places, thresholds))}
    assert first == {(own, peer) for peer, own in second} == expected
    assert 0 < len(expected) < len(places[0]) * len(places[1])


def keyframes(gallery, count):
    """Places of which each other one is near to all the others that are even."""
    rng, rows = np.random.default_rng(count), []
    for number in range(count):
        descriptors = {}
        for one in gallery.descriptors:
            near = np.ones(one.purpose.dim) if number % 2 == 0 else rng.standard_normal(one.purpose.dim)
            turns = near + 0.05 * rng.standard_normal((one.turns, one.purpose.dim))
            turns *= -1 if number % 2 else 1
            descriptors[one.name] = turns / np.linalg.norm(turns, axis=1, keepdims=True)
        rows.append(gallery.vector(descriptors))
    return np.array(rows)


def run_python(code, *words, **options):
    """Start another process on some lines of Python, with this tree and the tests on its path."""
    path = os.pathsep.join(map(str, (ROOT, ROOT / "tests")))
    environment = os.environ | {"PYTHONPATH": path, "PYTHONWARNINGS": "error"}
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, words)]
    return subprocess.Popen(
        command,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(
            signal.SIGINT, signal.SIG_DFL
        ),  # ignored where a shell runs us behind
        **options,
    )
