"""Labelled postures, made or imported, and the prior learned from them."""

from .human import HumanStatistics, human_statistics
from .importer import export_postures, import_postures
from .labelled import LabelledPostures
from .likeness import Likeness, human_likeness
from .metric import contact_metric
from .prior import PRIOR_TRAINING, PosturePrior, fit_prior, type_codes
from .seeds import SeedSpec, make_seeds

__all__ = [
    "PRIOR_TRAINING",
    "HumanStatistics",
    "LabelledPostures",
    "Likeness",
    "PosturePrior",
    "SeedSpec",
    "contact_metric",
    "export_postures",
    "fit_prior",
    "human_likeness",
    "human_statistics",
    "import_postures",
    "make_seeds",
    "type_codes",
]
