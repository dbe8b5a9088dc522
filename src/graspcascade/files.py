"""Files and folders that appear under their final name only when complete; JSON read with a word on what is wrong."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .errors import FileFormatError


def write_staged(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a file beside the final name and move it into place; what breaks off leaves nothing.

    Args:
        path: of the file to write or replace; its folder must exist.
        write: called with the name to write under.
    """
    staged = _staged(path)
    try:
        write(staged)
        staged.replace(path)
    finally:
        staged.unlink(missing_ok=True)


def write_folder_staged(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a new folder beside the final name and move it into place; what breaks off leaves nothing.

    Args:
        path: of the folder, new or empty; its parent must exist.
        write: called with the folder to fill, which is there and empty.
    """
    staged = _staged(path)
    try:
        staged.mkdir()
        write(staged)
        if path.is_dir():
            path.rmdir()
        staged.replace(path)
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, staged; its folder is made if needed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_staged(path, lambda staged: staged.write_text(text, encoding="utf-8"))


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        FileFormatError: it is missing or not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileFormatError(f"{path} is not a readable JSON file: {error}") from error


def _staged(path: Path) -> Path:
    # Hidden, and of this process alone: others may be writing the same file.
    return path.with_name(f".{path.name}.{os.getpid()}.staged")
