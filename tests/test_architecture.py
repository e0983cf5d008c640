"""The imports of the tree, held to the tables of docs/architecture.md."""

import ast
import re
import sys
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PACKAGES = ("spdz", "protocols", "dealer", "bench")
DOORS = {"spdz.__main__", "spdz.dealer", "spdz.local"}
BASE_DEPENDENCIES = {"numpy", "gmpy2", "cryptography", "threadpoolctl", "tomli"}
OPTIONAL = {
    "cyclonedds",
    "distributed",
    "gtsam",
    "ifaddr",
    "matplotlib",
    "rich",
    "rosbags",
    "scipy",
    "zenoh",
    "zeroconf",
}
"""Loaded inside functions only, outside of ``bench``."""
LONGEST_FILE = 320


def table(heading: str) -> list[list[str]]:
    """The rows of the first table under a heading."""
    _, _, section = PAGE.partition(f"## {heading}\n")
    rows = re.findall(r"^\|(.*)\|$", section.partition("\n## ")[0], re.MULTILINE)
    return [[cell.strip() for cell in row.split("|")] for row in rows[2:]]


def names(cell: str) -> list[str]:
    return re.findall(r"`([\w.]+)`", cell)


ALLOWED_PACKAGES = {names(row[0])[0]: set(names(row[1])) for row in table("Packages")}
LAYERS = {row[0]: names(row[0]) for row in table("Layers of the engine")}
ALLOWED_LAYERS = {row[0]: set(names(row[2])) for row in table("Layers of the engine")}


@dataclass(frozen=True)
class Import:
    """One imported module (``spdz`` for a name of the package itself), and when it is loaded."""

    module: str
    at_load: bool


def files() -> dict[str, Path]:
    """Every module of the packages, by its dotted name."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


FILES = files()


def _targets(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        assert node.level == 0, "relative imports hide the layering"
        own = (f"{node.module}.{alias.name}" for alias in node.names)
        return [name if name in FILES else str(node.module) for name in own]
    return []


def _is_for_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)


@cache
def imports(module: str) -> frozenset[Import]:
    """What a module imports, at load or inside functions; imports for type checking alone do not count."""
    found: set[Import] = set()

    def visit(node: ast.AST, at_load: bool) -> None:
        found.update(Import(target, at_load) for target in _targets(node))
        inside = isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
        for child in ast.iter_child_nodes(node):
            if not _is_for_type_checking(child):
                visit(child, at_load and not inside)

    visit(ast.parse(FILES[module].read_text(encoding="utf-8")), True)
    return frozenset(found)


def layer_of(module: str) -> list[str]:
    """The layers that a module of the engine is in: those that name its folder, or the file itself."""
    return [layer for layer, entries in LAYERS.items() if room_of(module) in entries]


def room_of(module: str) -> str:
    """The folder of ``spdz`` that a module lies in, or its own name where it lies in none."""
    return module.split(".")[1]


ENGINE = sorted(module for module in FILES if module.startswith("spdz."))


def test_the_page_names_the_packages_and_their_layers():
    assert tuple(ALLOWED_PACKAGES) == PACKAGES
    assert len(LAYERS) >= 8
    for layer, allowed in ALLOWED_LAYERS.items():
        assert allowed <= set(chain.from_iterable(LAYERS.values())), layer
    for door in DOORS:
        assert f"`{door.replace('.', '/')}.py`" in PAGE


@pytest.mark.parametrize("module", FILES)
def test_packages_import_downward_only(module):
    package = module.split(".")[0]
    for target in imports(module):
        other = target.module.split(".")[0]
        if other not in PACKAGES or other == package or other in ALLOWED_PACKAGES[package]:
            continue
        assert module in DOORS and not target.at_load, f"{module} imports {target.module}"


@pytest.mark.parametrize("module", sorted(DOORS))
def test_every_door_is_used(module):
    assert any(target.module.split(".")[0] in PACKAGES[1:] for target in imports(module))


@pytest.mark.parametrize("module", ENGINE)
def test_every_module_of_the_engine_is_in_one_layer(module):
    assert len(layer_of(module)) == 1, f"{module} is in {layer_of(module) or 'no layer'} of the page"


def test_every_layer_that_the_page_names_exists():
    named = set(chain.from_iterable(LAYERS.values()))
    assert [name for name in sorted(named) if f"spdz.{name}" not in FILES] == []


@pytest.mark.parametrize("module", ENGINE)
def test_layers_import_downward_only(module):
    (layer,) = layer_of(module)
    for target in imports(module):
        assert target.module != "spdz", f"{module} imports a name of the package itself"
        if target.module.startswith("spdz."):
            allowed = {*LAYERS[layer], *ALLOWED_LAYERS[layer]}
            assert room_of(target.module) in allowed, f"{module} imports {target.module}"


def test_layers_form_no_cycle():
    rest = dict(ALLOWED_LAYERS)
    while rest:
        left = set(chain.from_iterable(LAYERS[layer] for layer in rest))
        free = [layer for layer, allowed in rest.items() if not allowed & left]
        assert free, f"a cycle among {sorted(rest)}"
        for layer in free:
            del rest[layer]


def test_modules_load_without_a_cycle():
    loading: list[str] = []
    loaded: set[str] = set()

    def load(module: str) -> None:
        if module in loaded or module not in FILES:
            return
        assert module not in loading, " -> ".join([*loading[loading.index(module) :], module])
        loading.append(module)
        for target in sorted(imports(module), key=lambda entry: entry.module):
            if target.at_load:
                load(target.module)
        loaded.add(loading.pop())

    for module in FILES:
        load(module)
    assert loaded == set(FILES)


@pytest.mark.parametrize("module", [module for module in FILES if not module.startswith("bench")])
def test_only_the_base_dependencies_are_loaded(module):
    for target in imports(module):
        other = target.module.split(".")[0]
        known = other in sys.stdlib_module_names or other in PACKAGES or other in BASE_DEPENDENCIES
        assert known or (other in OPTIONAL and not target.at_load), f"{module} imports {target.module}"


@pytest.mark.parametrize("module", FILES)
def test_no_file_is_longer_than_its_limit(module):
    lines = FILES[module].read_text(encoding="utf-8").count("\n")
    assert lines <= LONGEST_FILE, f"{module} has {lines} lines: one idea a file"
