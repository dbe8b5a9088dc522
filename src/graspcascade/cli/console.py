"""What commands print: JSON, tables and progress bars."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from ..errors import InputError

if TYPE_CHECKING:
    from rich.progress import Progress

_PIPE_WIDTH = 200
"""Columns of a table that goes to a file or a pipe, where nothing should be wrapped."""
_SAY_EVERY_S = 60.0


def print_json(data: object) -> None:
    """Print data as JSON, not-a-number as null."""
    print(json.dumps(plain(data), indent=1, allow_nan=False))


def plain(value: Any) -> Any:
    """Replace numbers that JSON cannot hold by None, in nested lists and mappings."""
    if isinstance(value, Mapping):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]], *, left: Sequence[int] = (0,)) -> None:
    """Print a table whose cells stay whole, except in a last text column, which may go on below.

    Args:
        columns: headings; a line break in one keeps its column narrow.
        rows: cells.
        left: numbers of the text columns; the others are figures, set to the right.
    """
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE, padding=(0, 1, 0, 0), pad_edge=False, header_style="bold")
    for number, column in enumerate(columns):
        text, last = number in left, number == len(columns) - 1
        table.add_column(column, justify="left" if text else "right", no_wrap=not (text and last))
    for row in rows:
        table.add_row(*row)
    # Names and figures are printed as they are: rich would take [..] in them for markup.
    Console(width=None if sys.stdout.isatty() else _PIPE_WIDTH, markup=False, highlight=False).print(table)


def percent(rate: float | None) -> str:
    """Word a rate in percent."""
    return "-" if rate is None or math.isnan(rate) else f"{100 * rate:.1f} %"


def interval(found: Mapping[str, float | None]) -> str:
    """Word a rate with its 95 % interval, from ``{"rate", "low", "high"}``."""
    return f"{percent(found['rate'])} (95 %: {percent(found['low'])} to {percent(found['high'])})"


def at_least(name: str, value: int, minimum: int) -> None:
    """Check a count.

    Raises:
        InputError: it is smaller.
    """
    if value < minimum:
        raise InputError(f"{name} must be at least {minimum}, got {value}")


class Bar:
    """Report progress: a bar on a terminal; elsewhere, as in a log, a line each minute."""

    def __init__(
        self, progress: Progress | None, total: int | None, title: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._progress, self._clock, self._said_at = progress, clock, clock()
        self._title, self._done, self._total, self._note = title, 0, total, ""
        self._task = None if progress is None else progress.add_task(title, total=total, note="")

    def advance(self, steps: int) -> None:
        """Move on by some steps."""
        self.show(self._done + steps)

    def show(self, done: int, total: int | None = None, note: str | None = None, title: str | None = None) -> None:
        """Set what is done, and where given the total, the note beside the bar and the title."""
        self._done = done
        self._total = self._total if total is None else total
        self._note = self._note if note is None else note
        self._title = self._title if title is None else title
        if self._progress is None or self._task is None:
            self._say()
            return
        self._progress.update(self._task, completed=done, total=self._total, description=self._title, note=self._note)

    def _say(self) -> None:
        if self._clock() - self._said_at < _SAY_EVERY_S:
            return
        self._said_at = self._clock()
        of_all = "" if self._total is None else f" of {self._total}"
        note = f", {self._note}" if self._note else ""
        print(f"{self._title}: {self._done}{of_all}{note}", file=sys.stderr, flush=True)


@contextmanager
def bar(title: str, total: int | None = None) -> Iterator[Bar]:
    """Show a progress bar on standard error while the block runs (see `Bar`)."""
    if not sys.stderr.isatty():
        yield Bar(None, total, title)
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        yield Bar(progress, total, title)
