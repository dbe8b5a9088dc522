"""The cascade: stages and factorizations as data, fitting them, and the grasp sampler."""

from typing import TYPE_CHECKING, Any

from .sampler import GraspSampler
from .sizes import SizeRule
from .stages import FACTORIZATIONS, Factorization, Stage, factorization

if TYPE_CHECKING:
    from .fit import FittedCascade, fit_cascade
    from .material import CascadeTraining

__all__ = [
    "FACTORIZATIONS",
    "CascadeTraining",
    "Factorization",
    "FittedCascade",
    "GraspSampler",
    "SizeRule",
    "Stage",
    "factorization",
    "fit_cascade",
]


def __getattr__(name: str) -> Any:
    # Fitting reads datasets and runs physics code; sampling should load neither.
    if name in ("FittedCascade", "fit_cascade"):
        from . import fit

        return getattr(fit, name)
    if name == "CascadeTraining":
        from .material import CascadeTraining

        return CascadeTraining
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
