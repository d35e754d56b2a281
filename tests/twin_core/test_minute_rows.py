"""Minute rows from means and from samples, calculated by hand."""

import numpy as np

from twin_core.minute_rows import StepMeans, minute_rows, rows_of_samples


def means(time_s: list[float], sound: dict[str, list[bool]] | None = None, **columns: list[float]):  # type: ignore[no-untyped-def]
    return StepMeans(
        np.array(time_s),
        {name: np.array(values) for name, values in columns.items()},
        {name: np.array(values) for name, values in (sound or {}).items()},
    )


def operating(time_s: list[float], sound: dict[str, list[bool]] | None = None) -> StepMeans:
    n = len(time_s)
    return means(  # type: ignore[no-any-return]
        time_s, sound, speed_rpm=[100.0] * n, load_n=[2.0] * n, ambient_c=[20.0] * n, i=[5.0] * n
    )


def test_steps_that_only_one_side_has_make_rows_that_are_not_good() -> None:
    rows = minute_rows(operating([0.0, 60.0]), means([60.0, 120.0], t=[30.0, 31.0]))
    assert rows.time_s.tolist() == [0.0, 60.0, 120.0]
    assert np.isnan(rows.temperatures_c["t"][0])
    assert rows.temperatures_c["t"][1:].tolist() == [30.0, 31.0]
    # A row without a temperature is good, one without an operating point is not.
    assert rows.good.tolist() == [True, True, False]
    assert rows.inputs["i"][:2].tolist() == [5.0, 5.0]


def test_a_needed_sensor_and_an_unsound_mean_make_a_row_bad_but_keep_its_values() -> None:
    times = [0.0, 60.0, 120.0, 180.0]
    temperatures = means(
        times, {"t": [True, False, True, True]}, t=[30.0, 31.0, np.nan, 33.0], u=[np.nan] * 4
    )
    rows = minute_rows(
        operating(times, {"load_n": [True, True, True, False]}), temperatures, needed=("t", "other")
    )
    assert rows.good.tolist() == [True, False, False, False]
    assert rows.temperatures_c["t"][1] == 31.0
    assert rows.load_n[3] == 2.0


def test_samples_are_averaged_over_the_minute_and_temperatures_around_its_mark() -> None:
    time_s = np.arange(0.0, 181.0, 10.0)
    channels = dict.fromkeys(("speed_rpm", "load_n", "ambient_c"), time_s)
    rows = rows_of_samples(time_s, channels, {"t": time_s})
    assert rows.time_s.tolist() == [0.0, 60.0, 120.0, 180.0]
    # Six samples each, 0 to 50, 60 to 110, 120 to 170, and the one at 180.
    assert rows.speed_rpm.tolist() == [25.0, 85.0, 145.0, 180.0]
    # At first what there is, 0 to 20; then 30 to 80, 90 to 140; at last 150 to 180.
    assert rows.temperatures_c["t"].tolist() == [10.0, 55.0, 115.0, 165.0]


def test_a_shorter_step_gives_more_rows() -> None:
    time_s = np.arange(0.0, 20.0, 1.0)
    channels = dict.fromkeys(("speed_rpm", "load_n", "ambient_c"), time_s)
    rows = rows_of_samples(time_s, channels, {"t": time_s}, step_s=10.0)
    assert rows.time_s.tolist() == [0.0, 10.0, 20.0]
    assert rows.load_n[:2].tolist() == [4.5, 14.5]
    assert rows.temperatures_c["t"].tolist() == [2.0, 9.5, 17.0]
    assert rows.good.tolist() == [True, True, False]
