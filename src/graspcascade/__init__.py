r"""Precision grasps of an asked type for a dexterous hand, learned from physics and sampled in milliseconds.

The flow goes one way::

    seed postures -> posture prior -> proposals -> trials -> dataset -> fit -> proposals -> grasps -> formats, viewer
    (labelled)       (type-only VAE)  (heuristic)  (engine)  (Parquet)        (cascade)  \-> trials -> evaluation

A `Task` says which grasp type, of which object, at which site. A proposal (the heuristic, or the trained cascade
`GraspSampler`) turns tasks into `Grasps`; an engine runs grasps through a protocol and reports `Outcomes`; a study
(collect, evaluate) proposes, tries and keeps. Each room imports only from rooms above it in this list:

- `core`: poses, shapes and objects, grasp types, tasks, grasps, outcomes, protocols and physics, intervals, files
- `hands`: `Hand`, read from a hand file, and its kinematics
- `nets`: the conditional VAE, its heads, one training loop (torch), inference in numpy
- `worlds`: a hand and an object in one MuJoCo model
- `proposals`: the heuristic, the posture prior, the cascade
- `engines`: trials in physics
- `studies`: seeds and prior, collect, learn, evaluate
- `formats`: grasp files; `viewer`: pictures and the web page; `cli`: the command line

SI units throughout (metres, radians, seconds); quaternions are wxyz with w >= 0; poses are named ``X_hand_object``
(object in the hand frame).
"""

from typing import TYPE_CHECKING, Any

from .core.errors import FileFormatError, InputError
from .core.grasps import Grasps
from .core.objects import CATALOGUE, Box, Cylinder, GraspObject, Site, Sphere, as_object
from .core.poses import Pose
from .core.tasks import Task, Tasks
from .core.taxonomy import GRASP_TYPES, GraspType, as_type

if TYPE_CHECKING:
    from .engines import run_trials
    from .hands import Hand, load_hand
    from .proposals.cascade.sampler import GraspSampler

    __version__: str

__all__ = [
    "CATALOGUE",
    "GRASP_TYPES",
    "Box",
    "Cylinder",
    "FileFormatError",
    "GraspObject",
    "GraspSampler",
    "GraspType",
    "Grasps",
    "Hand",
    "InputError",
    "Pose",
    "Site",
    "Sphere",
    "Task",
    "Tasks",
    "__version__",
    "as_object",
    "as_type",
    "load_hand",
    "run_trials",
]

_LATE = {
    "GraspSampler": "proposals.cascade.sampler",
    "Hand": "hands",
    "load_hand": "hands",
    "run_trials": "engines",
}


def __getattr__(name: str) -> Any:
    # What few callers need, and takes a moment to load, is loaded when asked for.
    if name in _LATE:
        from importlib import import_module

        return getattr(import_module(f".{_LATE[name]}", __name__), name)
    if name == "__version__":
        from importlib.metadata import version

        return version("graspcascade")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
