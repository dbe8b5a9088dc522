r"""Precision grasps of an asked type for a dexterous hand, learned from physics and sampled in milliseconds.

The flow goes one way::

    seed postures -> posture prior -> candidates -> trials -> dataset -> cascade fit -> sampler -> grasps -> formats
                                                                                          \-> trials -> evaluation

Three nouns and three verbs carry it: ``candidates(postures) -> Grasps``, ``trials.run(Grasps) -> Outcomes`` and
``GraspSampler.sample(...) -> Grasps``. Each room imports only from rooms above it in this list:

- `taxonomy`: the six grasp types; `objects`: shapes, sides, symmetry; `poses`: rigid transforms; `grasps`: `Grasps`
- `hands`: the hand model and its kinematics
- `nets`: the conditional VAE, its heads, one training loop (torch), inference in numpy
- `postures`: seed postures, imported recordings, the type-only prior
- `candidates`: the geometric heuristic
- `trials`: the protocol and the physics
- `dataset`: grasps and outcomes as Parquet shards, resumable collection
- `cascade`: stages as data, fitting them, `GraspSampler`
- `pictures`: offscreen rendering
- `evaluation`: success rates with intervals; `report`: the results page, its figures, the model card
- `formats`: grasp files; `viewer`: the web page
- `bench`: speed against yardsticks; `cli`: the command line

SI units throughout (metres, radians, seconds); quaternions are wxyz with w >= 0; poses are named ``X_hand_object``
(object in the hand frame, which is the palm's).
"""

from typing import TYPE_CHECKING, Any

from .errors import FileFormatError, InputError
from .grasps import Grasps
from .objects import CATALOGUE, GraspObject, grasp_object
from .poses import Pose
from .taxonomy import GRASP_TYPES, GraspType, grasp_type

if TYPE_CHECKING:
    from .cascade import GraspSampler

    __version__: str

__all__ = [
    "CATALOGUE",
    "GRASP_TYPES",
    "FileFormatError",
    "GraspObject",
    "GraspSampler",
    "GraspType",
    "Grasps",
    "InputError",
    "Pose",
    "__version__",
    "grasp_object",
    "grasp_type",
]


def __getattr__(name: str) -> Any:
    # What few callers need, and takes a moment to load, is loaded when asked for.
    if name == "GraspSampler":
        from .cascade import GraspSampler

        return GraspSampler
    if name == "__version__":
        from importlib.metadata import version

        return version("graspcascade")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
