"""Files and folders are whole under their name, or as they were, and have one writer; unreadable JSON is named."""

import errno
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.files import (
    LOCK_FILE,
    holds_nothing,
    read_json,
    sole_writer,
    write_folder_staged,
    write_staged,
    write_text,
)


class CutOffError(BaseException):
    """Stand for an interrupt from the keyboard, which no `except Exception` would see."""


def half_a_file(staged: Path) -> None:
    staged.write_text("half")
    raise CutOffError


def half_a_folder(staged: Path) -> None:
    (staged / "inner").mkdir()
    half_a_file(staged / "inner" / "file")


def nothing(_: Path) -> None:
    raise CutOffError


def tree(folder: Path) -> dict[str, bytes | None]:
    """Give every file and folder below one, files with what they hold."""
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.mark.parametrize("before", [None, "old"])
@pytest.mark.parametrize("write", [half_a_file, nothing])
def test_a_file_whose_writing_breaks_off_is_as_it_was(
    tmp_path: Path, before: str | None, write: Callable[[Path], None]
) -> None:
    path = tmp_path / "file.txt"
    if before is not None:
        path.write_text(before)
    found = tree(tmp_path)
    with pytest.raises(CutOffError):
        write_staged(path, write)
    assert tree(tmp_path) == found


@pytest.mark.parametrize("there", [False, True])
@pytest.mark.parametrize("write", [half_a_folder, nothing])
def test_a_folder_whose_writing_breaks_off_is_as_it_was(
    tmp_path: Path, there: bool, write: Callable[[Path], None]
) -> None:
    path = tmp_path / "folder"
    if there:
        path.mkdir()
    found = tree(tmp_path)
    with pytest.raises(CutOffError):
        write_folder_staged(path, write)
    assert tree(tmp_path) == found


def test_a_text_that_cannot_be_written_leaves_the_earlier_one(tmp_path: Path) -> None:
    write_text(tmp_path / "file.txt", "old")
    with pytest.raises(UnicodeEncodeError):
        write_text(tmp_path / "file.txt", "half a pair: \ud800")
    assert tree(tmp_path) == {"file.txt": b"old"}


