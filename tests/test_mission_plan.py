"""A mission's plan: what it means, and a sentence with the line for everything that is wrong in one."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from protocols.mission import KINDS, Mission, PlanError
from protocols.mission.galleries import GalleryPlan
from protocols.scores import SCORES
from protocols.thresholds import threshold_warning

PLAN = """\
name = "corridors"
pairs = [["bob", "alice"],
         ["carol", "alice"]]

[[agents]]
name = "alice"
address = "192.168.1.10:9000"

[[agents]]
name = "bob"
id = 7

[[agents]]
name = "carol"

[descriptors.lidar]
kind = "D5"
keyframes = 300

[descriptors.camera]
score = "cossim_2sqrt"
dim = 64
threshold = 0.75
resolution = "exact"
max_norm = 2.0
keyframes = { alice = 10, bob = 20, carol = 30 }

[budgets]
strikes = 4
"""


@pytest.fixture
def load(tmp_path):
    def load(text, **options):
        path = tmp_path / "mission.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return Mission.load(path, **options)

    return load


def refusal(load, text):
    with pytest.raises(PlanError) as caught:
        load(text)
    return caught.value


# -- what a plan says -------------------------------------------------------------------------------------


def test_a_plan_says_who_meets_whom_with_what(load):
    mission = load(PLAN)
    assert (mission.name, mission.security) == ("corridors", "malicious")
    assert [(agent.name, agent.id, agent.address) for agent in mission.agents] == [
        ("alice", 0, "192.168.1.10:9000"),
        ("bob", 7, "auto"),
        ("carol", 2, "auto"),
    ]
    assert mission.pairs == (("alice", "bob"), ("alice", "carol"))  # party 0 is the one named first
    assert mission.peers("alice") == ["bob", "carol"] and mission.peers("carol") == ["alice"]
    assert mission.agent("bob").id == 7
    lidar, camera = mission.descriptors
    assert (lidar.kind, lidar.purpose.score, lidar.purpose.dim, lidar.threshold) == ("D5", "S10", 1200, 0.42)
    assert lidar.keyframes == {"alice": 300, "bob": 300, "carol": 300} and lidar.turns == 1
    purpose = camera.purpose
    assert camera.kind is None and mission.descriptor("camera") is camera
    assert (purpose.score, purpose.dim, purpose.max_norm, purpose.min_norm) == ("S8", 64, 2.0, 0.0)
    assert purpose.resolution is None and purpose.proof and camera.threshold == 0.75
    assert [gallery.name for gallery in mission.galleries] == ["lidar", "camera"]
    assert mission.gallery("camera").slots(("alice", "carol")) == (10, 30)
    assert mission.budgets.as_json() == {
        "strikes": 4,
        "pairs_per_minute": 1_000_000,
        "matches_per_minute": 60,
    }


def test_all_pairs_meet_where_the_plan_names_none(load):
    mission = load(PLAN.partition("\n\n")[2])
    assert mission.pairs == (("alice", "bob"), ("alice", "carol"), ("bob", "carol"))
    assert mission.name == ""


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_makes_a_gallery_with_a_threshold_that_makes_sense(load, name):
    kind = KINDS[name]
    mission = load(
        f'[[agents]]\nname="a"\n[[agents]]\nname="b"\n[descriptors.x]\nkind = "{name}"\nkeyframes = 3\n'
    )
    (one,) = mission.descriptors
    assert (one.kind, one.purpose.score, one.purpose.dim) == (name, kind.score, kind.dim)
    assert threshold_warning(one.purpose, one.threshold) is None
    assert mission.gallery("x").terms("malicious").dim == kind.dim


def test_every_field_overrides_the_preset(load):
    text = PLAN.replace(
        'kind = "D5"',
        'kind = "D5"\nscore = "S6"\ndim = 20\nthreshold = 0.5\nresolution = "2^-20"\nmax_norm = 3\n'
        "min_norm = 0.5",
    )
    one = load(text).descriptor("lidar")
    purpose = one.purpose
    assert (purpose.score, purpose.dim, one.threshold, purpose.resolution) == ("S6", 20, 0.5, 20)
    assert (purpose.max_norm, purpose.min_norm) == (3.0, 0.5)


@pytest.mark.parametrize("score", SCORES)
def test_scores_go_by_either_name(load, score):
    for name in (score, score.lower(), SCORES[score].title):
        text = PLAN.replace('"cossim_2sqrt"', f'"{name}"')
        assert load(text).descriptor("camera").purpose.score == score


# -- written down and read again --------------------------------------------------------------------------


def test_a_mission_comes_back_from_json_as_it_was(load):
    mission = load(PLAN)
    again = Mission.from_json(json.loads(json.dumps(mission.as_json())))
    assert again == mission and again.digest == mission.digest


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("0.75", "0.76"),
        ("strikes = 4", "strikes = 5"),
        ("carol = 30", "carol = 31"),
        ("id = 7", "id = 8"),
        ('name = "corridors"', 'name = "halls"'),
        ('name = "corridors"', 'security = "semi-honest"'),
        ('["bob", "alice"]', '["bob", "carol"]'),
        ("192.168.1.10", "192.168.1.11"),
        ('"exact"', '"2^-16"'),
    ],
)
def test_plans_that_mean_something_else_have_another_digest(load, before, after):
    assert before in PLAN
    assert load(PLAN.replace(before, after)).digest != load(PLAN).digest


def test_plans_that_are_only_written_otherwise_have_the_same_digest(load):
    text = PLAN.replace("= 300", "= { bob = 300, carol = 3_00, alice = 0x12c } # all alike")
    text = text.replace('["bob", "alice"]', '["alice", "bob"]').replace("\n", "\r\n")
    assert load(b"\xef\xbb\xbf" + text.encode()).digest == load(PLAN).digest


# -- what is refused --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "after", "line", "field", "says"),
    [
        ("strikes", "striks", 29, "budgets.striks", "did you mean 'strikes'?"),
        ("strikes = 4", "strikes = 0", 29, "budgets.strikes", "from 1 to 1,000, not 0"),
        ("strikes = 4", "strikes = true", 29, "budgets.strikes", "not True"),
        ("pairs =", "paris =", 2, "paris", "did you mean 'pairs'?"),
        ('"alice"]]', '"alise"]]', 2, "pairs[1]", "did you mean 'alice'?"),
        ('["carol", "alice"]', '["alice", "bob"]', 2, "pairs[1]", "are a pair already"),
        ('["carol", "alice"]', '["alice", "alice"]', 2, "pairs[1]", "does not meet itself"),
        (',\n         ["carol", "alice"]', "", 2, "pairs", "carol meets nobody"),
        ('["bob", "alice"],', '"bob",', 2, "pairs[0]", "two names in quotes"),
        ('"bob"\nid', '"Alice"\nid', 10, "agents[1].name", "there is a robot 'alice' already"),
        ('name = "carol"', 'name = "-"', 14, "agents[2].name", "1 to 31 letters"),
        ('name = "carol"', 'nam = "carol"', 14, "agents[2].nam", "did you mean 'name'?"),
        ('name = "carol"', "name = 3", 14, "agents[2].name", "a text in quotes, not 3"),
        ('name = "carol"', "id = 3", 13, "agents[2]", "name is missing"),
        ("id = 7", "id = 0", 11, "agents[1].id", "alice has the id 0 already"),
        ("id = 7", "id = 4294967296", 11, "agents[1].id", "to 4,294,967,295"),
        ("192.168.1.10:9000", "192.168.1.10", 7, "agents[0].address", "host:port"),
        ("192.168.1.10:9000", "0.0.0.0:9000", 7, "agents[0].address", "the others cannot call"),
        ("192.168.1.10:9000", "robot:0", 7, "agents[0].address", "1 to 65535"),
        ("id = 7", 'address = "192.168.1.10:9000"', 11, "agents[1].address", "alice listens at"),
        ('"D5"', '"D9"', 17, "descriptors.lidar.kind", "expected one of D1 (DBoW2), D2 (NetVLAD), "),
        ("[descriptors.lidar]", '[descriptors."li dar"]', 16, "descriptors.li dar", "1 to 31 letters"),
        ("[descriptors.lidar]", "[descriptors.Camera]", 20, "descriptors.camera", "is taken"),
        ("keyframes = 300", "", 16, "descriptors.lidar", "keyframes is missing"),
        ("keyframes = 300", "keyframes = 65537", 18, "descriptors.lidar.keyframes", "from 1 to 65,536"),
        ("carol = 30 }", "carl = 30 }", 26, "descriptors.camera.keyframes.carl", "did you mean 'carol'?"),
        (", carol = 30 }", " }", 26, "descriptors.camera.keyframes", "how many carol brings"),
        ('"cossim_2sqrt"', '"S11"', 21, "descriptors.camera.score", "S10 (dotprod)"),
        ("dim = 64", "dim = 64.0", 22, "descriptors.camera.dim", "a whole number"),
        ("dim = 64\n", "", 20, "descriptors.camera", "dim is missing"),
        ("0.75", "nan", 23, "descriptors.camera.threshold", "a finite number, not nan"),
        ("0.75", "1.5", 23, "descriptors.camera.threshold", "lets no pair match"),
        ("0.75", "-1", 23, "descriptors.camera.threshold", "lets every pair match"),
        ('"exact"', '"fine"', 24, "descriptors.camera.resolution", "2^-16, or exact"),
        ("max_norm = 2.0", "max_norm = 0", 25, "descriptors.camera.max_norm", "above 0"),
        (
            "max_norm = 2.0",
            "max_norm = 1\nmin_norm = 2",
            26,
            "descriptors.camera.min_norm",
            "to max_norm = 1",
        ),
        ("max_norm = 2.0", "max_norm = 4e6", 20, "descriptors.camera", "words of more than 57 bits"),
        ("max_norm = 2.0", "turns = 17", 25, "descriptors.camera.turns", "from 1 to 16"),
        (
            '"D5"',
            '"D5"\nthreshold = 2',
            18,
            "descriptors.lidar.threshold",
            "D5 (Scan Context): the threshold 2",
        ),
        ("[[agents]]", "[[agent]]", 5, "agent", "did you mean 'agents'?"),
        ("[descriptors.lidar]", "[descripters.lidar]", 16, "descripters", "did you mean 'descriptors'?"),
        ("[budgets]", "[budget]", 28, "budget", "did you mean 'budgets'?"),
        ('"corridors"', '"corridors"\nsecurity = "honest"', 2, "security", "'malicious', 'semi-honest'"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(load, before, after, line, field, says):
    assert before in PLAN
    error = refusal(load, PLAN.replace(before, after, 1))
    text = str(error)
    assert (error.field, says in text) == (field, True), text
    assert text.startswith(f"{error.file}:{error.line}: {field}: ")
    assert error.line == line


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("[budgets\n", 1, "not valid TOML"),
        ('name = "x\n', 1, "not valid TOML"),
        (PLAN + "strikes = 5\n", 30, "not valid TOML"),
        ('[agents]\nname = "a"\n[agents]\n', 3, "[agents] is there twice; write [[agents]], once for each"),
        ("[a.b]\n[a.b]\n", 2, "not valid TOML: the table [a.b] is there twice"),
        ("a = [\n1,\n", 3, "at the end of the file"),
        (b'name = "x"\nx = "\xff"\n', 2, "UTF-8"),
        ("a = " + "[" * 100_000, None, ""),
        (b"# \n" * 600_000, None, "at most 1 MB"),
        ("", None, "each under [[agents]], not 0"),
        ('agents = "alice"\n', 1, "expected tables, each under [[agents]]"),
        ('[[agents]]\nname = "a"\n[[agents]]\nname = "b"\n', None, "such as [descriptors.lidar]"),
        ('[[agents]]\nname = "a"\n[[agents]]\nname = "b"\n[descriptors]\nx = 3\n', 6, "expected a table"),
    ],
)
def test_what_is_no_plan_is_told(load, text, line, says):
    error = refusal(load, text)
    assert error.line == line and says in str(error)


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(PlanError, match=r"mission.toml: cannot be read: No such file"):
        Mission.load(tmp_path / "mission.toml")


def test_lines_are_told_behind_statements_of_many_lines(load):
    text = PLAN.replace("pairs = [", "pairs = [ # [descriptors.lidar]\n" + "\n" * 50, 1)
    text = text.replace('name = "corridors"', 'name = """\\\n[[agents]]\\\n"""', 1)
    assert refusal(load, text.replace("strikes", "striks")).line == 29 + 51 + 2


@pytest.mark.parametrize("values", [None, [], {"agents": 3}, {"agents": [{"name": None}]}, {"pairs": [[]]}])
def test_json_that_is_no_mission_is_refused(values):
    with pytest.raises(PlanError):
        Mission.from_json(values, "plan.json")


@pytest.mark.parametrize("ask", [Mission.agent, Mission.peers, Mission.descriptor, Mission.gallery])
def test_asking_for_what_the_plan_has_not_names_what_it_has(load, ask):
    with pytest.raises(ValueError, match=r"there are|did you mean"):
        ask(load(PLAN), "lidat")


# -- a keyframe's slot ------------------------------------------------------------------------------------


@pytest.fixture
def camera(load) -> GalleryPlan:
    return load(PLAN).gallery("camera")


def test_a_slot_holds_the_descriptor_as_it_came(camera):
    vector = np.linspace(-0.1, 0.1, 64, dtype=np.float32)
    slot = camera.vector({"camera": vector})
    assert slot.dtype == np.float64 and slot.shape == (64,) and np.array_equal(slot, vector)
    assert np.array_equal(camera.vector({"camera": [vector.tolist()]}), slot)


@pytest.mark.parametrize(
    ("descriptors", "says"),
    [
        ({}, "camera is missing"),
        ({"camra": [0.0] * 64}, "no descriptor 'camra'; did you mean 'camera'?"),
        ({"camera": [0.0] * 63}, r"camera: expected an array of shape \(64,\), got \(63,\)"),
        ({"camera": np.zeros((2, 64))}, "camera: expected an array of shape"),
        ({"camera": 1.0}, "camera: expected an array of shape"),
        ({"camera": [[1.0], [1.0, 2.0]]}, "camera: expected an array of real numbers"),
        ({"camera": ["x"] * 64}, "camera: expected real numbers"),
        ({"camera": np.zeros(64, dtype=complex)}, "camera: expected real numbers"),
        ({"camera": np.zeros(64, dtype=bool)}, "camera: expected real numbers"),
        ({"camera": [float("nan")] * 64}, "camera: .* not finite"),
        ({"camera": [float("inf")] + [0.0] * 63}, "camera: .* not finite"),
        ({"camera": [1.0] * 64}, "camera: .* norm above 2"),
    ],
)
def test_a_bad_descriptor_is_refused_by_name(camera, descriptors, says):
    with pytest.raises(ValueError, match=says):
        camera.vector(descriptors)


def test_a_descriptor_that_was_not_normalised_is_refused(load):
    lidar = load(PLAN).gallery("lidar")
    lidar.vector({"lidar": np.full(1200, 1200**-0.5)})
    with pytest.raises(ValueError, match=r"lidar: .* shorter than 0.99"):
        lidar.vector({"lidar": np.full(1200, 0.01)})


# -- several descriptors a place --------------------------------------------------------------------------

PLACES = (
    PLAN.replace('resolution = "exact"\n', "").replace(
        "keyframes = 300", "keyframes = 300\nturns = 3\ndim = 8"
    )
    + """
