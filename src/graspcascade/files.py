"""Files and folders that are whole under their name and have one writer; JSON read with a word on what is wrong."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from .errors import FileFormatError, InputError

LOCK_FILE = ".lock"
"""Name of the file by which `sole_writer` keeps others out of a folder."""
_LEFTOVER = re.compile(r"\..+\.\d+\.staged")
"""Names under which files and folders are written; one that stays was left by a process that was killed."""
_NO_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK)
"""What some network file systems answer to a lock; it must not keep anybody from writing there."""


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


def write_json(path: Path, data: Any, *, allow_nan: bool = True) -> None:
    """Write a JSON file, staged; its folder is made if needed.

    Args:
        path: of the file.
        data: anything JSON can hold.
        allow_nan: whether numbers that are not finite may be written, which not every reader takes.

    Raises:
        TypeError, ValueError: JSON cannot hold it.
    """
    write_text(path, json.dumps(data, indent=1, allow_nan=allow_nan) + "\n")


@contextlib.contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Keep everybody else who asks for the same from a folder while the block runs.

    The lock ends with the process, however that ends; its file is then removed or, after a crash, without effect.
    What an earlier writer that was killed left half-written is removed when the block ends well, as the folder is then
    known to be the block's own. Where the system or the file system knows no locks, nobody is kept out and nothing
    removed.

    Args:
        folder: made if needed.

    Raises:
        InputError: another process, or another call in this one, is writing to the folder, or it is no folder.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is not a folder; give an empty or new one")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK_FILE
    descriptor = _lock(path)
    try:
        yield
        if descriptor is not None:
            _remove_leftovers(folder)
    finally:
        if descriptor is not None:
            # Removed while it is still locked: who locks it from here on finds that it has lost its name.
            with contextlib.suppress(OSError):
                path.unlink()
            os.close(descriptor)


def holds_nothing(folder: Path) -> bool:
    """Tell whether a folder is empty but for what `sole_writer` may put there, or a killed writer leave there."""
    return all(path.name == LOCK_FILE or _LEFTOVER.fullmatch(path.name) for path in folder.iterdir())


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        FileFormatError: it is missing or not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileFormatError(f"{path} is not a readable JSON file: {error}") from error


def _lock(path: Path) -> int | None:
    """Open a file and lock it if the file system can; None where the system knows no locks.

    Raises:
        InputError: somebody else holds the lock.
    """
    try:
        import fcntl  # only Unix has it
    except ImportError:
        return None
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            raise InputError(
                f"another process is writing to {path.parent}; wait until it is done, or give another folder"
            ) from None
        except OSError as error:
            os.close(descriptor)
            if error.errno not in _NO_LOCKS:
                raise
            path.unlink(missing_ok=True)
            return None
        if _is_at(descriptor, path):
            return descriptor
        os.close(descriptor)


def _is_at(descriptor: int, path: Path) -> bool:
    """Tell whether an open file still has its name, which whoever held its lock before may have taken from it."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _staged(path: Path) -> Path:
    """Give the name to write under, free of what a killed process of this one's number left there."""
    # Hidden, and of this process alone: others may be writing the same file.
    staged = path.with_name(f".{path.name}.{os.getpid()}.staged")
    _remove(staged)
    return staged


def _remove_leftovers(folder: Path) -> None:
    for path in folder.iterdir():
        if _LEFTOVER.fullmatch(path.name):
            # They are litter, not harm: what cannot be removed must not spoil what was just done.
            with contextlib.suppress(OSError):
                _remove(path)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
