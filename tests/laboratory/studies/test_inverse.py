"""The inverse problem and the counting of simulations."""

import numpy as np
import pytest

from bearing_twin_laboratory.studies.inverse import (
    CountedSearch,
    InverseProblem,
    SearchEnd,
    simple_network_problem,
)


@pytest.fixture(scope="module")
def problem() -> InverseProblem:
    return simple_network_problem()


@pytest.fixture
def target(problem: InverseProblem) -> np.ndarray:
    """The target as a point of the unit box."""
    return problem.unit(problem.targets)


def test_the_unit_box_is_the_logarithm_between_the_bounds(problem: InverseProblem) -> None:
    parameters = problem.model.parameters
    others = np.arange(7) != 5  # all but k6
    assert problem.values(np.zeros(7))[others] == pytest.approx(parameters.lower[others])
    assert problem.values(np.ones(7))[others] == pytest.approx(parameters.upper[others])
    assert problem.values(np.full(7, 0.5))[others] == pytest.approx(
        np.sqrt(parameters.lower * parameters.upper)[others]
    )


def test_instead_of_k6_the_resistance_at_3000_rpm_is_searched(problem: InverseProblem) -> None:
    """Moving the exponent k7 alone leaves R6 at 300 x 10 rpm as it is."""
    points = np.full((3, 7), 0.4)
    points[:, 6] = 0.1, 0.5, 0.9
    values = problem.values(points)
    at_3000_rpm = values[:, 5] * 300.0 ** values[:, 6]
    assert at_3000_rpm == pytest.approx(np.full(3, at_3000_rpm[0]))
    assert np.ptp(np.log(values[:, 5])) > 1.0
    points[:, 5] += 0.1  # a tenth of two decades
    assert problem.values(points)[:, 5] == pytest.approx(values[:, 5] * 10**0.2)


def test_points_and_parameters_are_one_to_one(problem: InverseProblem) -> None:
    points = np.random.default_rng(2).random((20, 7))
    assert problem.unit(problem.values(points)) == pytest.approx(points)


def test_the_target_is_neither_at_the_centre_nor_at_an_edge(target: np.ndarray) -> None:
    """Methods that average over their members would look better than they are."""
    assert np.all((target > 0.1) & (target < 0.9))
    assert np.all(np.abs(target - 0.5) > 0.03)


def test_residuals_vanish_at_the_target_only(problem: InverseProblem, target: np.ndarray) -> None:
    residuals = problem.residuals(np.array([target, np.full(7, 0.5)]))
    assert residuals.shape == (2, 900)
    assert np.abs(residuals[0]).max() < 1e-9
    assert np.abs(residuals[1]).max() > 1.0


def test_every_simulation_counts_up_to_the_budget(problem: InverseProblem) -> None:
    search = CountedSearch(problem, 10)
    points = np.random.default_rng(0).random((4, 7))
    assert search.costs(points).shape == (4,)
    assert search.residuals(points[:3]).shape == (3, 900)
    assert search.evaluations == 7
    with pytest.raises(SearchEnd):
        search.costs(points)
    assert search.evaluations == 10
    with pytest.raises(SearchEnd):
        search.residuals(points[:1])
    assert search.evaluations == 10
    assert search.reached is None


def test_the_trace_holds_every_new_best(problem: InverseProblem) -> None:
    points = np.random.default_rng(1).random((50, 7))
    costs = np.sum(problem.residuals(points) ** 2, axis=1)
    search = CountedSearch(problem, 50)
    search.costs(points[:20])
    search.costs(points[20:])
    best = np.flatnonzero(costs == np.minimum.accumulate(costs))
    assert [one.evaluations for one in search.trace] == (best + 1).tolist()
    assert search.trace[-1].values == pytest.approx(problem.values(points[np.argmin(costs)]))


@pytest.mark.parametrize("stop", [True, False])
def test_the_target_is_met_by_the_point_within_one_percent(
    problem: InverseProblem, target: np.ndarray, stop: bool
) -> None:
    points = problem.unit(problem.targets * 1.01 ** np.array([[3.0], [1.1], [0.9], [0.0]]))
    search = CountedSearch(problem, 100, stop_at_target=stop)
    if stop:
        with pytest.raises(SearchEnd):
            search.costs(points)
        assert search.evaluations == 3
    else:
        search.costs(points)
        assert search.evaluations == 4
    assert search.reached == 3


def test_a_chance_hit_is_not_for_good(problem: InverseProblem, target: np.ndarray) -> None:
    by_chance, nearer, there = np.full(7, 0.5), target.copy(), target.copy()
    by_chance[3] = target[3]
    nearer[3] += 0.02
    search = CountedSearch(problem, 100, stop_at_target=False)
    search.costs(np.array([by_chance, nearer, there]))
    assert search.within(3) == (1, 3)
    assert search.within(0) == (2, 2)
    none = CountedSearch(problem, 100)
    none.costs(np.full((1, 7), 0.5))
    assert none.within(3) == (None, None)


def test_an_unusable_candidate_costs_one_simulation(problem: InverseProblem) -> None:
    search = CountedSearch(problem, 100)
    costs = search.costs(np.array([np.full(7, np.nan), np.full(7, 0.5)]))
    assert np.isnan(costs[0])
    assert np.isfinite(costs[1])
    assert search.evaluations == 2
    assert len(search.trace) == 1
