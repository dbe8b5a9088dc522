"""Labelled postures, made or imported, and the prior learned from them."""

from .human import HumanStatistics, human_statistics
from .labelled import LabelledPostures
from .metric import contact_metric
from .prior import PRIOR_TRAINING, PosturePrior, fit_prior, type_codes
from .seeds import SeedSpec, make_seeds

__all__ = [
    "PRIOR_TRAINING",
    "HumanStatistics",
    "LabelledPostures",
    "PosturePrior",
    "SeedSpec",
    "contact_metric",
    "fit_prior",
    "human_statistics",
    "make_seeds",
    "type_codes",
]
