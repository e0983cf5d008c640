"""Dealing on a Dask cluster: workers come and go, and every pair is dealt once all the same."""

import os
import signal
import sys
from contextlib import ExitStack
from types import SimpleNamespace

import pytest
from mission_helpers import COUPLE, check_dealt, meet, plan

from dealer import cli
from dealer.pki import MissionAuthority, write_credentials
from dealer.team import cluster as clusters
from dealer.team.cluster import Cluster, connected, deal_on_cluster
from dealer.team.deal import deal_team
from dealer.team.room import opened_room
from dealer.team.stopped import DealingStopped
from dealer.team.tasks import tasks_of

distributed = pytest.importorskip("distributed")

TEAM = """\
agents = [{ name = "alice" }, { name = "bob" }, { name = "carol" }]
[descriptors]
lidar = { score = "S10", dim = 6, threshold = 0.5, keyframes = 150 }
camera = { score = "S10", dim = 4, threshold = 0.5, keyframes = 6, turns = 2 }
"""


def credentials(folder):
    """An authority of the cluster's own, as its user would make one: its certificate, and a node's."""
    authority = MissionAuthority()
    for name in ("scheduler", "worker", "dealer"):
        write_credentials(folder / name, authority.credentials(name))
    return folder


def files(folder):
    return {"ca": folder / "ca.pem", "cert": folder / "cert.pem", "key": folder / "key.pem"}


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """A cluster of two worker processes that talk TLS, and where it is."""
    folder = credentials(tmp_path_factory.mktemp("cluster"))
    given = {"tls_ca_file": str(folder / "dealer" / "ca.pem"), "require_encryption": True}
    for role, name in (("scheduler", "scheduler"), ("worker", "worker"), ("client", "dealer")):
        given |= {f"tls_{role}_{kind}": str(folder / name / f"{kind}.pem") for kind in ("cert", "key")}
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        host="127.0.0.1",
        protocol="tls://",
        security=distributed.Security(**given),
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    ) as local:
        where = Cluster(local.scheduler_address, **files(folder / "dealer"), wait=20.0)
        yield SimpleNamespace(local=local, where=where)


def test_a_worker_that_is_killed_in_the_middle_changes_nothing_but_the_time(tmp_path, running, monkeypatch):
    monkeypatch.setattr(clusters, "POLL_SECONDS", 0.02)
    mission, out = plan(tmp_path, TEAM), tmp_path / "m"
    killed, seen = [], {}

    def watch(done, total):
        for record in out.rglob("record.json"):
            if record.parent.parent.name == "pairs":
                assert seen.setdefault(record.parent.name, record.read_bytes()) == record.read_bytes()
        dealing = [path for path in out.glob(".dealer/work/*.*") if list(path.glob(".0.tape.*"))]
        if len(dealing) == 2 and not killed:  # both workers are at it
            worker = next(iter(running.local.workers.values()))
            killed.append(worker.process.pid)
            os.kill(killed[0], signal.SIGKILL)

    dealt = deal_team(out, mission, cluster=running.where, progress=watch)
    assert killed and dealt.tasks == 6
    check_dealt(out, mission)
    assert {path.parent.name: path.read_bytes() for path in out.rglob("record.json")}.items() >= seen.items()
    for couple in mission.pairs:
        meet(out, mission, couple, "camera", tmp_path)


def test_what_a_cluster_has_dealt_already_is_not_dealt_again(tmp_path, running):
    mission = plan(tmp_path, COUPLE)
    records = []
    with opened_room(tmp_path / "m", mission) as room:
        for _ in (0, 1):
            deal_on_cluster(
                room, tasks_of(mission), running.where, on_dealt=lambda task: None, poll=lambda: None
            )
            records.append(room.record(tasks_of(mission)[0]))
    assert records[0] == records[1] is not None
    assert deal_team(tmp_path / "m", mission, cluster=running.where).resumed == 1
    check_dealt(tmp_path / "m", mission)


def test_workers_that_do_not_see_the_folder_or_have_another_version_are_told(tmp_path, running, monkeypatch):
    mission, (out, _, version) = plan(tmp_path, COUPLE), (str(tmp_path / "elsewhere"), "", "9.9")
    for about, says in (
        (lambda room: (out, room.mission_id, clusters.__version__), "a worker does not see .*elsewhere"),
        (lambda room: (str(room.out), room.mission_id, version), "the dealer is spdz 9.9"),
    ):
        monkeypatch.setattr(clusters, "_about", about)
        with pytest.raises((ValueError, OSError), match=says):
            deal_team(tmp_path / "m", mission, cluster=running.where)


