"""Physical trials: ``run(grasps, protocol) -> Outcomes``."""

from .outcomes import TOUCH_COLUMNS, VERDICTS, Outcomes
from .protocol import PAPER, PROTOCOLS, Protocol, protocol
from .runner import run
from .scene import Scene, build_scene

__all__ = [
    "PAPER",
    "PROTOCOLS",
    "TOUCH_COLUMNS",
    "VERDICTS",
    "Outcomes",
    "Protocol",
    "Scene",
    "build_scene",
    "protocol",
    "run",
]
