"""Files and folders that are either complete or absent, a lock that gives a folder one writer, and JSON files."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

from .errors import FileFormatError, InputError, shortened

LOCK_FILE = ".lock"
"""Name of the file by which `sole_writer` keeps others out of a folder."""
_LEFTOVER = re.compile(r"\..+\.\d+\.staged")
"""Temporary names of files and folders being written; one that stays was left by a process that was killed."""
_NO_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK)
"""Errors of file systems without locks, such as some network ones."""


def write_staged(path: Path, write: Callable[[Path], object]) -> None:
    """Have a file written under a temporary name, then rename it; when writing fails, an earlier file stays as it was.

    The folder must exist; `write` is called with the name to write to.
    """
    with _staged(path) as staged:
        write(staged)


def write_folder_staged(path: Path, write: Callable[[Path], object]) -> None:
    """Have a new folder filled under a temporary name, then rename it; when writing fails, nothing of it stays.

    The parent must exist, the folder itself only if empty; `write` is called with the empty folder to fill.
    """
    with _staged(path) as staged:
        staged.mkdir()
        write(staged)


@contextlib.contextmanager
def _staged(path: Path) -> Iterator[Path]:
    # The process id keeps apart processes that write the same file; a killed one with the same id may have left some.
    staged = path.with_name(f".{path.name}.{os.getpid()}.staged")
    _remove(staged)
    try:
        yield staged
        for written in [staged, *staged.rglob("*")]:
            if written.is_file():
                # Otherwise a power cut after the rename could leave the file empty.
                with written.open("rb+") as file:
                    os.fsync(file.fileno())
        if staged.is_dir() and path.is_dir():
            path.rmdir()
        staged.replace(path)
    finally:
        with contextlib.suppress(OSError):
            _remove(staged)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8 as `write_staged` does; its folder is made if needed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_staged(path, lambda staged: staged.write_text(text, encoding="utf-8"))


def write_json(path: Path, data: Any, *, allow_nan: bool = True) -> None:
    """Write a JSON file as `write_text` does; `allow_nan` admits NaN and infinity, which strict readers refuse."""
    write_text(path, json.dumps(data, indent=1, allow_nan=allow_nan) + "\n")


@contextlib.contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Lock a folder for writing while the block runs; others who ask for it are refused at once.

    The folder is made if needed, and removed when nothing was written to it. The lock ends with the process, even when
    that is killed. When the block ends without an error, half-written files of killed writers are removed. On a file
    system without locks nobody is refused and no half-written file removed.

    Raises:
        InputError: another process, or another call in this one, holds the lock, `folder` is a file, or its lock a
            folder.
    """
    # Sampling writes no such folder and should not wait for it to load.
    from filelock import FileLock, Timeout

    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is not a folder; give an empty or new one")
    is_new, path = not folder.exists(), folder / LOCK_FILE
    if path.is_dir():
        raise InputError(f"{path} is a folder, where the file that locks {folder} must be; give another folder")
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(path, blocking=False, fallback_to_soft=False)
    try:
        lock.acquire()
    except Timeout:
        message = f"another process is writing to {folder}; wait until it is done, or give another folder"
        raise InputError(message) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        path.unlink(missing_ok=True)
    try:
        yield
        for leftover in folder.iterdir() if lock.is_locked else ():
            if _LEFTOVER.fullmatch(leftover.name):
                # They do no harm, so one that cannot be removed is no reason to fail.
                with contextlib.suppress(OSError):
                    _remove(leftover)
    finally:
        if lock.is_locked:
            # Unlocked first, it might be another writer's. Who opened it in the meantime sees that it has no name.
            with contextlib.suppress(OSError):
                path.unlink()
            lock.release()
        if is_new:
            # Of a call that was refused nothing stays; a folder that holds something cannot be removed this way.
            with contextlib.suppress(OSError):
                folder.rmdir()


def holds_nothing(folder: Path) -> bool:
    """Tell whether a folder is empty, apart from a lock file and half-written files of killed writers."""
    return all(path.name == LOCK_FILE or _LEFTOVER.fullmatch(path.name) for path in folder.iterdir())


def read_json(path: Path) -> Any:
    """Read a JSON file; a FileFormatError says that it is missing or not JSON."""
    try:
        return parse_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileFormatError(f"{path} is not a readable JSON file: {error}") from error


def parse_json(text: str | bytes, *, allow_nan: bool = True) -> Any:
    """Parse JSON; a FileFormatError says that it is not complete or has a key twice in one object."""

    def refuse(name: str) -> NoReturn:
        raise ValueError(f"{name} is not a JSON number")

    def distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        built = dict(pairs)
        if len(built) < len(pairs):
            ((twice, _),) = Counter(key for key, _ in pairs).most_common(1)
            raise ValueError(f"it has the key {shortened(repr(twice))} twice in one object")
        return built

    try:
        return json.loads(text, object_pairs_hook=distinct, parse_constant=None if allow_nan else refuse)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"not complete JSON ({str(error) or 'nested too deep'})") from error


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
