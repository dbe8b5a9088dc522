"""Jobs in processes: the same results as here, errors as they are, and no process left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from threading import Event, Lock
from typing import Any

import pytest
from loky.backend.process import LokyProcess

from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.machine import child_environment
from graspcascade.studies.executor import LocalExecutor, WorkerError, run_jobs

Report = Callable[[Any], None]


def map_jobs(jobs: Iterable[Any], workers: int) -> Generator[Any, None, None]:
    return LocalExecutor(workers).map(jobs, lambda *said: None)


def count(to: int, report: Report) -> int:
    for number in range(to):
        report(number)
    return to


def own_number(report: Report) -> int:
    return os.getpid()


def fail(error: BaseException, report: Report) -> None:
    raise error


def die(report: Report) -> None:
    os._exit(3)


def be_killed(report: Report) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def answer_what_cannot_be_pickled(report: Report) -> Any:
    return Lock()


def go_on_for_ever(report: Report) -> None:
    report("begun")
    Event().wait()


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[LokyProcess]:
    """Keep every worker that is started."""
    workers: list[LokyProcess] = []
    start = LokyProcess.start

    def start_and_keep(self: LokyProcess) -> None:
        workers.append(self)
        start(self)

    monkeypatch.setattr(LokyProcess, "start", start_and_keep)
    return workers


def all_ended(workers: list[LokyProcess]) -> bool:
    return all(worker.exitcode is not None for worker in workers)


def test_results_and_reports_are_those_of_one_worker(started: list[LokyProcess]) -> None:
    jobs = [partial(count, n) for n in (3, 0, 2, 1)]
    told: dict[int, dict[int, list[int]]] = {1: {}, 2: {}}
    for workers, reports in told.items():
        results = run_jobs(jobs, workers, lambda number, said, kept=reports: kept.setdefault(number, []).append(said))
        assert results == [3, 0, 2, 1]
        assert len(started) == (0 if workers == 1 else 2)
    assert told[1] == told[2] == {0: [0, 1, 2], 2: [0, 1], 3: [0]}
    assert all_ended(started)


def test_more_reports_than_a_pipe_holds_arrive_in_order() -> None:
    told: list[list[int]] = [[], []]
    run_jobs([partial(count, 5000)] * 2, 2, lambda number, said: told[number].append(said))
    assert told == [list(range(5000))] * 2


@pytest.mark.parametrize("take", [run_jobs, lambda jobs, workers: list(map_jobs(iter(jobs), workers))])
def test_jobs_run_elsewhere_in_no_more_processes_than_there_are_jobs(
    take: Callable[[list[Any], int], list[int]], started: list[LokyProcess]
) -> None:
    numbers = take([own_number, own_number], 9)
    assert len(started) == 2
    assert set(numbers) <= {worker.pid for worker in started}
    assert all_ended(started)


def test_one_job_needs_no_process(started: list[LokyProcess]) -> None:
    assert run_jobs([own_number], 9) == [os.getpid()]
    assert run_jobs([], 9) == []
    assert list(map_jobs(iter([own_number, own_number]), 1)) == [os.getpid()] * 2
    assert started == []


@pytest.mark.parametrize("take", [run_jobs, map_jobs])
def test_a_negative_number_of_workers_is_refused(take: Callable[[list[Any], int], Any]) -> None:
    with pytest.raises(InputError, match="got -1"):
        take([own_number], -1)


@pytest.mark.parametrize("error", [FileFormatError("a.parquet is no table"), FloatingPointError("diverged")], ids=repr)
def test_an_error_arrives_as_it_is_and_ends_the_others(error: Exception, started: list[LokyProcess]) -> None:
    with pytest.raises(type(error)) as raised:
        run_jobs([go_on_for_ever, partial(fail, error), go_on_for_ever], 2)
    assert type(raised.value) is type(error)
    assert str(raised.value) == str(error)
    assert "in fail" in str(raised.value.__cause__), "the traceback of the worker"
    assert len(started) == 2
    assert all_ended(started)


@pytest.mark.parametrize(
    ("job", "error", "words"),
    [
        (die, WorkerError, r"ended with .*\b3\b.* before its job was done; if memory ran out"),
        (be_killed, WorkerError, "ended with SIGKILL"),
        (answer_what_cannot_be_pickled, TypeError, "pickle"),
    ],
)
def test_a_process_that_cannot_answer_is_an_error_of_one_line(
    job: Any, error: type[Exception], words: str, started: list[LokyProcess]
) -> None:
    with pytest.raises(error, match=words) as raised:
        run_jobs([go_on_for_ever, job], 2)
    assert len(str(raised.value).splitlines()) == 1
    assert all_ended(started)


def test_an_interrupt_leaves_no_process(started: list[LokyProcess]) -> None:
    def interrupt(number: int, said: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_jobs([go_on_for_ever, go_on_for_ever, go_on_for_ever], 2, interrupt)
    assert len(started) == 2
    assert all_ended(started)


# One result after the other


def test_results_come_in_order_while_jobs_are_taken_only_a_few_ahead() -> None:
    taken: list[int] = []

    def jobs() -> Iterator[Callable[[Report], int]]:
        for number in range(40):
            taken.append(number)
            yield partial(count, number)

    for number, result in enumerate(map_jobs(jobs(), 2)):
        assert result == number
        assert len(taken) <= number + 8
    assert len(taken) == 40


def test_a_generator_that_is_closed_early_leaves_no_process(started: list[LokyProcess]) -> None:
    with closing(map_jobs([own_number, go_on_for_ever, go_on_for_ever], 2)) as results:
        next(results)
    assert len(started) == 2
    assert all_ended(started)


def test_another_executor_stands_behind_the_same_function() -> None:
    class Backwards:
        def map(self, jobs: Iterable[Any], report: Callable[[int, Any], None]) -> Generator[Any, None, None]:
            numbered = list(enumerate(jobs))
            yield from [job(partial(report, number)) for number, job in reversed(numbered)][::-1]

    told: list[tuple[int, int]] = []
    results = run_jobs([partial(count, 1), partial(count, 2)], 5, lambda *said: told.append(said), Backwards())
    assert list(results) == [1, 2]
    assert told == [(1, 0), (1, 1), (0, 0)]
    assert run_jobs([own_number], executor=LocalExecutor(1)) == [os.getpid()]


# Scripts

SCRIPT = """
import os, threading
from graspcascade.studies.executor import run_jobs

