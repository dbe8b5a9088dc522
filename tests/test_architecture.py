"""The rooms: the table of docs/architecture.md and the imports in the code say the same."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src/graspcascade"
FRONT = "__init__"


class Row(NamedTuple):
    """A row of the table: its rooms, what they import, what they import for types alone."""

    rooms: list[str]
    imports: set[str]
    type_imports: set[str]
    any_above: bool


class Edge(NamedTuple):
    """An import of one room by another."""

    importer: str
    imported: str
    for_types: bool
    where: str


def read_table() -> list[Row]:
    page = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    cells = [line.split("|")[1:-1] for line in page.splitlines() if line.startswith("|")][2:]
    rows = []
    for rooms, _, imports in cells:
        plain, _, types = imports.partition(";")
        rows.append(Row(_quoted(rooms), set(_quoted(plain)), set(_quoted(types)), imports.strip() == "any"))
    return rows


def _quoted(cell: str) -> list[str]:
    return re.findall(r"`(\w+)`", cell)


def room_of(module: list[str]) -> str:
    """Name the room of a dotted module; the package's own is its front."""
    return module[1] if len(module) > 1 else FRONT


def find_edges(path: Path, text: str) -> Iterator[Edge]:
    """Find the imports of other rooms, wherever in a file they stand."""
    module = [PACKAGE.name, *path.relative_to(PACKAGE).with_suffix("").parts]
    package = module[:-1]
    importer = room_of(module)
    tree = ast.parse(text)
    guarded = [
        node for node in ast.walk(tree) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    ]
    for_types = {id(inner) for node in guarded for part in node.body for inner in ast.walk(part)}
    for node in ast.walk(tree):
        for target in _targets(node, package):
            if target[0] == PACKAGE.name and room_of(target) != importer:
                yield Edge(
                    importer, room_of(target), id(node) in for_types, f"{path.name}:{getattr(node, 'lineno', 0)}"
                )


def _targets(node: ast.AST, package: list[str]) -> list[list[str]]:
    if isinstance(node, ast.Import):
        return [name.name.split(".") for name in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    base = package[: len(package) - node.level + 1] if node.level else []
    module = [*base, *(node.module.split(".") if node.module else [])]
    # `from . import name` at the top of the package names rooms.
    return [module] if len(module) > 1 else [[*module, name.name] for name in node.names]


TABLE = read_table()
WORDS = TABLE[0].rooms
EDGES = [edge for path in sorted(PACKAGE.rglob("*.py")) for edge in find_edges(path, path.read_text(encoding="utf-8"))]


def test_every_room_is_in_the_table_once() -> None:
    files = {path.stem for path in PACKAGE.glob("*.py")} - {FRONT}
    folders = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").is_file()}
    assert sorted(room for row in TABLE for room in row.rooms) == sorted(files | folders)


@pytest.mark.parametrize("place", range(1, len(TABLE)), ids=lambda place: TABLE[place].rooms[0])
def test_a_room_imports_what_the_table_says(place: int) -> None:
    row = TABLE[place]
    above = {room for earlier in TABLE[:place] for room in earlier.rooms}
    assert row.imports | row.type_imports <= above, "the table names a room that is not above"
    found = [edge for edge in EDGES if edge.importer in row.rooms and edge.imported not in WORDS]
    if row.any_above:
        assert {edge.imported for edge in found} <= above
        return
    for edge in found:
        allowed = row.imports | row.type_imports if edge.for_types else row.imports
        assert edge.imported in allowed, f"{edge.where} imports {edge.imported}"
    assert row.imports <= {edge.imported for edge in found if not edge.for_types}, (
        "the table names what is not imported"
    )
    assert row.type_imports <= {edge.imported for edge in found if edge.for_types}


def test_a_word_imports_only_words_before_it() -> None:
    for edge in EDGES:
        if edge.importer in WORDS:
            assert edge.imported in WORDS[: WORDS.index(edge.importer)], f"{edge.where} imports {edge.imported}"


def test_the_front_imports_words_and_the_sampler() -> None:
    assert {edge.imported for edge in EDGES if edge.importer == FRONT} <= {*WORDS, "cascade"}


@pytest.mark.parametrize(
    ("text", "imported", "for_types"),
    [
        ("from ..trials import run", "trials", False),
        ("from ..trials.protocol import PAPER", "trials", False),
        ("from .. import trials", "trials", False),
        ("import graspcascade.trials.protocol", "trials", False),
        ("from graspcascade.trials import run", "trials", False),
        ("from graspcascade import trials", "trials", False),
        ("def f():\n    from ..trials import run", "trials", False),
        ("if TYPE_CHECKING:\n    from ..trials import run", "trials", True),
    ],
)
def test_imports_are_found_however_they_are_written(text: str, imported: str, for_types: bool) -> None:
    (edge,) = find_edges(PACKAGE / "formats" / "some.py", text)
    assert (edge.importer, edge.imported, edge.for_types) == ("formats", imported, for_types)


@pytest.mark.parametrize("text", ["from .options import held_rates", "from . import options", "import numpy.trials"])
def test_imports_within_a_room_and_of_other_packages_do_not_count(text: str) -> None:
    assert not list(find_edges(PACKAGE / "formats" / "some.py", text))
