"""What machines of one family know together, and what a further machine may take from them.

A sister is an identified machine of the same type. The posteriors of several of them make the prior
of the next one; see `docs/trust/sisters.md` for what that buys and where it ends.
"""

from twin_core.sisters.calibration import calibration_runs
from twin_core.sisters.learning import (
    SisterVerdict,
    WithSisters,
    identify_with_sisters,
    law_documents,
    part_of,
)
from twin_core.sisters.population import (
    Sister,
    population_prior,
    same_run,
    sister_of,
    strangers,
)

__all__ = [
    "Sister",
    "SisterVerdict",
    "WithSisters",
    "calibration_runs",
    "identify_with_sisters",
    "law_documents",
    "part_of",
    "population_prior",
    "same_run",
    "sister_of",
    "strangers",
]