print("top", flush=True)

def job(report):
    report("begun")
    LAST_LINE

begun = []

def heard(number, said):
    begun.append(number)
    if len(begun) == 2:
        print("begun", flush=True)

print(run_jobs([job, job], 2, heard))
"""


def start_script(folder: Path, last_line: str) -> subprocess.Popen[str]:
    """Start a script in a session of its own; its output ends when it and all processes it started have ended."""
    path = folder / "script.py"
    path.write_text(SCRIPT.replace("LAST_LINE", last_line))
    # A module that workers must not find in the working directory.
    (folder / "argparse.py").write_text("raise AssertionError('imported from the working directory')")
    return subprocess.Popen(
        [sys.executable, "-P", str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env=child_environment(),
        start_new_session=True,
    )


def test_a_script_needs_no_guard_and_may_define_its_jobs(tmp_path: Path) -> None:
    with start_script(tmp_path, "return 7") as script:
        assert script.communicate(timeout=120) == ("top\nbegun\n[7, 7]\n", "")
    assert script.returncode == 0


@pytest.mark.skipif(os.name != "posix", reason="sends signals to a group of processes")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL], ids=str)
def test_no_process_outlives_a_script_that_is_interrupted_or_killed(tmp_path: Path, number: int) -> None:
    with start_script(tmp_path, "threading.Event().wait()") as script:
        assert script.stdout is not None
        assert [script.stdout.readline() for _ in range(2)] == ["top\n", "begun\n"]
        # Ctrl-C reaches the whole group; a killed process has no chance to end its workers.
        (os.killpg if number == signal.SIGINT else os.kill)(script.pid, number)
        out, err = script.communicate(timeout=120)
    assert script.returncode == -number
    assert out == ""
    if number == signal.SIGINT:
        assert err.count("Traceback") == 1
        assert err.rstrip().endswith("KeyboardInterrupt")
