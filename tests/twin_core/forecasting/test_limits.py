"""Paths compared with limits."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from twin_core.forecasting.limits import check_limits, first_crossings

TIME_S = np.array([0.0, 60.0, 120.0, 180.0])
# Two machines, two sensors: the first rises and falls, the second stays.
PATHS_C = np.array(
    [
        [[20.0, 50.0], [40.0, 50.0], [80.0, 50.0], [60.0, 50.0]],
        [[30.0, 50.0], [30.0, 90.0], [30.0, 70.0], [30.0, 60.0]],
    ]
)
LIMITS_C = np.array([[60.0, 90.0], [45.0, np.inf]])


def test_highest_margin_and_time_to_every_limit() -> None:
    check = check_limits(TIME_S, PATHS_C, LIMITS_C)
    assert_allclose(check.highest_c, [[80.0, 50.0], [30.0, 90.0]])
    assert_allclose(check.highest_s, [[120.0, 0.0], [0.0, 60.0]])
    assert_allclose(
        check.margin_k, [[[-20.0, 10.0], [-5.0, np.inf]], [[30.0, 60.0], [-45.0, np.inf]]]
    )
    # 60 of 40 to 80 is half of the second minute; 50 is over 45 from the beginning.
    assert_allclose(
        check.time_s, [[[90.0, np.inf], [0.0, np.inf]], [[np.inf, np.inf], [0.0, np.inf]]]
    )


def test_one_machine_is_the_same_code_without_the_leading_axis() -> None:
    many = check_limits(TIME_S, PATHS_C, LIMITS_C)
    for machine, paths_c in enumerate(PATHS_C):
        for one, all_of_them in zip(check_limits(TIME_S, paths_c, LIMITS_C), many, strict=True):
            np.testing.assert_array_equal(one, all_of_them[machine])


def test_every_machine_may_have_its_own_limits_and_times() -> None:
    own_c = np.array([[[60.0], [np.inf]], [[np.inf], [70.0]]])
    check = check_limits(np.stack((TIME_S, 2.0 * TIME_S)), PATHS_C, own_c)
    assert_allclose(check.time_s[:, :, 0], [[90.0, np.inf], [np.inf, 60.0]])


@pytest.mark.parametrize(("band_k", "near"), [(9.0, False), (10.0, True), (25.0, True)])
def test_a_limit_that_is_nearer_than_the_band_is_near(band_k: float, near: bool) -> None:
    check = check_limits(TIME_S, PATHS_C[:1, :, :1], [[90.0]])
    assert check.near(band_k).tolist() == [near]


def test_what_is_not_known_is_near_every_limit_but_not_where_there_is_none() -> None:
    unknown = np.full((1, 4, 1), np.nan)
    check = check_limits(TIME_S, unknown, [[90.0]])
    assert np.isnan(check.margin_k).all()
    assert np.isnan(check.time_s).all()
    assert check.near(5.0).tolist() == [True]
    assert check_limits(TIME_S, unknown, [[np.inf]]).near(5.0).tolist() == [False]


def test_rows_behind_the_end_of_a_shorter_path_do_not_count() -> None:
    paths_c = PATHS_C.copy()
    paths_c[0, 2:] = np.nan
    check = check_limits(TIME_S, paths_c, LIMITS_C)
    assert_allclose(check.highest_c[0], [40.0, 50.0])
    assert check.time_s[0, 0].tolist() == [np.inf, np.inf]
    assert_allclose(check.highest_c[1], [30.0, 90.0])


def test_crossings_are_interpolated_between_rows() -> None:
    path = np.array([[50.0, 70.0, 60.0], [90.0, 80.0, 70.0], [10.0, 10.0, 10.0]])
    assert first_crossings([0.0, 60.0, 120.0], path, np.full(3, 65.0)).tolist() == [
        45.0,
        0.0,
        np.inf,
    ]