[descriptors.key]
kind = "D5-key"
keyframes = 5

[places.everywhere]
of = ["camera", "lidar"]
rule = "all"
"""
)


def test_a_place_is_one_gallery_with_its_descriptors_in_the_order_of_the_plan(load):
    mission = load(PLACES)
    assert [one.name for one in mission.galleries] == ["key", "everywhere"]
    place = mission.gallery("everywhere")
    assert [one.name for one in place.descriptors] == ["camera", "lidar"] and place.rule == "all"
    assert place.keyframes == {"alice": 300, "bob": 300, "carol": 300}  # the most of its descriptors
    terms = place.terms("malicious")
    assert terms.dim == 64 + 3 * 8
    assert terms.rule == "all of camera S8 >= 0.75, lidar S10 >= 0.42 (3 turns), to 2^-16"
    assert place.description()["gallery"] == "everywhere"
    assert Mission.from_json(mission.as_json()) == mission
    assert load(PLACES.replace('"all"', '"any"')).digest != mission.digest


def test_a_place_holds_turn_after_turn(load):
    turns, camera = np.eye(3, 8), np.linspace(-0.1, 0.1, 64)
    place = load(PLACES).gallery("everywhere")
    slot = place.vector({"lidar": turns, "camera": camera})
    assert np.array_equal(slot, np.concatenate([camera, turns.reshape(-1)]))
    with pytest.raises(ValueError, match=r"lidar: expected an array of shape \(3, 8\), got \(8,\)"):
        place.vector({"lidar": turns[0], "camera": camera})
    with pytest.raises(ValueError, match=r"lidar: .* norm above 1"):
        place.vector({"lidar": turns * [[1], [1], [1.1]], "camera": camera})
    with pytest.raises(ValueError, match="lidar is missing: everywhere takes camera, lidar"):
        place.vector({"camera": camera})


def test_a_descriptor_of_several_turns_may_stand_alone(load):
    mission = load(PLACES.partition("[places")[0])
    lidar = mission.gallery("lidar")
    assert lidar.terms("malicious").dim == 24 and not lidar.is_place
    assert lidar.vector({"lidar": np.eye(3, 8)}).shape == (24,)
    assert Mission.from_json(mission.as_json()) == mission


@pytest.mark.parametrize(
    ("before", "after", "field", "says"),
    [
        ('"camera", "lidar"]', '"camera", "lidra"]', "places.everywhere.of", "did you mean 'lidar'?"),
        ('"camera", "lidar"]', '"camera", "camera"]', "places.everywhere.of", "is in the place 'everywhere'"),
        ('["camera", "lidar"]', "[]", "places.everywhere.of", "at least one descriptor"),
        ('["camera", "lidar"]', '"lidar"', "places.everywhere.of", "a list of texts"),
        ('"all"', '"most"', "places.everywhere.rule", "'any', 'all'"),
        ('rule = "all"', "", "places.everywhere", "rule is missing"),
        ("[places.everywhere]", "[places.Lidar]", "places.Lidar", "is taken"),
        (
            "dim = 64",
            'dim = 64\nresolution = "exact"',
            "places.everywhere.of",
            "camera has exact and lidar 2^-16",
        ),
        ("turns = 3", "turns = 3\nmax_norm = 4e6", "descriptors.lidar", "57 bits"),
    ],
)
def test_a_place_that_cannot_be_is_told(load, before, after, field, says):
    assert before in PLACES
    error = refusal(load, PLACES.replace(before, after, 1))
    assert error.field == field and says in str(error) and error.line


def test_descriptors_that_fit_alone_may_not_fit_a_place(load):
    text = PLACES.replace("max_norm = 2.0", "max_norm = 200_000").replace("dim = 64", "dim = 2")
    assert load(text.partition("[places")[0])
    with pytest.raises(PlanError, match="57 bits"):
        load(text.replace("dim = 8", "dim = 800_000"))


# -- what the documentation says --------------------------------------------------------------------------

DOCS = Path(__file__).resolve().parent.parent / "docs"


def test_the_plan_of_the_how_to_can_be_dealt(load):
    (text,) = re.findall(r"^```toml\n(.*?)^```$", (DOCS / "how-to.md").read_text(), re.MULTILINE | re.DOTALL)
    mission = load(text)
    assert [gallery.name for gallery in mission.galleries] == ["lidar", "camera"]
    assert mission.descriptor("lidar").threshold == 0.45
    assert mission.gallery("camera").slots(("bob", "carol")) == (300, 500)


def test_the_reference_names_every_field_and_the_numbers_of_every_kind(load):
    section = (DOCS / "reference.md").read_text().partition("### mission.toml")[2].partition("\n### ")[0]
    spans = set(re.findall(r"`([^`\n]+)`", section))
    values = load(PLACES).as_json()
    tables = [values, values["agents"][0], values["descriptors"]["lidar"], values["budgets"]]
    tables.append(values["places"]["everywhere"])
    named = {key for table in tables for key in table} - {"agents", "descriptors", "places", "budgets"}
    assert named <= spans
    assert {"[[agents]]", "[descriptors.NAME]", "[places.NAME]", "[budgets]"} <= spans
    for kind in KINDS.values():
        row = f"| {kind.score}, {kind.dim}, {kind.threshold} | {kind.min_norm:g} to {kind.max_norm:g} |"
        assert re.search(rf"^\| {kind.name} \|.*{re.escape(row)}$", section, re.MULTILINE), kind
