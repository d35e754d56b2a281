"""Parameters of the thermal network from measured low-risk windows."""

from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.identify import (
    DEFAULT_BUDGET,
    SEARCH_ALONE_BUDGET,
    IdentificationResult,
    Progress,
    default_budget,
    identify,
)
from twin_core.identification.noa import Nutcracker, NutcrackerSettings
from twin_core.identification.posterior import Posterior, TrainedRange, prior_posterior
from twin_core.identification.refinement import IdentificationCancelled

__all__ = [
    "DEFAULT_BUDGET",
    "SEARCH_ALONE_BUDGET",
    "IdentificationCancelled",
    "IdentificationData",
    "IdentificationResult",
    "IdentificationWindow",
    "Nutcracker",
    "NutcrackerSettings",
    "Posterior",
    "Progress",
    "TrainedRange",
    "default_budget",
    "identify",
    "prior_posterior",
]
