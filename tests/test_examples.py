"""Every example runs as a newcomer would run it, and says in its first line what it shows."""

import ast
import importlib.util
import os
import runpy
import sys
from pathlib import Path

import pytest

from hand_files import write_hand

FOLDER = Path(__file__).parents[1] / "examples"
EXAMPLES = sorted(FOLDER.glob("*.py"))


def test_the_examples_are_numbered_from_one() -> None:
    assert [path.name[:3] for path in EXAMPLES] == [f"{n:02}_" for n in range(1, len(EXAMPLES) + 1)]
    assert len(EXAMPLES) == 9


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_says_in_one_sentence_what_it_shows(path: Path) -> None:
    text = path.read_text()
    said = ast.get_docstring(ast.parse(text))
    assert said is not None
    assert said.startswith("Shows ")
    assert said.count("\n") == 0
    assert said.endswith(".")
    assert len(text.splitlines()) <= 60


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_prints(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(path)])
    runpy.run_path(str(path), run_name="__main__")
    said = capsys.readouterr().out
    assert said.strip()
    assert "not lifted" not in said
    assert not list(tmp_path.iterdir()), "an example leaves nothing behind"


def test_the_lifting_example_takes_another_model_of_the_hand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # A mesh model of the Shadow Hand where there is one, as the Menagerie's; else the shipped one by another name.
    mesh = os.environ.get("GRASPCASCADE_MESH_HAND")
    entries = {"mjcf": mesh, "prefix": "rh_"} if mesh else {}
    (path,) = (path for path in EXAMPLES if path.name.startswith("08"))
    monkeypatch.setattr(sys, "argv", [str(path), str(write_hand(tmp_path, name="another", **entries))])
    runpy.run_path(str(path), run_name="__main__")
    said = capsys.readouterr().out
    assert said.startswith("another: ")
    assert said.endswith(", lifted\n")


@pytest.mark.parametrize("number", ["04", "05"])
def test_an_example_that_trains_says_in_one_line_what_is_missing(number: str, monkeypatch: pytest.MonkeyPatch) -> None:
    (path,) = (path for path in EXAMPLES if path.name.startswith(number))
    assert "train extra" in path.read_text().splitlines()[0]
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SystemExit, match=r"^.*\.\[train\]'$") as stopped:
        runpy.run_path(str(path), run_name="__main__")
    assert "\n" not in str(stopped.value)
