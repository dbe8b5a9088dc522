"""Seconds of `graspcascade sample` from nothing to its last line, against loading numpy alone."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

from ..machine import child_environment
from .spread import Spread

COMMAND = ("sample", "tripod", "box_medium", "--side-cm", "3")
YARDSTICK = "import numpy"


def cold_start(starts: int) -> dict[str, Any]:
    """Time the command and its yardstick in turn, each in a fresh process of this interpreter.

    One untimed start of each comes first, so that files are read from memory.

    Args:
        starts: timed starts of each.

    Returns:
        `s` and `yardstick_s` per start, and the ratio of their medians.

    Raises:
        subprocess.CalledProcessError: a process failed; what it said is on standard error.
    """
    pairs = [(_seconds("-m", "graspcascade.cli", *COMMAND), _seconds("-c", YARDSTICK)) for _ in range(starts + 1)]
    seconds, yardstick = zip(*pairs[1:], strict=True)
    return {
        "command": " ".join(("graspcascade", *COMMAND)),
        "starts": starts,
        "s": Spread.of(seconds).to_json(),
        "yardstick": f'python -c "{YARDSTICK}"',
        "yardstick_s": Spread.of(yardstick).to_json(),
        "ratio": statistics.median(seconds) / statistics.median(yardstick),
    }


def _seconds(*arguments: str) -> float:
    command: Sequence[str] = [sys.executable, *arguments]
    begun = time.perf_counter()
    # In a session of its own: an interrupt from the keyboard is for this process, which then ends that one.
    subprocess.run(command, env=child_environment(), stdout=subprocess.DEVNULL, check=True, start_new_session=True)
    return time.perf_counter() - begun
