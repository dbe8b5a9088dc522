"""The machine underneath: processors, the memory a process has needed, what child processes inherit, versions."""

from __future__ import annotations

import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path


def cpu_model() -> str:
    """Name the processor as the system does."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())


def peak_rss_mb(max_rss: int | None = None) -> float:
    """Measure the most memory this process has held, in MB of a million bytes, or convert another's `ru_maxrss`."""
    if max_rss is None:
        import resource  # only Unix has it, and only this needs it

        max_rss = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # The one number that systems count in different units.
    return max_rss * (1 if sys.platform == "darwin" else 1024) / 1e6


def processors() -> int:
    """Count the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def versions() -> dict[str, str]:
    """Name the versions that numbers depend on."""
    packages = {name: version(name) for name in ("graspcascade", "mujoco", "numpy", "scipy")}
    return packages | {"python": platform.python_version(), "machine": platform.machine()}


def child_environment(**variables: str) -> dict[str, str]:
    """Make the environment, with some variables set, of a Python process that finds the packages of this one."""
    path = os.pathsep.join(str(Path(folder).absolute()) for folder in sys.path)
    return os.environ | {"PYTHONPATH": path} | variables
