import numpy as np

from service.offline.rows import (
    contiguous,
    mean_around,
    mean_from,
    revolutions_at,
    rows_of_recording,
)
from service.offline.tables import Recording


def recording(time_s: np.ndarray, **columns: np.ndarray) -> Recording:
    values = {
        "speed_rpm": np.full(time_s.size, 1500.0),
        "load_n": np.full(time_s.size, 2650.0),
        "ambient_c": np.full(time_s.size, 22.0),
        "t_inner_ring_c": 22.0 + time_s / 60.0,
    } | columns
    inner = values.pop("t_inner_ring_c")
    return Recording("data.csv", None, time_s, **values, temperatures_c={"t_inner_ring_c": inner})


def test_seconds_become_minutes_with_temperatures_at_their_times() -> None:
    for every_s in (1.0, 10.0, 37.0):
        time_s = np.arange(0.0, 601.0, every_s)
        minutes = rows_of_recording(recording(time_s))
        last = time_s[-1]
        np.testing.assert_allclose(np.diff(minutes.time_s)[:-1], 60.0)
        assert minutes.time_s[-1] == last
        # A steady rise is met exactly, also at the first and the last row.
        np.testing.assert_allclose(
            minutes.temperatures_c["t_inner_ring_c"], 22.0 + minutes.time_s / 60.0
        )
        assert minutes.good.all()


def test_noise_is_averaged_out_around_the_minute() -> None:
    rng = np.random.default_rng(1)
    time_s = np.arange(0.0, 36001.0)
    noisy = 40.0 + rng.normal(0.0, 0.3, time_s.size)
    inner = rows_of_recording(recording(time_s, t_inner_ring_c=noisy)).temperatures_c[
        "t_inner_ring_c"
    ]
    assert np.std(inner[1:-1]) < 0.3 / np.sqrt(60.0) * 1.2


def test_the_operating_point_is_the_mean_over_the_minute_that_begins() -> None:
    time_s = np.arange(0.0, 181.0, 10.0)
    speed = np.where(time_s < 90.0, 1000.0, 2000.0)
    minutes = rows_of_recording(recording(time_s, speed_rpm=speed))
    np.testing.assert_allclose(minutes.speed_rpm, [1000.0, 1500.0, 2000.0, 2000.0])


def test_uneven_rows_weigh_by_how_long_they_hold() -> None:
    time_s = np.array([0.0, 15.0, 60.0])
    means = mean_from(time_s, np.array([400.0, 800.0, 0.0]), np.array([0.0, 60.0]))
    np.testing.assert_allclose(means, [0.25 * 400.0 + 0.75 * 800.0, 0.0])


def test_unknown_values_do_not_count_and_too_few_give_none() -> None:
    time_s = np.arange(0.0, 121.0, 10.0)
    values = np.full(time_s.size, 5.0)
    values[[1, 2]] = np.nan
    values[7:11] = np.nan
    means = mean_from(time_s, values, np.array([0.0, 60.0, 120.0]))
    np.testing.assert_array_equal(means, [5.0, np.nan, 5.0])


def test_no_temperature_is_made_up_in_a_long_gap() -> None:
    time_s = np.concatenate((np.arange(0.0, 121.0, 10.0), np.arange(600.0, 721.0, 10.0)))
    marks = np.arange(0.0, 721.0, 60.0)
    means = mean_around(time_s, time_s, marks)
    gap = (marks > 120.0) & (marks < 600.0)
    assert np.isnan(means[gap]).all()
    np.testing.assert_allclose(means[~gap][[0, 1, -2, -1]], [0.0, 60.0, 660.0, 720.0])
    assert np.isnan(mean_around(time_s, np.full(time_s.size, np.nan), marks)).all()


def test_slow_and_irregular_rows_stay_as_they_are() -> None:
    for time_s in (np.arange(0.0, 3601.0, 300.0), np.array([0.0, 61.0, 118.0, 400.0, 460.0])):
        minutes = rows_of_recording(recording(time_s))
        np.testing.assert_array_equal(minutes.time_s, time_s)
        np.testing.assert_array_equal(
            minutes.temperatures_c["t_inner_ring_c"], 22.0 + time_s / 60.0
        )
        assert len(contiguous(minutes)) == 1


def test_more_than_three_missing_rows_split_the_data() -> None:
    every = np.arange(0.0, 7201.0, 60.0)
    three = rows_of_recording(recording(np.delete(every, slice(50, 53))))
    four = rows_of_recording(recording(np.delete(every, slice(50, 54))))
    assert [span.size for span in contiguous(three)] == [118]
    assert [span.size for span in contiguous(four)] == [50, 67]


def test_bad_rows_split_like_missing_ones_but_ambient_may_be_bridged() -> None:
    time_s = np.arange(0.0, 7201.0, 60.0)
    hole = np.full(time_s.size, 1500.0)
    hole[50:54] = np.nan
    assert [w.size for w in contiguous(rows_of_recording(recording(time_s, speed_rpm=hole)))] == [
        50,
        67,
    ]
    ambient = np.linspace(20.0, 24.0, time_s.size)
    broken = ambient.copy()
    broken[50:80] = np.nan
    minutes = rows_of_recording(recording(time_s, ambient_c=broken))
    np.testing.assert_allclose(minutes.ambient_c, ambient)
    assert minutes.good.all()
    broken[20:110] = np.nan
    assert int(rows_of_recording(recording(time_s, ambient_c=broken)).good.sum()) == 31


def test_revolutions_count_what_was_recorded() -> None:
    time_s = np.concatenate((np.arange(0.0, 601.0, 60.0), np.arange(90000.0, 90601.0, 60.0)))
    turned = revolutions_at(rows_of_recording(recording(time_s)))
    assert turned[0] == 0.0
    assert turned[10] == 1500.0 * 10
    # Of the day without rows only as long counts as a row may hold.
    assert turned[-1] == 1500.0 * (10 + 4.5 + 10)
