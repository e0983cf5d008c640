"""The dealer's command for galleries: what it foresees is what it deals, and nothing half done stays."""

import json
import shutil
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from gallery_memory import TwoTapes

from dealer import cli, folders, gallery_cli, gallery_mission, gallery_plan
from dealer.gallery_limits import gallery_memory
from dealer.gallery_mission import deal_galleries, gallery_mission_bytes, headers_for
from dealer.gallery_plan import Seconds, gallery_cost
from protocols import Part, PlacePurpose, memory
from protocols.catalog import GalleryPurpose
from protocols.place_purpose import purpose_of
from protocols.scores import SCORES
from spdz.channels.frames import HEADER_BYTES
from spdz.foundations.errors import Unsent
from spdz.gallery import GalleryTape
from spdz.gallery.format import TAG
from spdz.rounds.mac_check import DIGEST_BYTES
from spdz.tape.envelope import SECTOR

AGENTS = ("alice", "bob")
PLACE = PlacePurpose((Part("lidar", "S10", 4, 2), Part("depth", "S6", 3, max_norm=2.0)), "all")
SECURITIES = ["malicious", "semi-honest"]


def words(text, *more):
    return [*f"--agents alice bob --score S10 --dim 8 {text}".split(), *map(str, more)]


def unit(rows, dim, seed=0):
    vectors = np.random.default_rng(seed).standard_normal((rows, dim))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


# -- what is foreseen -------------------------------------------------------------------------------------


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize(
    ("purpose", "slots"),
    [
        (GalleryPurpose("S10", 5), (1, 1)),
        (GalleryPurpose("S10", 5, resolution=None, proof=False), (17, 2)),
        (GalleryPurpose("S6", 5, "score", 3.0, min_norm=1.0), (5, 33)),
        (GalleryPurpose("S2", 4), (4, 3)),
        (GalleryPurpose("S4", 4, max_norm=9.0), (2, 3)),
        (GalleryPurpose("S7", 4), (3, 20)),
        (PLACE, (17, 3)),
    ],
    ids=lambda value: value.score if isinstance(value, GalleryPurpose) else None,
)
def test_tapes_are_as_large_as_the_plan_says(tmp_path, purpose, slots, security):
    cost = gallery_cost(AGENTS, purpose, slots, security, timed=False)
    deal_galleries(tmp_path / "m", AGENTS, purpose, slots, security)
    paths = tmp_path / "m" / "alice" / "bob.tape", tmp_path / "m" / "bob" / "alice.tape"
    sizes = tuple(path.stat().st_size for path in paths)
    assert cost.tape_bytes == sizes
    assert gallery_mission_bytes(AGENTS, purpose, slots, security) == sum(sizes)
    larger = max(sizes)
    rows, columns = cost.capacity
    of_slots = rows * cost.descriptor_tape_bytes[0] + columns * cost.descriptor_tape_bytes[1]
    for path in paths:
        with GalleryTape.open(path, state_dir=tmp_path / path.parent.name) as tape:
            bands = tape.header.bands.counts
            frame = (sum(bands) + 3) * SECTOR + bands[0] * bands[1] * TAG
            assert 0 <= larger - of_slots - rows * columns * cost.pair_tape_bytes <= frame
            assert tape.header.capacity == cost.capacity and tape.header.slots == slots
            assert purpose_of(tape.header.program) == purpose


OPENED = {
    f"{reveal} of {name}": GalleryPurpose(name, 6, reveal, proof=False)
    for name in ("S10", "S6", "S8", "S3")
    for reveal in ("bit", "score")
}


