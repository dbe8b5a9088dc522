"""Jobs in processes: the same results as here, errors as they are, and nobody left behind."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from threading import Event
from typing import Any

import pytest

from graspcascade.errors import FileFormatError, InputError
from graspcascade.workers import WorkerError, run_jobs

Report = Callable[[Any], None]


def count(to: int, report: Report) -> int:
    for number in range(to):
        report(number)
    return to


def whereabouts(report: Report) -> int:
    print("what a job prints is no answer")
    return os.getpid()


def fail(error: Exception, report: Report) -> None:
    raise error


def die(report: Report) -> None:
    os._exit(3)


def be_killed(report: Report) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def answer_what_no_file_can_hold(report: Report) -> Any:
    return lambda: None


def go_on_for_ever(report: Report) -> None:
    report("begun")
    Event().wait()


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Keep every process that is started."""
    processes: list[Any] = []

    class Kept(subprocess.Popen):
        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            processes.append(self)

    monkeypatch.setattr(subprocess, "Popen", Kept)
    return processes


def test_results_and_reports_are_those_of_one_worker(started: list[Any]) -> None:
    jobs = [partial(count, n) for n in (3, 0, 2, 1)]
    told: dict[int, dict[int, list[int]]] = {1: {}, 2: {}}
    for workers, reports in told.items():
        found = run_jobs(jobs, workers, lambda number, said, kept=reports: kept.setdefault(number, []).append(said))
        assert found == [3, 0, 2, 1]
        assert len(started) == (0 if workers == 1 else 2)
    assert told[1] == told[2] == {0: [0, 1, 2], 2: [0, 1], 3: [0]}


def test_jobs_run_elsewhere_in_no_more_processes_than_there_are_jobs(started: list[Any]) -> None:
    found = run_jobs([whereabouts, whereabouts], 9)
    assert len(started) == 2
    assert set(found) <= {process.pid for process in started}
    assert all(process.returncode is not None for process in started)


def test_one_job_needs_no_process(started: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert run_jobs([whereabouts], 9) == [os.getpid()]
    assert run_jobs([], 9) == []
    assert started == []
    assert "no answer" in capsys.readouterr().out


def test_a_negative_number_of_workers_is_refused() -> None:
    with pytest.raises(InputError, match="got -1"):
        run_jobs([whereabouts], -1)


@pytest.mark.parametrize("error", [FileFormatError("a.parquet is no table"), FloatingPointError("diverged")], ids=repr)
def test_an_error_arrives_as_it_is_and_ends_the_others(error: Exception, started: list[Any]) -> None:
    with pytest.raises(type(error)) as raised:
        run_jobs([go_on_for_ever, partial(fail, error), go_on_for_ever], 2)
    assert type(raised.value) is type(error)
    assert str(raised.value) == str(error)
    assert len(started) == 2
    assert all(process.returncode is not None for process in started)


@pytest.mark.parametrize(
    ("job", "errors", "words"),
    [
        (die, WorkerError, "status 3 before its job was done; if memory ran out"),
        (be_killed, WorkerError, "status -9"),
        (answer_what_no_file_can_hold, (WorkerError, AttributeError), "status 1|lambda"),
    ],
)
def test_a_process_that_cannot_answer_is_an_error(job: Any, errors: Any, words: str, started: list[Any]) -> None:
    with pytest.raises(errors, match=words):
        run_jobs([go_on_for_ever, job], 2)
    assert all(process.returncode is not None for process in started)


def test_an_interrupt_leaves_no_process(started: list[Any]) -> None:
    def interrupt(number: int, said: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_jobs([go_on_for_ever, go_on_for_ever, go_on_for_ever], 2, interrupt)
    assert len(started) == 2
    assert all(process.returncode is not None for process in started)


def test_a_process_ends_amid_its_job_when_whoever_asked_is_gone() -> None:
    code = "from graspcascade.workers import serve; serve()"
    path = {"PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=os.environ | path
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        pickle.dump(go_on_for_ever, process.stdin)
        process.stdin.flush()
        assert pickle.load(process.stdout) == ("report", "begun")
        process.stdin.close()
        assert process.wait(timeout=60) == 0
