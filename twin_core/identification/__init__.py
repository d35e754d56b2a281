"""Parameters of the thermal network from measured low-risk windows."""

from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.identify import (
    DEFAULT_BUDGET,
    SEARCH_ALONE_BUDGET,
    FitSettings,
    IdentificationProgress,
    IdentificationResult,
    default_budget,
    identify,
)
from twin_core.identification.noa import Nutcracker, NutcrackerSettings
from twin_core.identification.posterior import Posterior, TrainedRange, prior_posterior
from twin_core.identification.refinement import IdentificationCancelled

__all__ = [
    "DEFAULT_BUDGET",
    "SEARCH_ALONE_BUDGET",
    "FitSettings",
    "IdentificationCancelled",
    "IdentificationData",
    "IdentificationProgress",
    "IdentificationResult",
    "IdentificationWindow",
    "Nutcracker",
    "NutcrackerSettings",
    "Posterior",
    "TrainedRange",
    "default_budget",
    "identify",
    "prior_posterior",
]
