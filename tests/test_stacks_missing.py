"""Without the optional packages: one sentence with the command that installs them, and nothing else fails."""

import subprocess
import sys

import pytest

from protocols.stacks.bag import Bag, write_bag
from protocols.stacks.dds import Dds
from protocols.stacks.topics import topics
from protocols.stacks.zenoh import Zenoh

NEEDS = {
    "cyclonedds": (lambda path: Dds(topics()), "pip install cyclonedds; .* use --transport zenoh"),
    "zenoh": (lambda path: Zenoh(topics()), "pip install eclipse-zenoh "),
    "rosbags": (lambda path: Bag(path), "pip install rosbags "),
    "rosbags.rosbag2": (lambda path: write_bag(path, []), "pip install rosbags "),
}


@pytest.mark.parametrize(("module", "made"), NEEDS.items(), ids=NEEDS)
def test_a_package_that_is_missing_is_named_with_its_command(tmp_path, monkeypatch, module, made):
    use, says = made
    for name in [name for name in sys.modules if name == module or name.startswith(f"{module}.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ValueError, match=says):
        use(tmp_path / "bag")


def test_the_commands_load_none_of_them():
    optional = ("cyclonedds", "zenoh", "rosbags")
    code = f"import sys, spdz.__main__ as m; m.parser(); print([n for n in {optional} if n in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=100, check=True
    )
    assert done.stdout.strip() == "[]"
