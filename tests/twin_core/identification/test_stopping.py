"""Several stopping criteria together: which one ends a search, and when."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_core.identification.noa import Nutcracker
from twin_core.identification.noa_moves import FloatArray
from twin_core.identification.stopping import StoppingCriteria, run_search, stop_reason


def sphere(points: FloatArray) -> FloatArray:
    return np.asarray(np.sum((points - 0.3) ** 2, axis=1))


def new(budget: int = 4000) -> Nutcracker:
    return Nutcracker(np.zeros(3), np.ones(3), budget=budget, seed=2)


def test_without_criteria_the_budget_ends_it() -> None:
    search = new(300)
    assert run_search(search, sphere) == "budget"
    assert search.evaluations == 300


def test_the_target_ends_it_in_the_sweep_that_meets_it() -> None:
    search = new()
    assert run_search(search, sphere, StoppingCriteria(target=1e-3)) == "target"
    assert search.best_fitness <= 1e-3 < search.history[-2][1]
    assert search.evaluations < 4000


def test_stagnation_counts_sweeps_without_a_gain_worth_it() -> None:
    """A plateau: the first sweep is the best, so sweep 1 + 7 ends it."""
    search = new()
    reason = run_search(
        search, lambda points: np.ones(len(points)), StoppingCriteria(stagnation_sweeps=7)
    )
    assert reason == "stagnation"
    assert len(search.history) == 8


def test_gains_of_less_than_a_thousandth_are_no_progress() -> None:
    def told(gain: float) -> Nutcracker:
        search = new()
        value = 1.0
        for _ in range(6):
            points = search.ask()
            search.tell(np.full(len(points), value))
            value *= 1.0 - gain
        return search

    criteria = StoppingCriteria(stagnation_sweeps=5)
    assert stop_reason(told(1e-4), criteria) == "stagnation"  # 0.05 % in five sweeps
    assert stop_reason(told(1e-3), criteria) is None  # 0.5 %


def test_a_search_in_which_everything_fails_stagnates() -> None:
    search = new()
    reason = run_search(
        search, lambda points: np.full(len(points), np.nan), StoppingCriteria(stagnation_sweeps=4)
    )
    assert reason == "stagnation"
    assert search.best_fitness == np.inf


def test_the_spread_of_the_members_ends_it() -> None:
    search = new(20_000)
    assert run_search(search, sphere, StoppingCriteria(spread=0.05)) == "spread"
    assert np.max(np.ptp(search.positions, axis=0)) <= 0.05
    assert search.evaluations < 20_000


def test_spread_is_relative_to_the_box_and_one_before_the_first_sweep() -> None:
    search = Nutcracker([0.0, -50.0], [2.0, 50.0], budget=100, seed=0)
    assert search.spread == 1.0
    search.tell(np.zeros(len(search.ask())))
    extent = np.ptp(search.positions, axis=0)
    assert search.spread == pytest.approx(max(extent[0] / 2.0, extent[1] / 100.0))


def test_wall_time_comes_from_outside() -> None:
    left = iter([False, False, True])
    search = new()
    assert run_search(search, sphere, StoppingCriteria(time_is_up=lambda: next(left))) == "time"
    assert len(search.history) == 3


def test_whichever_comes_first_ends_it_and_says_so() -> None:
    both = StoppingCriteria(target=1e-3, stagnation_sweeps=1000, spread=1e-9)
    assert run_search(new(), sphere, both) == "target"
    assert run_search(new(60), sphere, both) == "budget"


def test_a_new_search_is_never_over() -> None:
    criteria = StoppingCriteria(target=np.inf, spread=1.0, time_is_up=lambda: True)
    assert stop_reason(new(), criteria) is None


@pytest.mark.parametrize(
    ("criteria", "message"),
    [({"stagnation_sweeps": 0}, "stagnation_sweeps is 0"), ({"spread": 0.0}, "spread is 0.0")],
)
def test_senseless_criteria_are_refused(criteria: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        StoppingCriteria(**criteria)  # type: ignore[arg-type]


@given(interrupted_after=st.integers(1, 40), seed=st.integers(0, 5))
@settings(deadline=None)
def test_a_resumed_search_stops_where_the_uninterrupted_one_does(
    interrupted_after: int, seed: int
) -> None:
    criteria = StoppingCriteria(target=1e-7, stagnation_sweeps=8, spread=0.02)

    def start() -> Nutcracker:
        return Nutcracker(np.zeros(3), np.ones(3), budget=1500, seed=seed)

    whole = start()
    reason = run_search(whole, sphere, criteria)
    part = start()
    for _ in range(interrupted_after):
        if stop_reason(part, criteria) is None:
            part.tell(sphere(part.ask()))
    resumed = Nutcracker.from_state(json.loads(json.dumps(part.state_dict(), allow_nan=False)))
    assert run_search(resumed, sphere, criteria) == reason
    assert resumed.state_dict() == whole.state_dict()
