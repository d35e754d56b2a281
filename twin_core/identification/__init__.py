"""Parameters of the thermal network from measured low-risk windows."""

from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.identify import (
    DEFAULT_BUDGET,
    IdentificationResult,
    Progress,
    identify,
)
from twin_core.identification.noa import Nutcracker, NutcrackerSettings
from twin_core.identification.posterior import Posterior, TrainedRange, prior_posterior
from twin_core.identification.refinement import IdentificationCancelled

__all__ = [
    "DEFAULT_BUDGET",
    "IdentificationCancelled",
    "IdentificationData",
    "IdentificationResult",
    "IdentificationWindow",
    "Nutcracker",
    "NutcrackerSettings",
    "Posterior",
    "Progress",
    "TrainedRange",
    "identify",
    "prior_posterior",
]
