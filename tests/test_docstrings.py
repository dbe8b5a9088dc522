"""Docstrings: every example runs as written, and public names are described plainly."""

import ast
import doctest
import importlib
import pkgutil
import re
from pathlib import Path

import pytest

import graspcascade

PACKAGE = Path(graspcascade.__file__).parent
MODULES = sorted(
    info.name for info in pkgutil.walk_packages([str(PACKAGE)], "graspcascade.") if not info.name.endswith("__main__")
)
WITH_EXAMPLES = [
    name
    for name in MODULES
    if ">>>" in Path(importlib.util.find_spec(name).origin).read_text(encoding="utf-8")  # type: ignore[union-attr, arg-type]
]
PRIVATE_WORDS = re.compile(r"\b(lane|crew|studio|leap|leapt|whoever|amid)\b", re.IGNORECASE)


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_examples_in_docstrings_run(name: str) -> None:
    pytest.importorskip("torch") if ".nets." in name else None
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted
    assert not result.failed


def _docstrings(name: str) -> list[tuple[str, str]]:
    tree = ast.parse(Path(importlib.util.find_spec(name).origin).read_text(encoding="utf-8"))  # type: ignore[union-attr, arg-type]
    kinds = (ast.FunctionDef, ast.ClassDef, ast.AsyncFunctionDef, ast.Module)
    nodes = [node for node in ast.walk(tree) if isinstance(node, kinds)]
    return [(getattr(node, "name", name), text) for node in nodes if (text := ast.get_docstring(node))]


@pytest.mark.parametrize("name", MODULES)
def test_docstrings_use_no_private_words(name: str) -> None:
    wrong = [where for where, text in _docstrings(name) if PRIVATE_WORDS.search(text)]
    assert not wrong
