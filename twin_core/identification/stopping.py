"""Criteria that end a global search, several together, and the loop that keeps to them.

The budget always holds: it is also the search's schedule. A search that another criterion ends is
over sooner, and the reason says which.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from numpy.typing import ArrayLike

from twin_core.identification.noa import Nutcracker
from twin_core.identification.noa_moves import FloatArray

StopReason = Literal["budget", "target", "stagnation", "spread", "time"]

# Gains below this share of the fitness are no progress.
_LEAST_GAIN = 1e-3


@dataclass(frozen=True, slots=True)
class StoppingCriteria:
    """When a search ends before its budget is used up; what is None does not count.

    Raises `ValueError` for a number of sweeps or a spread that is not positive.
    """

    target: float | None = None  # the best fitness is at most this
    #: Over this many sweeps the best fitness fell by less than 0.1 %. NOA explores early and
    #: settles late, so a small number ends it before it has begun to converge.
    stagnation_sweeps: int | None = None
    spread: float | None = None  # in every coordinate the members lie within this share of the box
    #: Asked after every sweep; for a limit of wall time, which only the caller can measure.
    time_is_up: Callable[[], bool] | None = None

    def __post_init__(self) -> None:
        if self.stagnation_sweeps is not None and self.stagnation_sweeps < 1:
            raise ValueError(
                f"stagnation_sweeps is {self.stagnation_sweeps}; expected at least 1 or None"
            )
        if self.spread is not None and not self.spread > 0.0:
            raise ValueError(f"spread is {self.spread}; expected more than 0 or None")


BUDGET_ONLY = StoppingCriteria()


def stop_reason(search: Nutcracker, criteria: StoppingCriteria = BUDGET_ONLY) -> StopReason | None:
    """Say which criterion ends the search now, the first in the order of `StopReason`; or None.

    All but the time depend on the search's own state only, so that a resumed search ends where the
    uninterrupted one does.
    """
    if search.finished:
        return "budget"
    if search.evaluations == 0:
        return None
    if criteria.target is not None and search.best_fitness <= criteria.target:
        return "target"
    if criteria.stagnation_sweeps is not None and _stagnates(search, criteria.stagnation_sweeps):
        return "stagnation"
    if criteria.spread is not None and search.spread <= criteria.spread:
        return "spread"
    if criteria.time_is_up is not None and criteria.time_is_up():
        return "time"
    return None


def run_search(
    search: Nutcracker,
    objective: Callable[[FloatArray], ArrayLike],
    criteria: StoppingCriteria = BUDGET_ONLY,
    after_sweep: Callable[[Nutcracker], None] | None = None,
) -> StopReason:
    """Run a search, new or resumed, until a criterion ends it.

    `search`: its state is up to date whenever `after_sweep` is called; `objective`: fitness (n,) of
    a batch of candidates (n, d); NaN or infinite where it failed; `after_sweep`: for progress,
    saving and cancellation: what it raises ends the search, which can be resumed. Returns which
    criterion ended it.
    """
    while (reason := stop_reason(search, criteria)) is None:
        search.tell(objective(search.ask()))
        if after_sweep is not None:
            after_sweep(search)
    return reason


def _stagnates(search: Nutcracker, sweeps: int) -> bool:
    if len(search.history) <= sweeps:
        return False
    before, now = search.history[-1 - sweeps][1], search.history[-1][1]
    return before == now or before - now < _LEAST_GAIN * abs(before)
