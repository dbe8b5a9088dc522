"""Jobs run in other processes: results in order, progress reports while they run, no process left behind."""

from __future__ import annotations

import os
import pickle
import re
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from multiprocessing import Pipe, resource_tracker
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

from ..core.errors import check_whole
from ..core.machine import child_environment, processors

Result = TypeVar("Result")
Report = TypeVar("Report")

Job = Callable[[Callable[[Report], None]], Result]
"""Called with a function to report progress to. A job, its reports and its result must be picklable."""
Listener = Callable[[int, Report], None]
"""Called with the number of a job and a value that it reported."""


class WorkerError(ChildProcessError):
    """Report a worker process that ended before its job was done, for instance when memory ran out."""


class Executor(Protocol):
    """Run jobs somewhere: in this process, in several, or on a cluster."""

    def map(self, jobs: Iterable[Job[Report, Result]], report: Listener[Report]) -> Generator[Result, None, None]:
        """Yield results in the order of the jobs; `report` is called in the thread that asks for results."""
        ...


def run_jobs(
    jobs: Sequence[Job[Report, Result]],
    workers: int = 0,
    report: Listener[Report] | None = None,
    executor: Executor | None = None,
) -> list[Result]:
    """Run jobs, started in their order, and return their results in that order, whatever the number of workers.

    No process stays behind after an error, after an interrupt, or when this process is killed. The calling script needs
    no ``if __name__ == "__main__"``.

    Args:
        jobs: see `Job`.
        workers: processes at a time, 0 for as many as processors; a single worker or job runs in this process.
        report: called in this thread with a job's number and each value that it reports.
        executor: runs the jobs; processes of this machine without it, and only then `workers` counts.

    Raises:
        InputError: `workers` is negative.
        WorkerError: a worker process died.
        Exception: whatever the first job to fail raised.
    """
    return list((executor or LocalExecutor(workers, ahead=len(jobs))).map(jobs, report or _ignore))


def worker_count(workers: int) -> int:
    """Count the processes to work in: so many, or for 0 as many as processors.

    Raises:
        InputError: `workers` is negative.
    """
    check_whole("workers", workers, most=1000)
    return workers or processors()


def _ignore(number: int, value: object) -> None:
    pass


@dataclass(frozen=True)
class LocalExecutor:
    """Run jobs in processes of this machine."""

    workers: int = 0
    """Processes at a time, 0 for as many as processors; a single worker or job runs in this process."""
    ahead: int = 0
    """Jobs begun before the result due next is ready, which bounds the results held; 0 for four per worker."""

    def __post_init__(self) -> None:
        worker_count(self.workers)

    def map(self, jobs: Iterable[Job[Report, Result]], report: Listener[Report]) -> Generator[Result, None, None]:
        """Yield results in the order of the jobs as they become ready, for more of them than memory holds.

        Jobs are taken `ahead` of the result that is due next; closing the generator ends the processes.
        """
        waiting = iter(jobs)
        head = list(islice(waiting, worker_count(self.workers)))
        numbered = enumerate(chain(head, waiting))
        if len(head) > 1:
            yield from _in_processes(numbered, len(head), self.ahead or 4 * len(head), report)
        else:
            for number, job in numbered:
                yield job(partial(report, number))


def _in_processes(
    jobs: Iterator[tuple[int, Job[Report, Result]]], workers: int, ahead: int, report: Listener[Report]
) -> Generator[Result, None, None]:
    begun: deque[tuple[int, Future[Result]]] = deque()
    ended: set[int] = set()
    with _pool(workers) as (submit, events):
        while True:
            begun.extend((number, submit(_Call(number, job))) for number, job in islice(jobs, ahead - len(begun)))
            if not begun:
                return
            due, future = begun.popleft()
            while due not in ended:
                event = events.get()
                if isinstance(event, Future):
                    # Raises what a job raised at once, not only when that job is due.
                    event.result()
                else:
                    number, values = pickle.loads(event)
                    ended.update(() if values else (number,))
                    for value in values:
                        report(number, value)
            ended.remove(due)
            yield future.result()
            # A result that the caller is done with must not stay in memory.
            del future


@contextmanager
def _pool(workers: int) -> Iterator[tuple[Callable[[_Call], Future[Any]], SimpleQueue[Any]]]:
    """Start processes; yield a function that submits calls, and a queue of failed futures and pickled reports."""
    # Sampling from the command line must start fast, and only work in several processes needs it.
    from loky import BrokenProcessPool, ProcessPoolExecutor
    from loky.backend import get_context

    events: SimpleQueue[Any] = SimpleQueue()
    context = get_context("loky")  # unlike multiprocessing's, its workers do not run the caller's script again
    reports, reporter = Pipe(duplex=False)
    lifeline, holder = Pipe(duplex=False)
    pool = ProcessPoolExecutor(
        workers,
        context=context,
        initializer=_begin,
        initargs=(lifeline, reporter, context.Lock()),
        # Modules are found where this process finds them, and never in a working directory that happens to be.
        env=child_environment(PYTHONSAFEPATH="1"),
    )
    listener = threading.Thread(target=_listen, args=(reports, events), daemon=True)
    listener.start()

    def submit(call: _Call) -> Future[Any]:
        future: Future[Any] = starter.submit(pool.submit, call).result()
        future.add_done_callback(lambda done: events.put(done) if done.exception() else None)
        return future

    try:
        # Workers are started from a thread: an interrupt during the start of one would leave it waiting for its orders.
        with ThreadPoolExecutor(1, initializer=_block_interrupts) as starter:
            yield submit, events
        pool.shutdown()
    except BaseException as error:
        pool.shutdown(kill_workers=True)
        if isinstance(error, BrokenProcessPool):
            raise WorkerError(_death(error)) from error
        raise
    finally:
        # Ends workers that are left when a second interrupt kept the pool from ending them, and then the listener.
        for end in (holder, reporter):
            end.close()
        listener.join()
        for end in (lifeline, reports):
            end.close()


def _death(error: Exception) -> str:
    """Word in one line how a worker ended, from loky's message of several."""
    codes = re.search(r"\{(.+)\}", str(error))
    how = f"a worker process ended with {codes[1]}" if codes else "a worker process or its answer was lost"
    return f"{how} before its job was done; if memory ran out, fewer workers need less"


def _block_interrupts() -> None:
    """Keep Ctrl-C from this thread and from the processes it starts, which inherit its signal mask."""
    resource_tracker.ensure_running()  # started later, it would clear the mask
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def _listen(reports: Connection, events: SimpleQueue[Any]) -> None:
    with suppress(EOFError, OSError):
        while True:
            events.put(reports.recv_bytes())


# In a worker

_report: Callable[[int, tuple[Any, ...]], None]


def _begin(lifeline: Connection, reporter: Connection, lock: Any) -> None:
    """Connect a worker for reports, and end it, even during a job, when the process that started it is gone."""
    global _report

    def report(number: int, values: tuple[Any, ...]) -> None:
        message = pickle.dumps((number, values), protocol=pickle.HIGHEST_PROTOCOL)
        with lock:
            reporter.send_bytes(message)

    _report = report
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    with suppress(EOFError, OSError):
        lifeline.recv_bytes()
    os._exit(1)


@dataclass(frozen=True)
class _Call:
    """Run a job in a worker; a report without values says that no more will come."""

    number: int
    job: Job[Any, Any]

    def __call__(self) -> Any:
        result = self.job(lambda value: _report(self.number, (value,)))
        _report(self.number, ())
        return result
