"""Every branch of the nutcracker moves against values worked out by hand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from twin_core.identification import noa_moves as moves

LOWER = np.array([-1.0, 0.0])
UPPER = np.array([3.0, 2.0])
X = np.array([[0.5, 1.0]])
BEST = np.array([1.0, 0.5])
A = np.array([[1.0, 1.0]])
B = np.array([[0.0, 2.0]])
C = np.array([[2.0, 0.0]])
NOWHERE = np.array([[False, False]])
SECOND_ONLY = np.array([[False, True]])


def test_mantegna_sigma_for_the_usual_exponent() -> None:
    # Gamma(2.5) sin(0.75 pi) = 1.3293404 * 0.7071068; Gamma(1.25) * 1.5 * 2^0.25 = 1.6168504
    assert moves.mantegna_sigma(1.5) == pytest.approx((0.9399856 / 1.6168504) ** (2 / 3), rel=1e-6)


def test_mantegna_sigma_is_one_for_the_cauchy_exponent() -> None:
    assert moves.mantegna_sigma(1.0) == pytest.approx(1.0)


def test_levy_steps_have_heavy_tails() -> None:
    steps = moves.levy_steps(np.random.default_rng(1), (200_000,))
    # A stable law with exponent 1.5: P(|s| > x) falls with x^-1.5, so x8 means a factor 22.6.
    near, far = np.mean(np.abs(steps) > 0.25), np.mean(np.abs(steps) > 2.0)
    assert near / far == pytest.approx(8.0**1.5, rel=0.2)
    assert abs(np.median(steps)) < 0.001


@pytest.mark.parametrize(
    ("variant", "choices", "expected"),
    [
        ("released", [0.1, 0.2, 0.9, 0.1], 10.0),
        ("released", [0.2, 0.1, 0.1, 0.9], 20.0),
        ("released", [0.2, 0.1, 0.9, 0.1], 30.0),
        ("printed", [0.1, 0.2, 0.0, 0.0], 10.0),
        ("printed", [0.2, 0.1, 0.15, 0.0], 20.0),
        ("printed", [0.3, 0.2, 0.1, 0.9], 30.0),
    ],
)
def test_step_factor(variant: moves.Variant, choices: list[float], expected: float) -> None:
    mu = moves.step_factor(
        variant, np.array([choices]), np.array([10.0]), np.array([20.0]), np.array([30.0])
    )
    assert_array_equal(mu, [expected])


def test_forage_early() -> None:
    mean = np.array([0.2, 0.4])
    levy = np.array([[0.1, -0.2]])
    mu, r = np.array([[0.5]]), np.array([[0.5]])
    # 0.2 + 0.1*1 + 0.5*(0.25*3 + 1) = 1.175;  0.4 - 0.2*(-1) + 0.5*(0.25*2 - 0) = 0.85
    moved = moves.forage_early(X, mean, A, B, levy, mu, r, LOWER, UPPER, NOWHERE)
    assert_allclose(moved, [[1.175, 0.85]])
    kept = moves.forage_early(X, mean, A, B, levy, mu, r, LOWER, UPPER, SECOND_ONLY)
    assert_allclose(kept, [[1.175, 1.0]])


def test_forage_late() -> None:
    mu, r = np.array([[0.5]]), np.array([[0.5]])
    jump = np.array([[True, False]])
    # 2 + 0.5*1 + 0.5*1.75 = 3.375 (outside: repaired later);  0 + 0.5*(-1) = -0.5
    moved = moves.forage_late(X, A, B, C, mu, r, jump, LOWER, UPPER, NOWHERE)
    assert_allclose(moved, [[3.375, -0.5]])
    kept = moves.forage_late(X, A, B, C, mu, r, jump, LOWER, UPPER, SECOND_ONLY)
    assert_allclose(kept, [[3.375, 1.0]])


def test_store_towards_best_uses_the_size_of_the_levy_number() -> None:
    levy = np.array([[-0.4, 0.4]])
    # 0.5 + 0.5*0.4*0.5 + 0.3*1 = 0.9;  1 + 0.5*0.4*(-0.5) + 0.3*(-1) = 0.6
    moved = moves.store_towards_best(X, BEST, A, B, levy, np.array([[0.5]]), np.array([[0.3]]))
    assert_allclose(moved, [[0.9, 0.6]])


def test_store_around_best_moves_only_the_chosen_coordinates() -> None:
    mu = np.array([[0.5]])
    assert_allclose(moves.store_around_best(X, BEST, A, B, mu, ~NOWHERE), [[1.5, 0.0]])
    assert_allclose(moves.store_around_best(X, BEST, A, B, mu, SECOND_ONLY), [[0.5, 0.0]])


def test_store_towards_origin() -> None:
    assert_allclose(moves.store_towards_origin(BEST, np.array([[0.25]])), [[0.25, 0.125]])


@pytest.mark.parametrize(
    ("fraction", "evaluations", "rising", "expected"),
    [
        # T = 50 000, rising: 0.54 at t = 25, 0.96 at 250; falling: 0.5 at t = T/2, 0 at the end
        (25 / 50_000, 25, True, (25 / 50_000) ** 0.08),
        (250 / 50_000, 250, True, 0.9585),
        (0.5, 25_000, False, 0.5),
        (0.8, 40_000, False, 0.2**1.6),
        (1.0, 50_000, False, 0.0),
    ],
)
def test_cache_step(fraction: float, evaluations: int, rising: bool, expected: float) -> None:
    assert moves.cache_step(fraction, evaluations, rising) == pytest.approx(expected, abs=2e-4)


def test_reference_points() -> None:
    reach = np.array([[-0.5]])
    assert_allclose(moves.reference_point_near(X, A, B, reach), [[0.0, 1.5]])
    tau = np.array([[0.25, 0.25]])
    far = moves.reference_point_far("released", X, reach, tau, SECOND_ONLY, LOWER, UPPER)
    assert_allclose(far, [[0.5, 0.0]])  # 1 - 0.5*2
    far = moves.reference_point_far("printed", X, reach, tau, ~NOWHERE, LOWER, UPPER)
    assert_allclose(far, [[0.5, 0.75]])  # (4*.25 - 1) = 0;  1 - 0.5*(2*.25 + 0)


def test_recover_cache() -> None:
    reference = np.array([[1.5, 1.5]])
    r1, r2 = np.array([[0.5, 0.5]]), np.array([[0.2, 0.4]])
    # 0.5 + 0.5*0.5 + 0.2*(-0.5) = 0.65;  1 + 0.5*(-0.5) + 0.4*1.5 = 1.35
    assert_allclose(moves.recover_cache(X, BEST, reference, C, r1, r2, ~NOWHERE), [[0.65, 1.35]])
    assert_allclose(moves.recover_cache(X, BEST, reference, C, r1, r2, SECOND_ONLY), [[0.5, 1.35]])


def test_repair_clamps_or_draws_anew_only_what_is_outside() -> None:
    trial = np.array([[5.0, 1.0], [5.0, 1.0], [np.nan, -7.0]])
    redraw = np.array([[False], [True], [False]])
    uniform = np.full((3, 2), 0.25)
    repaired = moves.repair(trial, LOWER, UPPER, redraw, uniform)
    assert_allclose(repaired, [[3.0, 1.0], [0.0, 1.0], [-1.0, 0.0]])
