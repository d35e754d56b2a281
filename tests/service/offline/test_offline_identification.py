import numpy as np
import pytest

from service.offline.identification import data_set
from service.offline.rows import rows_of_recording
from service.offline.tables import Recording

from .files import LOW_S, Run


def recording(rows: np.ndarray) -> Recording:
    time_s, speed_rpm, load_n, ambient_c, inner, outer = rows.T.copy()
    temperatures = {"t_inner_ring_c": inner, "t_outer_ring_c": outer}
    return Recording("data.csv", None, time_s, speed_rpm, load_n, ambient_c, temperatures)


def test_a_window_after_a_gap_knows_the_run_in_but_not_its_state(run: Run) -> None:
    found = recording(np.delete(run.rows(60), slice(60, 70), axis=0))
    first, second = data_set(found, rows_of_recording(found), at_rest=True).windows
    assert (first.at_rest, second.at_rest) == (True, False)
    assert first.revolutions == 0.0
    rows = run.rows(60)
    turned = rows[:59, 1].sum() + 4.5 * rows[59, 1]  # the row before the gap held for a while
    assert second.revolutions == pytest.approx(turned)


def test_a_later_cold_start_counts_as_one_only_if_the_first_was_said_to_be(run: Run) -> None:
    again = run.rows(60)
    again[:, 0] += LOW_S + 86400.0
    found = recording(np.concatenate((run.rows(60), again)))
    for said in (True, False):
        windows = data_set(found, rows_of_recording(found), at_rest=said).windows
        assert [window.at_rest for window in windows] == [said, said]


def test_sensors_without_any_reading_and_shreds_are_left_out(run: Run) -> None:
    rows = run.rows(60)
    rows[:, 5] = np.nan
    found = recording(np.delete(rows, [*range(20, 30), *range(32, 42)], axis=0))
    windows = data_set(found, rows_of_recording(found), at_rest=False).windows
    assert [window.minutes.size for window in windows] == [20, len(rows) - 42]
    assert all(window.minutes.sensors == ("t_inner_ring_c",) for window in windows)
