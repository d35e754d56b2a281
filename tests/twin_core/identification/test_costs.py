"""The cost that searches make small."""

import numpy as np
from numpy.testing import assert_allclose

from twin_core.identification.costs import SUM_OF_SQUARES, SumOfSquares, failed_as_infinite
from twin_core.identification.data import IdentificationData
from twin_core.identification.problem import IdentificationProblem
from twin_core.identification.searching import IdentificationSpace
from twin_core.models import ThermalModel


def test_squares_are_summed_and_a_failed_simulation_costs_infinitely_much() -> None:
    residuals = np.array([[3.0, 4.0], [np.nan, 1.0]])
    without = SUM_OF_SQUARES.without_nuisance(residuals, np.zeros((2, 1)))
    assert failed_as_infinite(SUM_OF_SQUARES.of(residuals)).tolist() == [25.0, np.inf]
    assert failed_as_infinite(without).tolist() == [25.0, np.inf]


def test_a_nuisance_unknown_takes_what_it_explains_at_the_price_of_its_prior() -> None:
    # min over u of (3 - u)^2 + u^2 is 4.5, at u = 1.5.
    assert_allclose(SUM_OF_SQUARES.without_nuisance(np.array([[3.0]]), np.array([[-1.0]])), [4.5])


class Halved(SumOfSquares):
    def of(self, residuals: np.ndarray) -> np.ndarray:
        return super().of(residuals) / 2.0

    def without_nuisance(self, residuals: np.ndarray, sensitivity: np.ndarray) -> np.ndarray:
        return super().without_nuisance(residuals, sensitivity) / 2.0


def test_another_cost_takes_the_place_of_the_sum_of_squares(
    model: ThermalModel, cold_start: IdentificationData
) -> None:
    points = np.random.default_rng(0).random((3, model.parameters.size))
    usual = IdentificationSpace(IdentificationProblem(model, cold_start), 100)
    other = IdentificationSpace(IdentificationProblem(model, cold_start, cost=Halved()), 100)
    assert_allclose(other.costs(points), usual.costs(points) / 2.0)
    other.residuals(points)
    assert_allclose(other.best_cost, np.min(usual.costs(points)) / 2.0)
