"""Jobs in processes of their own: started, listened to, and ended with the process that asked for them.

Not `multiprocessing`: its spawned processes run the caller's script once more up to the line that asked for them,
unless it is written for that, and a short script that collects and then trains would collect again.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from queue import SimpleQueue
from typing import IO, Any, TypeVar

from .errors import InputError
from .machine import child_environment, processors

Result = TypeVar("Result")
Report = TypeVar("Report")

_SERVE = (
    # Whoever asked ends its workers; an interrupt from the keyboard reaches these too and would make them chatter.
    f"import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); from {__name__} import serve; serve()"
)


class WorkerError(ChildProcessError):
    """Report a process that ended before its job was done, as when the system was out of memory."""


def run_jobs(
    jobs: Sequence[Callable[[Callable[[Report], None]], Result]],
    workers: int = 0,
    report: Callable[[int, Report], None] | None = None,
) -> list[Result]:
    """Run jobs, begun in their order, and give their results in that order, whatever the number of workers.

    No process is left behind, neither after an error or an interrupt nor when this process is killed.

    Args:
        jobs: called with a function to report to; what they are, report and return must be picklable.
        workers: processes at a time, 0 for as many as processors; one worker (or job) runs in this process.
        report: called in this thread with a job's number and its report.

    Raises:
        InputError: `workers` is negative.
        WorkerError: a process died.
        Exception: what the first job to fail raised.
    """
    if workers < 0:
        raise InputError(f"workers must be at least 1, or 0 for as many as processors, got {workers}")
    workers = min(workers or processors(), len(jobs))
    tell = (lambda number, value: None) if report is None else report
    if workers <= 1:
        return [job(partial(tell, number)) for number, job in enumerate(jobs)]
    crew = _Crew()
    with crew, ThreadPoolExecutor(workers) as threads:
        try:
            running = [threads.submit(crew.run, number, job) for number, job in enumerate(jobs)]
            for future in running:
                future.add_done_callback(crew.told.put)
            unfinished = len(running)
            while unfinished:
                told = crew.told.get()
                if isinstance(told, Future):
                    told.result()
                    unfinished -= 1
                else:
                    tell(*told)
            return [future.result() for future in running]
        finally:
            crew.end()
            threads.shutdown(wait=False, cancel_futures=True)


class _Crew:
    """Talk to processes, each from a thread of its own; they stay for further jobs until the end."""

    def __init__(self) -> None:
        self.told: SimpleQueue[Any] = SimpleQueue()
        self._processes: list[subprocess.Popen[bytes]] = []
        self._idle: list[subprocess.Popen[bytes]] = []
        self._ended = False
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        for process in self._processes:
            # What a dead process has not read is still to be flushed when its pipe is closed.
            with contextlib.suppress(BrokenPipeError), process:
                pass

    def run(self, number: int, job: Any) -> Any:
        process = self._ready()
        try:
            kind, value = self._converse(process, number, job)
        except (EOFError, BrokenPipeError, pickle.UnpicklingError) as error:
            raise WorkerError(
                f"a process ended with status {process.wait()} before its job was done; "
                "if memory ran out, fewer at a time need less"
            ) from error
        self._idle.append(process)
        if kind == "error":
            raise value
        return value

    def end(self) -> None:
        with self._lock:
            self._ended = True
            for process in self._processes:
                process.kill()

    def _ready(self) -> subprocess.Popen[bytes]:
        try:
            return self._idle.pop()
        except IndexError:
            return self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        with self._lock:
            if self._ended:
                raise RuntimeError("no process is started any more")
            # The package is found where it was found here, and never in a working directory that happens to be.
            process = subprocess.Popen(
                [sys.executable, "-P", "-c", _SERVE],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=child_environment(),
            )
            self._processes.append(process)
            return process

    def _converse(self, process: subprocess.Popen[bytes], number: int, job: Any) -> tuple[str, Any]:
        assert process.stdin is not None
        assert process.stdout is not None
        pickle.dump(job, process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
        process.stdin.flush()
        while True:
            kind, value = pickle.load(process.stdout)
            if kind != "report":
                return kind, value
            self.told.put((number, value))


def serve() -> None:
    """Do the jobs that standard input brings; reports, then a result or error, go to standard output.

    Standard input ends when whoever asked is done or dead, and this process with it, also amid a job.
    """
    answers = os.fdopen(os.dup(1), "wb")
    # What a job prints must not come between the answers.
    os.dup2(2, 1)
    # An answer that cannot be given must not leave the asker waiting.
    threading.excepthook = _die
    while True:
        try:
            job = pickle.load(sys.stdin.buffer)
        except EOFError:
            os._exit(0)
        threading.Thread(target=_do, args=(job, answers)).start()


def _do(job: Any, answers: IO[bytes]) -> None:
    def tell(kind: str, value: Any) -> None:
        answers.write(pickle.dumps((kind, value), protocol=pickle.HIGHEST_PROTOCOL))
        answers.flush()

    try:
        tell("result", job(partial(tell, "report")))
    except BaseException as error:  # noqa: BLE001 (raised again by whoever asked)
        error.add_note(traceback.format_exc())
        tell("error", error)


def _die(failure: threading.ExceptHookArgs) -> None:
    traceback.print_exception(failure.exc_value)
    os._exit(1)