@pytest.mark.parametrize("what", [*OPENED, "places"])
def test_bytes_sent_are_those_that_the_plan_says(tmp_path, what):
    """Checks are the rounds that the malicious mode has more, where norms are not proved."""
    purpose, slots = OPENED.get(what, replace(PLACE, proof=False)), (8, 16)
    costs = {s: gallery_cost(AGENTS, purpose, slots, s, timed=False) for s in SECURITIES}
    rounds = {}
    for security in reversed(SECURITIES):
        cost, terms = costs[security], purpose.dealt_terms(security)
        tapes = filled(tmp_path / security, terms, slots)
        stats = tapes.couple.stats
        rounds[security] = stats[0].rounds
        checks = rounds[security] - rounds["semi-honest"]
        for party in (0, 1):
            payload = stats[party].bytes_sent - rounds[security] * HEADER_BYTES - checks * DIGEST_BYTES
            sent_words = slots[party] * purpose.dim * -(-terms.word_bits // 8)
            assert payload + sent_words == cost.bytes_sent[party]


def filled(folder, terms, slots):
    """A gallery with all slots filled and compared; dealt anew where a mask does not suit its vector."""
    for attempt in range(5):
        with ExitStack() as stack:
            tapes = TwoTapes(stack, folder / str(attempt), terms, slots)
            try:
                x, y = (tapes.fill(owner, unit(count, terms.dim)) for owner, count in enumerate(slots))
            except Unsent:
                continue
            tapes.compare(x, y)
            return tapes
    raise AssertionError("no mask suits")


@pytest.mark.parametrize("name", SCORES)
def test_every_score_can_be_timed(name):
    terms = GalleryPurpose(name, 6).dealt_terms("malicious")
    plan = gallery_plan.measure_gallery(terms)
    try:
        seconds = gallery_plan._trial(terms, plan, (9, 40))
    except Unsent:  # a mask that does not suit its vector: one of 49, each once in 2^16 times
        seconds = gallery_plan._trial(terms, plan, (9, 40))
    assert min(seconds.deal_descriptor, seconds.deal_pair, seconds.fill, seconds.compare) > 0


def test_times_and_one_more_add_up():
    purpose, slots = GalleryPurpose("S10", 1536), (300, 500)
    cost = gallery_cost(AGENTS, purpose, slots, "malicious", timed=False)
    assert cost.dealing_seconds is cost.matching_seconds is None and cost.one_more(0)[1] is None
    assert cost.descriptor_bytes == (1536 * 6 + 16 + 1 / 8,) * 2  # words of 44 bits, c and a bit
    assert cost.pair_bytes == 16 + 1 / 8
    timed = replace(cost, seconds=Seconds(2.0, 0.5, 3.0, 0.25))
    assert timed.capacity == (304, 512)
    assert timed.dealing_seconds == 816 * 2 + 304 * 512 * 0.5
    assert timed.matching_seconds == 800 * 3 + 150_000 * 0.25
    assert timed.one_more(0) == (1536 * 6 + 16 + 1 / 8 + 500 * (16 + 1 / 8), 3 + 500 * 0.25)
    assert timed.one_more(1) == (1536 * 6 + 16 + 1 / 8 + 300 * (16 + 1 / 8), 3 + 300 * 0.25)


MEMORY = """
import sys, pathlib
from dealer.gallery import deal_gallery
from protocols.catalog import GalleryPurpose
score, dim, rows, columns, security, folder = sys.argv[1:]
def status(key):
    for line in open("/proc/self/status"):
        if line.startswith(key):
            return int(line.split()[1]) * 1024
terms = GalleryPurpose(score, int(dim)).dealt_terms(security)
before = status("VmRSS")
paths = pathlib.Path(folder) / "a", pathlib.Path(folder) / "b"
deal_gallery(paths, ("a", "b"), terms, (int(rows), int(columns)))
print(status("VmHWM") - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="memory is read from /proc")
@pytest.mark.parametrize(
    ("score", "dim", "slots", "security"),
    [
        ("S10", 8192, (64, 1024), "malicious"),
        ("S7", 1024, (64, 600), "malicious"),
        ("S2", 64, (16, 32), "malicious"),
        ("S1", 512, (32, 16), "semi-honest"),
    ],
)
def test_dealing_takes_no_more_memory_than_foreseen(tmp_path, score, dim, slots, security):
    run = [sys.executable, "-c", MEMORY, score, str(dim), *map(str, slots), security, str(tmp_path)]
    taken = int(subprocess.run(run, capture_output=True, text=True, check=True, timeout=60).stdout)
    purpose = GalleryPurpose(score, dim)
    foreseen, _ = gallery_memory(
        purpose.dealt_terms(security), headers_for(("a", "b"), purpose, slots, security)[0]
    )
    assert taken <= foreseen <= 3 * taken + (64 << 20)


# -- the command ------------------------------------------------------------------------------------------


def test_a_mission_of_three_robots(tmp_path, capsys):
    status = cli.main(
        [
            *"--agents a b c --score S6 --dim 4 --slots 3x5 --min-norm 0.5 --json --out".split(),
            str(tmp_path / "m"),
        ]
    )
    captured = capsys.readouterr()
    assert status == 0, captured
    told = json.loads(captured.out)
    assert told["slots"] == [3, 5] and told["capacity"] == [3, 5] and told["pairs"] == 3
    assert told["resolution"] == "2^-16" and told["min_norm"] == 0.5 and told["max_norm"] == 1.0
    for robot, others in (("a", "bc"), ("b", "ac"), ("c", "ab")):
        folder = tmp_path / "m" / robot
        assert {path.name for path in folder.iterdir()} == {
            *(f"{other}.tape" for other in others),
            *("ca.pem", "cert.pem", "key.pem"),
        }
        assert told["bytes"][str(folder)] == sum(path.stat().st_size for path in folder.iterdir())
    headers = []
    for path in tmp_path.glob("m/*/*.tape"):
        with GalleryTape.open(path, state_dir=tmp_path / "s") as tape:
            headers.append(tape.header)
    assert len({header.mission for header in headers}) == 1 and len({header.tape for header in headers}) == 3
    assert all(header.agents == tuple(sorted(header.agents)) for header in headers)


def test_a_plan_is_a_table_and_writes_nothing(tmp_path, capsys):
    assert cli.main(words("--slots 20x30 --plan --out", tmp_path / "m")) == 0
    captured = capsys.readouterr()
    assert "nothing was written" in captured.out and "all 20x30" in captured.out
    assert "20 of alice x 30 of bob" in captured.out and "costs nothing" in captured.out
    assert "norm at most 1" in captured.err
    assert not (tmp_path / "m").exists()
    rows = {line.split()[0] for line in captured.out.splitlines() if line.startswith("  ")}
    assert {"sent", "tape", "deal", "match"} <= rows


@pytest.mark.parametrize(
    ("score", "says"), [("S8", "slots that were being prepared and the pairs"), ("S7", "prepared")]
)
def test_a_plan_says_what_an_interruption_costs(capsys, score, says):
    assert cli.main([*words("--slots 4x4 --plan --quiet"), "--score", score]) == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "interruption" in line)
    assert says in line and ("pairs" in line) is (score == "S8")


def test_a_plan_as_json_is_one_object(capsys):
    assert cli.main([*words("--slots 20x30 --plan --json --quiet"), "--resolution", "exact"]) == 0
    told = json.loads(capsys.readouterr().out)
    cost = gallery_cost(AGENTS, GalleryPurpose("S10", 8, resolution=None), (20, 30), "malicious", timed=False)
    assert told["tape_bytes"] == list(cost.tape_bytes) and told["mission_bytes"] == sum(cost.tape_bytes)
    assert told["resolution"] == "exact" and told["slots"] == [20, 30]
    assert told["seconds"]["compare"] > 0 and told["dealing_seconds"] > 0
    assert told["one_more_bytes"] == [cost.one_more(0)[0], cost.one_more(1)[0]]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("--slots 3x3 --tile 2x2", "--tile is for jobs"),
        ("--slots 3x3 --spare 2", "--spare is for jobs"),
        ("--slots 3x3 --meetings 2", "--meetings is for maps"),
        ("--slots 3x3 --count 9", "not allowed with"),
        ("--slots 3x3 --maps 3x3", "not allowed with"),
        ("--slots 3", "MxK"),
        ("--slots 0x3", "MxK"),
        ("--slots 3x3 --resolution 16", "2^-16"),
        ("--count 3 --resolution exact", "--slots"),
        ("--count 3 --min-norm 0.5", "--slots"),
        ("--maps 3x3 --no-norm-proof", "--slots"),
    ],
)
def test_options_that_do_not_go_together(tmp_path, capsys, text, says):
    assert cli.main(words(f"{text} --out", tmp_path / "m")) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "m").exists()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("--max-norm 4194304 --dim 1536", "57 bits"),
        ("--min-norm 2", "min_norm"),
        ("--slots 70000x1", "65536"),
        ("--score S2 --dim 4096", "of tape"),
        ("--resolution 2^-99", "2^-62"),
        ("--agents alice alice", "different robots"),
    ],
)
@pytest.mark.parametrize("plan", ["", "--plan"])
def test_what_cannot_be_dealt_is_one_sentence(tmp_path, capsys, text, says, plan):
    assert cli.main([*words("--slots 3x3 --out", tmp_path / "m"), *text.split(), *plan.split()]) == 2
    error = capsys.readouterr().err
    assert says in error and "Traceback" not in error
    assert not (tmp_path / "m").exists()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("--score S6", "--min-norm"),
        ("--no-norm-proof", "probe"),
        ("--resolution 2^-4", "32 steps"),
        ("", "norm at most 1"),
    ],
)
def test_notes(capsys, text, says):
    assert cli.main([*words("--slots 3x3 --plan"), *text.split()]) == 0
    assert says in capsys.readouterr().err
    assert cli.main([*words("--slots 3x3 --plan --quiet"), *text.split()]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "text", ["--score S6 --min-norm 0.9", "--score S6 --security semi-honest", "--score S8"]
)
def test_no_note_where_there_is_nothing_to_say(capsys, text):
    assert cli.main([*words("--slots 3x3 --plan --max-norm 1"), *text.split()]) == 0
    assert capsys.readouterr().err == ""


# -- what fails leaves nothing ----------------------------------------------------------------------------


def test_half_a_mission_is_removed(tmp_path, monkeypatch, capsys):
    dealt = []

    def fail(*arguments, **options):
        if dealt:
            raise OSError(28, "No space left on device", "x")
        dealt.append(gallery_mission_deal(*arguments, **options))

    gallery_mission_deal = gallery_mission.deal_gallery
    monkeypatch.setattr(gallery_mission, "deal_gallery", fail)
    out = tmp_path / "m"
    status = cli.main([*"--agents a b c --score S10 --dim 4 --slots 3x5 --out".split(), str(out)])
    assert status == 2 and len(dealt) == 1 and not out.exists()
    assert "No space left" in capsys.readouterr().err


def test_dealt_material_is_never_overwritten(tmp_path, capsys):
    out = tmp_path / "m"
    assert cli.main(words("--slots 3x3 --quiet --out", out)) == 0
    before = (out / "alice" / "bob.tape").read_bytes()
    assert cli.main(words("--slots 3x3 --quiet --out", out)) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert (out / "alice" / "bob.tape").read_bytes() == before


def test_too_full_a_disk_and_too_little_memory_are_told_beforehand(tmp_path, monkeypatch, capsys):
    with monkeypatch.context() as patch:
        patch.setattr(folders.shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10**6, 0, 10**4))
        assert cli.main(words("--slots 3x3 --out", tmp_path / "m")) == 2
        assert "fewer slots" in capsys.readouterr().err
    monkeypatch.setattr(memory, "available_memory", lambda: 10**6)
    assert cli.main(words("--slots 3x3 --out", tmp_path / "m")) == 2
    assert "deal fewer slots" in capsys.readouterr().err
    assert not (tmp_path / "m").exists()


def test_progress_is_of_all_pairs_of_robots(tmp_path):
    seen = []
    deal_galleries(
        tmp_path / "m",
        ["a", "b", "c"],
        GalleryPurpose("S10", 4),
        (17, 3),
        progress=lambda done, total: seen.append((done, total)),
    )
    assert seen[-1][0] == seen[-1][1] == 3 * 18 * 3
    assert [done for done, _ in seen] == sorted({done for done, _ in seen})


def test_a_large_mission_is_announced(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(gallery_cli, "_LARGE", 10)
    assert cli.main(words("--slots 3x3 --out", tmp_path / "m")) == 0
    captured = capsys.readouterr()
    assert "writing about 72.4 kB in all" in captured.err and "3 x 3 descriptors" in captured.out
