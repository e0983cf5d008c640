"""The package as it is installed: all of it is there, and it is found from any folder."""

import os
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import numpy
import pytest

from spdz.version import __version__

setuptools = pytest.importorskip("setuptools")
if int(setuptools.__version__.split(".")[0]) < 77:
    pytest.skip("building the package takes setuptools 77 or newer", allow_module_level=True)

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("spdz", "protocols", "dealer", "bench")
BUILD = """
import sys
from setuptools import build_meta
print(getattr(build_meta, sys.argv[1])(sys.argv[2]))
"""


def run(python, *words, cwd):
    """Run Python without this process's own path and site-packages."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    result = subprocess.run(
        [python, *words], cwd=cwd, env=environment, capture_output=True, text=True, timeout=100, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """A folder of a user, in which a clone lies under the name that a package of it has."""
    folder = tmp_path_factory.mktemp("user")
    clone = folder / "spdz"
    clone.mkdir()
    for package in PACKAGES:
        shutil.copytree(ROOT / package, clone / package, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / file, clone)
    return folder


@pytest.fixture(scope="module", params=["build_wheel", "build_editable"])
def installed(request, beside):
    """How it is installed, and an environment's Python with it, and with no other copy of it on the path."""
    out = beside / request.param
    out.mkdir()
    wheel = run(sys.executable, "-c", BUILD, request.param, str(out), cwd=beside / "spdz").splitlines()[-1]
    environment = venv.EnvBuilder(symlinks=True)
    environment.create(out / "venv")
    (site,) = (out / "venv").glob("lib/python*/site-packages")
    with zipfile.ZipFile(out / wheel) as archive:
        archive.extractall(site)
    # The dependencies, from where this process has them; a .pth file in that folder is not read.
    (site / "zz-dependencies.pth").write_text(str(Path(numpy.__file__).parent.parent))
    return request.param, out / "venv" / "bin" / "python"


def test_a_script_beside_a_clone_named_as_the_package_imports_the_package(installed, beside):
    how, python = installed
    script = beside / "script.py"
    script.write_text("import spdz, sys\nprint(spdz.__file__)\nspdz.run_local\n")
    found = Path(run(python, str(script), cwd=beside).strip())
    expected = beside / "spdz" if how == "build_editable" else python.parent.parent
    assert found.is_relative_to(expected) and found.name == "__init__.py"


@pytest.mark.parametrize("words", [["spdz", "--version"], ["spdz.dealer", "--help"], ["bench", "--help"]])
def test_commands_run_from_a_folder_that_holds_the_clone(installed, beside, words):
    printed = run(installed[1], "-m", *words, cwd=beside)
    assert __version__ in printed if "--version" in words else "usage" in printed


def test_a_wheel_holds_every_module_and_file_of_data(installed, tmp_path):
    how, python = installed
    if how == "build_editable":
        pytest.skip("it holds a pointer to the clone")
    (site,) = python.parent.parent.glob("lib/python*/site-packages")
    for package in PACKAGES:
        expected = {
            path.relative_to(ROOT)
            for path in (ROOT / package).rglob("*")
            if path.suffix in (".py", ".typed", ".json", ".css")
        }
        assert {path for path in expected if not (site / path).is_file()} == set()
    assert {path.name for path in site.iterdir() if path.is_dir()} == {
        *PACKAGES,
        f"spdz-{__version__}.dist-info",
    }