def test_workers_that_write_where_the_dealer_does_not_see_it_are_told(tmp_path, running, monkeypatch):
    mission = plan(tmp_path, COUPLE)
    with ExitStack() as stack:
        here, there = (stack.enter_context(opened_room(tmp_path / one, mission)) for one in "ab")
        monkeypatch.setattr(
            clusters, "_about", lambda room: (str(there.out), there.mission_id, clusters.__version__)
        )
        monkeypatch.setattr(clusters, "_until", lambda condition, seconds: condition())
        with connected(running.where) as client:
            client.wait_for_workers(1, timeout=20)
        with pytest.raises(OSError, match=r"the dealer does not see .* same folder"):
            monkeypatch.setattr(clusters, "_check_workers", lambda *arguments: None)
            deal_on_cluster(
                here, tasks_of(mission), running.where, on_dealt=lambda task: None, poll=lambda: None
            )


def test_a_cluster_that_is_not_ours_is_not_entered(tmp_path, running):
    other = credentials(tmp_path / "other")
    cluster = Cluster(running.where.address, **files(other / "dealer"), wait=1.5)
    with pytest.raises(DealingStopped, match=r"was not reached within 1.5 s"):
        deal_team(tmp_path / "m", plan(tmp_path, COUPLE), cluster=cluster)


def test_a_cluster_without_workers_is_told(tmp_path):
    with distributed.LocalCluster(
        n_workers=0, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=50
    ) as local:
        cluster = Cluster(local.scheduler_address, wait=0.5)
        assert cluster.address.startswith("tcp://127.0.0.1:")  # plain, on this machine
        with pytest.raises(DealingStopped, match=r"had no worker for 0.5 s"):
            deal_team(tmp_path / "m", plan(tmp_path, COUPLE), cluster=cluster)


def test_the_command_deals_on_a_cluster_of_its_own(tmp_path, capsys):
    mission = plan(tmp_path, COUPLE)
    words = [str(tmp_path / "mission.toml"), "--out", str(tmp_path / "m"), "--scheduler", "local"]
    assert cli.main([*words, "--workers", "1"]) == 0
    assert "dealt 1 gallery for 1 pair of robots" in capsys.readouterr().out
    check_dealt(tmp_path / "m", mission)


# -- without a cluster ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("address", "says"),
    [
        ("tcp://10.0.0.1:8786", "is plain TCP, and whoever is on the network"),
        ("tls://10.0.0.1:8786", "takes --tls-ca, --tls-cert and --tls-key"),
        ("10.0.0.1:8786", "a scheduler is tls://HOST:PORT, or local"),
        ("inproc://10.0.0.1", "a scheduler is tls://HOST:PORT"),
        ("tls://10.0.0.1", "an address is host:port"),
        ("", "a scheduler is tls://HOST:PORT"),
    ],
)
def test_addresses_that_are_not_safe_or_none_are_refused_before_anything_is_written(
    tmp_path, capsys, address, says
):
    plan(tmp_path, COUPLE)
    words = [str(tmp_path / "mission.toml"), "--out", str(tmp_path / "m"), "--scheduler", address]
    assert cli.main(words) == 2
    assert says in capsys.readouterr().err and not (tmp_path / "m").exists()


def test_plain_tcp_is_there_for_who_asks_for_it():
    Cluster("tcp://10.0.0.1:8786", plain=True).check()
    Cluster("tcp://127.0.0.1:8786").check()
    Cluster("tcp://[::1]:8786").check()


def test_files_that_cannot_be_read_are_told(tmp_path):
    cluster = Cluster("tls://10.0.0.1:8786", **files(tmp_path))
    with pytest.raises(ValueError, match=r"ca.pem cannot be read"):
        cluster.check()


def test_without_the_package_the_command_to_install_it_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match="pip install distributed"):
        with connected(Cluster("local")):
            pass


@pytest.mark.parametrize(
    ("status", "error", "kind", "says"),
    [
        ("error", ValueError("as the worker says"), ValueError, "as the worker says"),
        ("error", OSError(28, "No space left on device"), OSError, "No space left"),
        ("error", RuntimeError("KilledWorker"), DealingStopped, "RuntimeError: KilledWorker.* same command"),
        ("cancelled", None, DealingStopped, "the scheduler dropped a task"),
        ("lost", None, DealingStopped, "the scheduler dropped a task"),
    ],
)
def test_a_task_that_fails_is_told_as_what_it_is(status, error, kind, says):
    future = SimpleNamespace(status=status, exception=lambda timeout: error)
    with pytest.raises(kind, match=says):
        clusters.check_future(future)


def test_a_scheduler_that_goes_away_is_not_waited_for_for_ever(monkeypatch):
    client = SimpleNamespace(status="connecting")
    futures, polls = [SimpleNamespace(done=lambda: False)], []
    with pytest.raises(DealingStopped, match=r"have been away for 0.5 s"):
        list(clusters._completed(client, futures, 0.5, lambda: polls.append(1)))
    assert polls
