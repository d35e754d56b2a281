"""The interface through which any optimiser can search an identification."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from twin_core.identification.data import IdentificationData
from twin_core.identification.identify import FitSettings, identify
from twin_core.identification.problem import IdentificationProblem
from twin_core.identification.searching import IdentificationSpace, SearchEnd, SearchSpace
from twin_core.models import ThermalModel


@pytest.fixture
def problem(model: ThermalModel, cold_start: IdentificationData) -> IdentificationProblem:
    return IdentificationProblem(model, cold_start)


def test_the_unit_box_is_the_prior_within_three_deviations_and_its_bounds(
    problem: IdentificationProblem, model: ThermalModel
) -> None:
    space = IdentificationSpace(problem, 10)
    lower, upper = space.z(np.zeros(space.dimensions)), space.z(np.ones(space.dimensions))
    assert_allclose(lower, np.maximum(model.parameters.z_lower, -3.0))
    assert_allclose(upper, np.minimum(model.parameters.z_upper, 3.0))
    assert lower[model.parameters.index("fm")] > -3.0  # a share of the heat is not negative


def test_costs_are_the_squares_of_the_residuals(problem: IdentificationProblem) -> None:
    points = np.random.default_rng(0).random((4, problem.parameter_count))
    space = IdentificationSpace(problem, 100)
    residuals = space.residuals(points)
    assert residuals.shape == (4, problem.measurement_count + problem.unknown_count)
    assert_allclose(np.sum(residuals**2, axis=1), space.costs(points), rtol=1e-8)
    assert space.evaluations == 8


def test_a_failed_simulation_costs_one_point(problem: IdentificationProblem) -> None:
    points = np.full((3, problem.parameter_count), 0.5)
    points[1] = np.nan
    space = IdentificationSpace(problem, 100)
    costs = space.costs(points)
    assert np.isinf(costs[1])
    assert np.isfinite(costs[[0, 2]]).all()
    assert space.evaluations == 3
    assert np.isnan(space.residuals(points)[1]).any()


def test_the_budget_ends_the_search_and_its_last_points_count(
    problem: IdentificationProblem,
) -> None:
    batches: list[int] = []
    space = IdentificationSpace(problem, 5, lambda now: batches.append(now.evaluations))
    points = np.random.default_rng(1).random((4, problem.parameter_count))
    first = space.costs(points)
    with pytest.raises(SearchEnd):
        space.costs(points[::-1])
    with pytest.raises(SearchEnd):
        space.residuals(points)
    assert space.evaluations == 5
    assert batches == [4, 5]
    assert space.best_cost == pytest.approx(first.min(), rel=1e-12)
    assert_allclose(space.best_z, space.z(points[np.argmin(first)]))


def test_another_search_takes_the_place_of_noa(
    model: ThermalModel, cold_start: IdentificationData
) -> None:
    asked: list[int] = []

    def random_points(space: SearchSpace, seed: int) -> None:
        rng = np.random.default_rng(seed)
        while True:
            asked.append(5)
            space.costs(rng.random((5, space.dimensions)))

    searched = identify(
        model,
        cold_start,
        FitSettings(method="noa", budget=60, seed=3, samples=0, search=random_points),
    )
    assert sum(asked) == 65  # the last batch is refused
    assert list(searched.starts) == ["search"]
    refined = identify(
        model, cold_start, FitSettings(budget=60, seed=3, samples=0, search=random_points)
    )
    assert set(refined.starts) == {"search", "prior", "random 1"}
    assert refined.best_fitness < 0.5 * searched.best_fitness
