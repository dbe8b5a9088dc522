"""Physical trials: ``run(grasps, protocol) -> Outcomes``."""

from .creep import COLLECTION, CreepProjection
from .outcomes import TOUCH_COLUMNS, VERDICTS, Outcomes
from .protocol import PAPER, PROTOCOLS, Protocol, protocol
from .runner import run
from .scene import Scene, build_scene

__all__ = [
    "COLLECTION",
    "PAPER",
    "PROTOCOLS",
    "TOUCH_COLUMNS",
    "VERDICTS",
    "CreepProjection",
    "Outcomes",
    "Protocol",
    "Scene",
    "build_scene",
    "protocol",
    "run",
]
