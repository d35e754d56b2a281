"""Bounded Levenberg-Marquardt: steps by hand, bounds, convergence, cancellation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.problem import IdentificationProblem
from twin_core.identification.refinement import IdentificationCancelled, damped_steps, refine
from twin_core.identification.whitening import Loss

WIDE = np.full(2, 100.0)


def test_ladder_runs_from_the_full_gauss_newton_step_to_short_ones() -> None:
    jacobian = np.array([[2.0, 0.0], [0.0, 1.0]])
    residuals = np.array([2.0, -1.0])
    steps = damped_steps(jacobian, residuals, np.zeros(2), -WIDE, WIDE)
    assert_allclose(steps[0], [-1.0, 1.0])
    # damping 1: -4/(4+1), 1/(1+1)
    assert_allclose(steps[1], [-0.8, 0.5])
    assert np.all(np.diff(np.abs(steps), axis=0) < 0.0)


def test_long_steps_are_shortened_and_cut_at_the_bounds() -> None:
    jacobian, residuals = np.eye(2), np.array([-10.0, -5.0])
    steps = damped_steps(jacobian, residuals, np.zeros(2), -WIDE, WIDE)
    assert_allclose(steps[0], [2.0, 1.0])
    steps = damped_steps(jacobian, residuals, np.zeros(2), -WIDE, np.array([0.5, 100.0]))
    assert_allclose(steps[0], [0.5, 1.0])


def test_unknowns_held_at_a_bound_do_not_bend_the_others_step() -> None:
    jacobian = np.array([[1.0, 1.0], [0.0, 1.0]])
    residuals = np.array([-1.0, 0.0])
    upper = np.array([0.0, 100.0])
    steps = damped_steps(jacobian, residuals, np.zeros(2), -WIDE, upper)
    # with the first unknown held, the second alone solves min (x-1)^2 + x^2
    assert_allclose(steps[0], [0.0, 0.5])


def test_finds_the_optimum_and_stays_within_the_bounds(model, cold_start) -> None:  # type: ignore[no-untyped-def]
    problem = IdentificationProblem(model, cold_start)
    costs: list[float] = []
    found = refine(problem, np.zeros(problem.unknown_count), on_iteration=costs.append)
    assert found is not None
    assert found.converged
    assert costs == sorted(costs, reverse=True)
    assert np.all((found.unknowns >= problem.lower) & (found.unknowns <= problem.upper))
    # The gradient vanishes but for unknowns that stand at a bound.
    residuals = problem.residuals(found.unknowns)[0]
    gradient = problem.jacobian(found.unknowns).T @ residuals
    inner = (found.unknowns > problem.lower) & (found.unknowns < problem.upper)
    information = np.sqrt(found.cost)
    assert np.max(np.abs(gradient[inner])) < 0.2 * information
    other = refine(problem, np.full(problem.unknown_count, 0.5))
    assert other is not None
    assert other.cost == pytest.approx(found.cost, rel=1e-3)


def test_a_start_that_cannot_be_simulated_gives_none(model, cold_start) -> None:  # type: ignore[no-untyped-def]
    problem = IdentificationProblem(model, cold_start)
    assert refine(problem, np.full(problem.unknown_count, np.nan)) is None


def test_cancellation_is_asked_at_every_iteration(model, cold_start) -> None:  # type: ignore[no-untyped-def]
    problem = IdentificationProblem(model, cold_start)
    asked = 0

    def cancelled() -> bool:
        nonlocal asked
        asked += 1
        return asked == 3

    with pytest.raises(IdentificationCancelled):
        refine(problem, np.zeros(problem.unknown_count), cancelled=cancelled)
    assert asked == 3


@pytest.mark.parametrize("loss", ["soft_l1", "huber", "cauchy"])
def test_a_robust_loss_is_not_bent_by_outliers(model, synthesise, true_z, loss: Loss) -> None:  # type: ignore[no-untyped-def]
    clean = synthesise(true_z, noise_k=0.1)
    spoiled = synthesise(true_z, noise_k=0.1)
    rng = np.random.default_rng(4)
    for values in spoiled.temperatures_c.values():
        values[rng.choice(np.arange(5, values.size), 8, replace=False)] += rng.uniform(4.0, 9.0, 8)

    def posed(minutes, chosen: Loss) -> IdentificationProblem:  # type: ignore[no-untyped-def]
        window = IdentificationWindow(minutes, at_rest=True)
        return IdentificationProblem(model, IdentificationData((window,)), loss=chosen)

    judge = posed(clean, "linear")

    def error_k(minutes, chosen: Loss) -> float:  # type: ignore[no-untyped-def]
        problem = posed(minutes, chosen)
        found = refine(problem, np.zeros(problem.unknown_count))
        assert found is not None
        assert found.converged
        return max(judge.rms_k(found.unknowns).values())

    undisturbed = error_k(clean, "linear")
    assert error_k(spoiled, "linear") > undisturbed + 0.3
    assert error_k(spoiled, loss) < undisturbed + 0.02
