"""Whether grasps can be put where they are asked for."""

from __future__ import annotations

from pathlib import Path

from ..errors import InputError


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
