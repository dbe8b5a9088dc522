"""The rooms: the table of docs/architecture.md and the imports in the code say the same."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src/graspcascade"
FRONT = ("__init__", "__main__")


class Edge(NamedTuple):
    """An import of one room by another."""

    importer: str
    imported: str
    where: str


def read_rooms() -> list[str]:
    page = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    table = page.split("| room |")[1].split("\n\n")[0]
    return re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)


def find_edges(path: Path, text: str) -> Iterator[Edge]:
    """Find the imports of other rooms, wherever in a file they stand."""
    module = [PACKAGE.name, *path.relative_to(PACKAGE).with_suffix("").parts]
    package, importer = module[:-1], module[1]
    for node in ast.walk(ast.parse(text)):
        for target in _targets(node, package):
            if target[0] == PACKAGE.name and len(target) > 1 and target[1] != importer:
                yield Edge(importer, target[1], f"{path.name}:{getattr(node, 'lineno', 0)}")


def _targets(node: ast.AST, package: list[str]) -> list[list[str]]:
    if isinstance(node, ast.Import):
        return [name.name.split(".") for name in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    base = package[: len(package) - node.level + 1] if node.level else []
    module = [*base, *(node.module.split(".") if node.module else [])]
    # `from . import name` at the top of the package names rooms.
    return [module] if len(module) > 1 else [[*module, name.name] for name in node.names]


ROOMS = read_rooms()
EDGES = [edge for path in sorted(PACKAGE.rglob("*.py")) for edge in find_edges(path, path.read_text(encoding="utf-8"))]


def test_every_room_is_in_the_table_and_there_is_nothing_beside_rooms() -> None:
    assert sorted(ROOMS) == sorted(path.name for path in PACKAGE.iterdir() if (path / "__init__.py").is_file())
    assert {path.stem for path in PACKAGE.glob("*.py")} <= set(FRONT)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_from_rooms_above_it(room: str) -> None:
    above = ROOMS[: ROOMS.index(room)]
    wrong = [edge for edge in EDGES if edge.importer == room and edge.imported not in above]
    assert not wrong


def test_an_engine_is_known_by_its_interface_alone() -> None:
    outside = [path for path in PACKAGE.rglob("*.py") if "engines" not in path.relative_to(PACKAGE).parts]
    within = re.compile(r"engines\.(mujoco|physx)")
    assert [path.name for path in outside if within.search(path.read_text(encoding="utf-8"))] == []


def test_proposals_and_engines_never_see_each_other() -> None:
    pair = {"proposals", "engines"}
    assert not [edge for edge in EDGES if {edge.importer, edge.imported} == pair]


def test_only_nets_imports_torch_and_only_at_training() -> None:
    importers = {
        path.relative_to(PACKAGE).parts[0]
        for path in PACKAGE.rglob("*.py")
        if re.search(r"^\s*(import torch|from torch)", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert importers == {"nets"}


@pytest.mark.parametrize(
    ("text", "imported"),
    [
        ("from ..engines import run_trials", "engines"),
        ("from ..engines.mujoco.runner import MujocoEngine", "engines"),
        ("from .. import engines", "engines"),
        ("import graspcascade.engines.mujoco", "engines"),
        ("from graspcascade.engines import run_trials", "engines"),
        ("def f():\n    from ..engines import run_trials", "engines"),
        ("if TYPE_CHECKING:\n    from ..engines import run_trials", "engines"),
    ],
)
def test_imports_are_found_however_they_are_written(text: str, imported: str) -> None:
    (edge,) = find_edges(PACKAGE / "formats" / "some.py", text)
    assert (edge.importer, edge.imported) == ("formats", imported)


@pytest.mark.parametrize("text", ["from .options import held_rates", "from . import options", "import numpy.trials"])
def test_imports_within_a_room_and_of_other_packages_do_not_count(text: str) -> None:
    assert not list(find_edges(PACKAGE / "formats" / "some.py", text))
