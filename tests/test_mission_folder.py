"""A robot's folder: what the dealer wrote is opened, and what is not as it wrote it is told with a remedy."""

import json
import shutil

import pytest

from dealer.team.deal import deal_team
from protocols.mission import Folder, Mission
from protocols.mission.folder import PLAN_FILE

PLAN = """\
pairs = [["alice", "bob"], ["alice", "carol"]]
agents = [{ name = "alice" }, { name = "bob" }, { name = "carol" }]
[descriptors]
lidar = { score = "S10", dim = 3, threshold = 0.5, keyframes = 2 }
camera = { score = "S10", dim = 4, threshold = 0.5, keyframes = 2 }
"""


@pytest.fixture(scope="module")
def dealt(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dealt")
    (folder / "mission.toml").write_text(PLAN)
    deal_team(folder / "m", Mission.load(folder / "mission.toml"), workers=1)
    return folder / "m"


@pytest.fixture
def alice(dealt, tmp_path):
    return shutil.copytree(dealt / "alice", tmp_path / "elsewhere")


def test_a_robot_finds_its_plan_and_its_tapes_wherever_the_folder_is(dealt, alice):
    folder = Folder.open(str(alice))
    assert folder.robot == "alice" and folder.peers == ["bob", "carol"] and folder.path == alice
    assert folder.mission == Mission.load(dealt.parent / "mission.toml")
    assert folder.tape("carol", "camera") == alice / "carol.camera.tape"
    assert {path.name for path in alice.iterdir()} == {
        "ca.pem",
        "cert.pem",
        "key.pem",
        "plan.json",
        *(f"{peer}.{gallery}.tape" for peer in ("bob", "carol") for gallery in ("lidar", "camera")),
    }
    others = [Folder.open(dealt / name) for name in ("bob", "carol")]
    assert {folder.mission_id} == {other.mission_id for other in others}
    assert [other.peers for other in others] == [["alice"], ["alice"]]


def test_a_robot_asks_for_tapes_that_there_are(alice):
    folder = Folder.open(alice)
    with pytest.raises(ValueError, match="alice does not meet 'dave', but bob, carol"):
        folder.tape("dave", "lidar")
    with pytest.raises(ValueError, match="no gallery 'lidra'; did you mean 'lidar'"):
        folder.tape("bob", "lidra")


def change(folder, **fields):
    file = folder / PLAN_FILE
    file.write_text(json.dumps(json.loads(file.read_text()) | fields))


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (shutil.rmtree, "is no folder"),
        (lambda folder: (folder / PLAN_FILE).unlink(), "no readable plan.json"),
        (lambda folder: (folder / PLAN_FILE).write_text("{"), "a damaged plan.json; copy the folder again"),
        (lambda folder: (folder / PLAN_FILE).write_bytes(b"\xff"), "a damaged plan.json"),
        (lambda folder: (folder / PLAN_FILE).write_text("[]"), "another plan.json"),
        (lambda folder: (folder / PLAN_FILE).write_bytes(b" " * (5 << 20)), "another plan.json"),
        (lambda folder: change(folder, extra=1), "another plan.json"),
        (lambda folder: change(folder, mission={}), "plan.json: a mission has 2 to"),
        (lambda folder: change(folder, robot="dave"), "the plan has no robot 'dave'"),
        (lambda folder: change(folder, robot=["alice"]), "the plan has no robot"),
        (lambda folder: change(folder, id="x"), "no mission's id"),
        (lambda folder: change(folder, robot="bob"), "the certificate in .* is of 'alice'"),
        (lambda folder: (folder / "key.pem").unlink(), "key.pem"),
        (lambda folder: (folder / "ca.pem").write_text("x"), "ca.pem cannot be used"),
        (
            lambda folder: (folder / "bob.camera.tape").unlink(),
            "lacks bob.camera.tape: .* not copied as a whole",
        ),
        (
            lambda folder: [tape.unlink() for tape in folder.glob("*.tape")],
            r"lacks bob.lidar.tape, bob.camera.tape, carol.lidar.tape and 1 more",
        ),
    ],
)
def test_a_folder_that_is_not_as_it_was_dealt_is_told(alice, damage, says):
    damage(alice)
    with pytest.raises(ValueError, match=says):
        Folder.open(alice)


def test_a_tape_of_another_dealing_is_told_by_its_name(alice, dealt, tmp_path):
    deal_team(tmp_path / "other", Mission.load(dealt.parent / "mission.toml"), workers=1)
    shutil.copy(tmp_path / "other" / "alice" / "carol.lidar.tape", alice)
    with pytest.raises(
        ValueError, match=r"carol.lidar.tape: this tape is of another dealing: copy the folder"
    ):
        Folder.open(alice)


def test_a_tape_whose_header_is_damaged_is_left_to_its_peer(alice):
    (alice / "carol.lidar.tape").write_bytes(b"x" * 5000)
    assert Folder.open(alice).robot == "alice"


def test_credentials_of_another_run_are_told(alice, dealt, tmp_path):
    deal_team(tmp_path / "other", Mission.load(dealt.parent / "mission.toml"), workers=1)
    shutil.copy(tmp_path / "other" / "alice" / "ca.pem", alice)
    with pytest.raises(ValueError, match="different runs of the dealer"):
        Folder.open(alice)
