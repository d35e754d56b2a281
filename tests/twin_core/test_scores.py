"""Scores against values worked out by hand and against their defining integrals."""

import numpy as np
import pytest

from twin_core import scores

NAN = float("nan")


def test_point_scores_leave_out_missing_measurements() -> None:
    forecast, measured = [1.0, 4.0, 100.0, 2.0], [2.0, 2.0, NAN, 0.0]
    assert scores.rms(forecast, measured) == pytest.approx(np.sqrt((1 + 4 + 4) / 3))
    assert scores.bias(forecast, measured) == pytest.approx((-1 + 2 + 2) / 3)
    assert scores.max_error(forecast, measured) == 2.0


def test_the_papers_scores_by_hand() -> None:
    forecast, measured = [1.0, 4.0, 100.0, 2.0], [2.0, 2.0, NAN, 0.0]
    assert scores.fitness(forecast, measured) == 1 + 2 + 2
    assert scores.euclidean_distance(forecast, measured) == pytest.approx(3.0)
    # errors 1, 4, 4; deviations of 2, 2, 0 from 4/3: 4/9 + 4/9 + 16/9 = 8/3
    assert scores.r_squared(forecast, measured) == pytest.approx(1 - 9 / (8 / 3))


def test_fitness_sums_over_rows_and_sensors() -> None:
    assert scores.fitness([[1.0, 2.0], [3.0, 4.0]], [[0.0, 4.0], [3.0, NAN]]) == 3.0


def test_r_squared_of_the_measurements_themselves_and_of_their_mean() -> None:
    measured = [20.0, 25.0, 60.0]
    assert scores.r_squared(measured, measured) == 1.0
    assert scores.r_squared([35.0] * 3, measured) == pytest.approx(0.0)
    assert np.isnan(scores.r_squared([1.0, 2.0], [5.0, 5.0]))
    assert np.isnan(scores.r_squared([1.0, 2.0], [5.0, NAN]))


def test_distance_grows_with_the_length_and_rms_does_not() -> None:
    """Why distances of schemes with different validation lengths do not compare."""
    short, long = np.full(100, 0.5), np.full(400, 0.5)
    none = scores.euclidean_distance(short, np.zeros(100))
    assert scores.euclidean_distance(long, np.zeros(400)) == pytest.approx(2 * none)
    assert scores.rms(long, np.zeros(400)) == pytest.approx(scores.rms(short, np.zeros(100)))


def test_no_measurement_gives_nan() -> None:
    assert np.isnan(scores.fitness([1.0], [NAN]))
    assert np.isnan(scores.euclidean_distance([1.0], [NAN]))
    assert np.isnan(scores.rms([1.0], [NAN]))
    assert np.isnan(scores.bias([1.0], [NAN]))
    assert np.isnan(scores.max_error([1.0], [NAN]))
    assert np.isnan(scores.coverage([0.0], [1.0], [NAN]))
    assert np.isnan(scores.interval_score([0.0], [1.0], [NAN]))
    assert np.isnan(scores.crps_from_members([[0.0], [1.0]], [NAN]))


def test_different_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="differ in shape"):
        scores.rms([1.0, 2.0], [1.0])


def test_coverage_counts_the_edges_as_inside() -> None:
    lower, upper = [0.0] * 5, [1.0] * 5
    assert scores.coverage(lower, upper, [0.0, 1.0, 0.5, 1.1, NAN]) == 0.75


def test_interval_score() -> None:
    # widths 2; one measurement 0.5 above: penalty 2 / 0.05 * 0.5 = 20
    assert scores.interval_score([0.0, 0.0], [2.0, 2.0], [1.0, 2.5]) == pytest.approx(12.0)
    # at 50 %: 2 / 0.5 * 0.5 = 2
    assert scores.interval_score([0.0], [2.0], [2.5], level=0.5) == pytest.approx(4.0)


def test_crps_of_one_member_is_the_absolute_error() -> None:
    assert scores.crps_from_members([[3.0, 5.0]], [1.0, 5.5]) == pytest.approx((2 + 0.5) / 2)


def test_crps_of_two_members_by_hand() -> None:
    # members 0 and 2, measured 1: E|X-y| = 1, E|X-X'|/2 = (0+2+2+0)/4/2 = 0.5
    assert scores.crps_from_members([[0.0], [2.0]], [1.0]) == pytest.approx(0.5)


def test_crps_from_quantiles_by_hand() -> None:
    # Levels 0.25 and 0.75 stand for half of the range each; y = 3, errors 3 and 1:
    # 2 * (0.5 * 0.25 * 3 + 0.5 * 0.75 * 1) = 1.5
    assert scores.crps_from_quantiles([[0.0], [2.0]], [0.25, 0.75], [3.0]) == pytest.approx(1.5)
    # y = -1, errors -1 and -3: 2 * (0.5 * 0.75 * 1 + 0.5 * 0.25 * 3) = 1.5
    assert scores.crps_from_quantiles([[0.0], [2.0]], [0.25, 0.75], [-1.0]) == pytest.approx(1.5)


def test_crps_of_a_normal_forecast_from_members_and_from_quantiles() -> None:
    # For N(0, 1) and y = 0: CRPS = (sqrt(2) - 1) / sqrt(pi) = 0.2337
    rng = np.random.default_rng(0)
    members = rng.standard_normal((20_000, 1))
    expected = (np.sqrt(2) - 1) / np.sqrt(np.pi)
    assert scores.crps_from_members(members, [0.0]) == pytest.approx(expected, abs=0.005)
    levels = np.linspace(0.005, 0.995, 100)
    quantiles = np.quantile(members, levels, axis=0)
    assert scores.crps_from_quantiles(quantiles, list(levels), [0.0]) == pytest.approx(
        expected, abs=0.005
    )
