"""The engine's own log, kept quiet while trials run: a trial that breaks is a verdict, not a message."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any

import mujoco

_changing = Lock()
_before: list[Any] = []
"""What the log was set to when each block that runs at present began: the first entry is the caller's own."""


@contextmanager
def quiet_engine() -> Iterator[None]:
    """Keep the engine's warnings off standard error and out of ``MUJOCO_LOG.TXT`` while the block runs.

    Warnings are counted all the same, errors raised, and a caller's own handler of warnings still hears them. Blocks
    may run in several threads at a time: the log is as before when the last one ends.
    """
    with _changing:
        _before.append(mujoco.MjLogConfig.get())
        config = mujoco.MjLogConfig.get()
        config.logto_console = config.logto_file = False
        config.set()
    try:
        yield
    finally:
        with _changing:
            config = _before.pop()
            if not _before:
                config.set()
