"""Memory: estimates hold, what does not fit is refused in words, and running out of it is one line."""

import subprocess
import sys
from pathlib import Path

import pytest

from dealer import cli
from dealer.limits import check_job
from protocols import memory
from protocols.catalog import Purpose
from protocols.memory import available_memory, in_bytes, require_memory
from spdz import measure

LINUX = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")

PROBE = """
import os, sys
from pathlib import Path
from dealer.limits import dealing_memory
from dealer.tapes import deal_tapes
from protocols.catalog import Purpose
from protocols.costs import job_cost, matching_memory
from spdz.console.command import keep_large_arrays_on_the_heap

def peak():
    line = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
    return 1024 * int(line.split()[1])

os.environ["OPENBLAS_NUM_THREADS"] = "1"
score, dim, rows, columns, norm, reveal, security, folder = sys.argv[1:]
purpose = Purpose(score, int(dim), reveal, (int(rows), int(columns)), float(norm))
cost = job_cost(purpose, security)
paths = (Path(folder, "a.tape"), Path(folder, "b.tape"))
deal = lambda: deal_tapes(paths, ("a", "b"), purpose.dealt_program, purpose.shapes, 1, security,
                          description=purpose.as_json())
"""

DEAL = """
keep_large_arrays_on_the_heap()
before = peak()
deal()
print(peak() - before, dealing_memory(cost.plan))
"""

MATCH = """
import socket
import numpy as np
from protocols.matching import match
from spdz import open_session

if not os.fork():  # so that dealing leaves no mark on the peak
    deal()
    os._exit(0)
os.wait()
with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    where = "127.0.0.1:%d" % free.getsockname()[1]
party = 1 if os.fork() else 0
count = purpose.tile[party]
own = np.full((count, purpose.dim), 0.5 / purpose.dim)
keep_large_arrays_on_the_heap()
before = peak()
reach = {"listen" if party else "connect": where}
with open_session(paths[party], insecure=True, state_dir=Path(folder, str(party)), **reach) as session:
    match(session, own, 0.5 if reveal == "bit" else None)
if party:
    print(peak() - before, matching_memory(cost, 1, own.size))
else:
    os._exit(0)
"""


def probe(tail, *words):
    result = subprocess.run(
        [sys.executable, "-c", PROBE + tail, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=100,
        check=True,
    )
    return [int(word) for word in result.stdout.split()]


CASES = [
    ("S10", 2048, 48, 48, 1, "bit", "malicious"),
    ("S10", 16, 150, 150, 1, "score", "malicious"),
    ("S2", 600, 6, 6, 1, "bit", "malicious"),
    ("S4", 32, 32, 32, 2.0**22, "bit", "malicious"),
    ("S7", 512, 24, 24, 1, "bit", "semi-honest"),
]


@LINUX
@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_estimate_of_dealing_is_above_the_truth_and_near_it(tmp_path, case):
    truth, estimate = probe(DEAL, *case, tmp_path)
    assert truth <= estimate <= 3 * truth + (20 << 20)


@LINUX
@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_estimate_of_matching_is_above_the_truth_and_near_it(tmp_path, case):
    truth, estimate = probe(MATCH, *case, tmp_path)
    assert truth <= estimate <= 3 * truth + (20 << 20)


def table(folder, name, **lines):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text("".join(f"{key} {value}\n" for key, value in lines.items()))


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine with 5 MB available and a control group two levels deep."""
    proc, groups = tmp_path / "proc", tmp_path / "cgroup"
    table(proc, "meminfo", **{"MemTotal:": "9000 kB", "MemAvailable:": "5000 kB"})
    table(proc / "self", "cgroup", **{"0::/robots/alice": ""})
    (proc / "self" / "cgroup").write_text("1:cpu:/\n0::/robots/alice\n")
    monkeypatch.setattr(memory, "_PROC", proc)
    monkeypatch.setattr(memory, "_CGROUPS", groups)
    return groups


def group(folder, limit, used, cached=0):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "memory.max").write_text(f"{limit}\n")
    (folder / "memory.current").write_text(f"{used}\n")
    (folder / "memory.stat").write_text(f"anon 1\ninactive_file {cached}\n")


def test_what_is_there_is_the_least_of_machine_and_groups(machine):
    assert available_memory() == 5_000 * 1024
    group(machine / "robots" / "alice", "max", 100)
    assert available_memory() == 5_000 * 1024
    group(machine / "robots", 3_000_000, 1_000_000, cached=500_000)
    assert available_memory() == 2_500_000
    group(machine / "robots" / "alice", 1_000, 2_000)
    assert available_memory() == 0


def test_without_proc_the_whole_memory_counts(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "_PROC", tmp_path)
    assert available_memory() > 1 << 20


def test_a_refusal_says_the_need_what_is_there_and_what_to_do(machine):
    require_memory(5_000_000, "dealing one job")
    with pytest.raises(ValueError, match=r"dealing one job needs about 6 MB.*5.12 MB are available.*smaller"):
        require_memory(6_000_000, "dealing one job")


@pytest.mark.parametrize(
    ("size", "shown"),
    [
        (0, "0 bytes"),
        (999, "999 bytes"),
        (1000, "1 kB"),
        (999_900, "1 MB"),
        (1.5e9, "1.5 GB"),
        (5e15, "5,000 TB"),
    ],
)
def test_sizes_have_three_digits(size, shown):
    assert in_bytes(size) == shown


def test_a_job_too_large_for_memory_is_refused_before_anything_is_dealt(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: 30_000_000)
    small = Purpose("S2", 64, max_norm=1.0)
    check_job(measure(small.dealt_program, small.shapes, "malicious"))
    words = f"--agents a b --score S2 --dim 64 --count 400 --tile 20x20 --max-norm 1 --out {tmp_path / 'm'}"
    assert cli.main(words.split()) == 2
    told = capsys.readouterr().err
    assert "needs about" in told and "smaller tile" in told and len(told.splitlines()) == 1
    assert not (tmp_path / "m").exists()


LIMITED = """
import resource, sys
from pathlib import Path
from {module} import main
size = 4096 * int(Path("/proc/self/statm").read_text().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (size + (200 << 20),) * 2)
{before}
sys.exit(main(sys.argv[1:]))
"""


@LINUX
@pytest.mark.parametrize("before", ["", "import protocols.memory as m; m.available_memory = lambda: 1 << 60"])
def test_a_real_limit_ends_the_dealer_in_one_line(tmp_path, before):
    """Foreseen, with status 2; or not foreseen, with status 1."""
    words = "--agents a b --score S2 --dim 1000 --count 400 --tile 20x20 --max-norm 1 --out"
    source = LIMITED.format(module="dealer.cli", before=before)
    result = subprocess.run(
        [sys.executable, "-c", source, *words.split(), str(tmp_path / "m"), "--quiet"],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert (result.returncode, len(result.stderr.splitlines())) == (1 if before else 2, 1), result.stderr
    assert "memory" in result.stderr and "smaller tile" in result.stderr
    assert not list(tmp_path.glob("m/*"))