def test_a_name_is_not_taken_before_the_writing_is_done(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    path.write_text("old")

    def write(staged: Path) -> None:
        staged.write_text("new")
        assert path.read_text() == "old"

    write_staged(path, write)
    assert tree(tmp_path) == {"file.txt": b"new"}


def test_a_folder_that_holds_something_is_not_replaced(tmp_path: Path) -> None:
    kept = tmp_path / "folder" / "mine"
    write_text(kept, "mine")
    with pytest.raises(OSError, match="not empty"):
        write_folder_staged(tmp_path / "folder", lambda staged: (staged / "file").write_text("new"))
    assert tree(tmp_path) == {"folder": None, "folder/mine": b"mine"}


@pytest.mark.parametrize("stale", [write_text, lambda path, text: write_text(path / "inner" / "file", text)])
def test_what_a_killed_process_of_the_same_number_left_is_no_hindrance(
    tmp_path: Path, stale: Callable[[Path, str], None]
) -> None:
    for name in ("file", "folder"):
        stale(tmp_path / f".{name}.{os.getpid()}.staged", "half")
    write_staged(tmp_path / "file", lambda staged: staged.write_text("new"))
    write_folder_staged(tmp_path / "folder", lambda staged: (staged / "file").write_text("new"))
    assert tree(tmp_path) == {"file": b"new", "folder": None, "folder/file": b"new"}


def test_texts_are_utf_8_in_folders_made_for_them(tmp_path: Path) -> None:
    write_text(tmp_path / "a" / "b" / "file.txt", "90 % \N{PLUS-MINUS SIGN} 2\n")
    assert (tmp_path / "a" / "b" / "file.txt").read_bytes() == b"90 % \xc2\xb1 2\n"


@pytest.mark.parametrize("content", [None, b"", b'{"cut": ', b"\xff\xfe"])
def test_json_that_cannot_be_read_is_named(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "found.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileFormatError, match=r"found\.json is not a readable JSON file"):
        read_json(path)


def test_files_are_on_disk_before_they_get_their_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flushed: list[str] = []

    def fsync(descriptor: int) -> None:
        flushed.append(os.read(descriptor, 9).decode())
        assert not [path for path in tree(tmp_path) if not path.startswith(".")]

    monkeypatch.setattr(os, "fsync", fsync)
    write_staged(tmp_path / "file", lambda staged: staged.write_text("one"))
    (tmp_path / "file").unlink()
    write_folder_staged(tmp_path / "folder", lambda staged: write_text(staged / "inner" / "file", "two"))
    assert flushed == ["one", "two", "two"], "the file inside is flushed when it is written and with its folder"


# One writer


def elsewhere(folder: Path, then: str = "pass") -> subprocess.CompletedProcess[str]:
    """Ask another process for the folder, and let it do something there."""
    code = (
        f"import os, pathlib, graspcascade.core.files as f\nwith f.sole_writer(pathlib.Path({str(folder)!r})): {then}"
    )
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_another_process_is_kept_out_until_the_writer_is_done(tmp_path: Path) -> None:
    with sole_writer(tmp_path):
        refused = elsewhere(tmp_path)
        assert refused.returncode == 1
        assert f"InputError: another process is writing to {tmp_path}" in refused.stderr
        # A refusal takes nothing from the one who writes.
        with pytest.raises(InputError, match="another process is writing"), sole_writer(tmp_path):
            raise AssertionError
    assert elsewhere(tmp_path).returncode == 0
    assert tree(tmp_path) == {}


def test_a_writer_that_fails_leaves_a_folder_to_others(tmp_path: Path) -> None:
    with pytest.raises(CutOffError), sole_writer(tmp_path / "a" / "b"):
        raise CutOffError
    assert tree(tmp_path) == {"a": None}
    with sole_writer(tmp_path / "a" / "b"):
        assert holds_nothing(tmp_path / "a" / "b")


def test_a_writer_that_crashed_leaves_a_folder_to_others(tmp_path: Path) -> None:
    assert elsewhere(tmp_path, "os._exit(7)").returncode == 7
    assert tree(tmp_path) == {LOCK_FILE: b""}
    assert holds_nothing(tmp_path)
    with sole_writer(tmp_path):
        pass
    assert tree(tmp_path) == {}


LEFT = {".metadata.json.4711.staged": b"half", ".model.4712.staged": None, ".model.4712.staged/file": b"half"}
NOT_LEFT = (".metadata.json.staged", "metadata.json.4711.staged", ".metadata.json.x.staged", ".a.1.staged.txt")


@pytest.fixture
def littered(tmp_path: Path) -> Path:
    """Make a folder that holds what killed processes left half-written."""
    for name, content in LEFT.items():
        if content is not None:
            write_text(tmp_path / name, content.decode())
    return tmp_path


def test_leftovers_of_killed_processes_are_nothing(littered: Path) -> None:
    assert holds_nothing(littered)
    for name in NOT_LEFT:
        write_text(littered / name, "mine")
        assert not holds_nothing(littered)
        (littered / name).unlink()


def test_a_writer_that_is_done_removes_leftovers_and_nothing_else(littered: Path) -> None:
    pytest.importorskip("fcntl")
    for name in NOT_LEFT:
        write_text(littered / name, "mine")
    with sole_writer(littered):
        pass
    assert tree(littered) == dict.fromkeys(NOT_LEFT, b"mine")


def test_a_writer_that_fails_leaves_leftovers_alone(littered: Path) -> None:
    """Whoever refuses a folder for what it holds fails so: the folder may be another's, who is writing."""
    with pytest.raises(CutOffError), sole_writer(littered):
        raise CutOffError
    assert tree(littered) == LEFT


@pytest.fixture(params=[errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK], ids=errno.errorcode.get)
def no_locks(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the file system know no locks."""

    def refuse(*_: object) -> None:
        raise OSError(request.param, "no locks available")

    monkeypatch.setattr("fcntl.flock", refuse)


@pytest.mark.usefixtures("no_locks")
def test_a_file_system_without_locks_keeps_nobody_out(tmp_path: Path) -> None:
    with sole_writer(tmp_path), sole_writer(tmp_path):
        assert tree(tmp_path) == {}
    assert tree(tmp_path) == {}


@pytest.mark.usefixtures("no_locks")
def test_where_nobody_is_kept_out_no_leftovers_are_removed(littered: Path) -> None:
    with sole_writer(littered):
        pass
    assert tree(littered) == LEFT


def test_other_faults_of_a_lock_are_not_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise OSError(errno.EIO, "broken disk")

    monkeypatch.setattr("fcntl.flock", broken)
    with pytest.raises(OSError, match="broken disk"), sole_writer(tmp_path):
        raise AssertionError


def test_a_lock_file_that_was_just_removed_is_not_taken_for_a_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fcntl = pytest.importorskip("fcntl")
    flock = fcntl.flock

    def late(descriptor: int, operation: int) -> None:
        (tmp_path / LOCK_FILE).unlink(missing_ok=True)  # as the writer before does when it is done
        flock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", late)
    with pytest.raises(InputError, match="another process is writing"), sole_writer(tmp_path):
        raise AssertionError
    monkeypatch.undo()
    with sole_writer(tmp_path), pytest.raises(InputError), sole_writer(tmp_path):
        raise AssertionError


def test_a_file_is_no_folder_to_write_to(tmp_path: Path) -> None:
    write_text(tmp_path / "mine.txt", "mine")
    with pytest.raises(InputError, match=r"mine\.txt is not a folder"), sole_writer(tmp_path / "mine.txt"):
        raise AssertionError
    assert tree(tmp_path) == {"mine.txt": b"mine"}
