"""Files and folders that appear under their final name only when complete."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from ..errors import InputError


def write_staged(path: Path, write: Callable[[Path], None]) -> None:
    """Let `write` fill a file beside the final name and move it into place.

    Raises:
        InputError: no such folder, or a folder of that name.
    """
    check_file_place(path)
    staged = _staged(path)
    try:
        write(staged)
        staged.replace(path)
    finally:
        staged.unlink(missing_ok=True)


def write_folder_staged(path: Path, write: Callable[[Path], None]) -> None:
    """Let `write` fill a new folder beside the final name and move it into place.

    Raises:
        InputError: no such parent folder, or something of that name that is not an empty folder.
    """
    check_folder_place(path)
    staged = _staged(path)
    try:
        staged.mkdir()
        write(staged)
        if path.is_dir():
            path.rmdir()
        staged.replace(path)
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def check_file_place(path: Path) -> None:
    """Check that a file can be put somewhere.

    Raises:
        InputError: no such folder, or a folder of that name.
    """
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the name of a file")
    _check_parent(path)


def check_folder_place(path: Path) -> None:
    """Check that a new folder can be put somewhere.

    Raises:
        InputError: no such parent folder, or something of that name that is not an empty folder.
    """
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"{path} exists and is not an empty folder; give another name")
    _check_parent(path)


def _check_parent(path: Path) -> None:
    if not path.parent.is_dir():
        raise InputError(f"there is no folder {path.parent} to write {path.name} into")


def _staged(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}.staged")
