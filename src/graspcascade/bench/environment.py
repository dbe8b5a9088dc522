"""What was measured on: processor and versions."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from ..machine import cpu_model, processors, versions


def environment(threads: int) -> dict[str, Any]:
    """Describe machine and versions.

    Args:
        threads: threads that were measured with.
    """
    found = versions()
    for name in ("pyarrow", "torch"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return {
        "cpu": cpu_model(),
        "logical_cores": os.cpu_count(),
        "usable_cores": processors(),
        "threads": threads,
        "system": platform.system(),
        "versions": found,
    }
