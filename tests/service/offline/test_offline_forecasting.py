from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.offline.forecasting import UnusableHistoryError, follow
from service.offline.model_file import IdentifiedModel
from service.offline.tables import Recording
from twin_core.machine_state import MachineState

from .files import LOW_S, Run


@pytest.fixture
def identified(prior_model: Path) -> IdentifiedModel:
    return IdentifiedModel.load(prior_model)


def recording(rows: np.ndarray, temperatures: bool = True) -> Recording:
    time_s, speed_rpm, load_n, ambient_c, inner, outer = rows.T.copy()
    shown = {"t_inner_ring_c": inner, "t_outer_ring_c": outer} if temperatures else {}
    return Recording("data.csv", None, time_s, speed_rpm, load_n, ambient_c, shown)


def rings(identified: IdentifiedModel, state: MachineState) -> tuple[float, float]:
    rows = identified.model.sensor_matrix(identified.model.sensor_names)
    inner, outer = rows @ state.temperatures_c
    return float(inner), float(outer)


def test_the_state_is_that_of_the_last_second(run: Run, identified: IdentifiedModel) -> None:
    end_s = LOW_S - 2400 + 143  # on the steep part, between two minutes
    for every_s in (1, 23):
        state = follow(identified, recording(run.rows(every_s, 0, end_s)))
        assert rings(identified, state) == pytest.approx(
            (run.inner_c[end_s], run.outer_c[end_s]), abs=0.4
        )
        assert state.operating_point.speed_rpm == pytest.approx(4200.0, abs=10.0)


def test_readings_correct_the_model_all_the_way(run: Run, identified: IdentifiedModel) -> None:
    rows = run.rows(60)
    rows[-30:, 4:] = np.nan
    corrected = rings(identified, follow(identified, recording(rows)))
    rows[1:, 4:] = np.nan
    alone = rings(identified, follow(identified, recording(rows)))
    truth = (run.inner_c[LOW_S], run.outer_c[LOW_S])
    assert abs(corrected[0] - truth[0]) < 2.0
    assert abs(alone[0] - truth[0]) > abs(corrected[0] - truth[0])


def test_rows_at_the_end_without_an_operating_point_still_pass(
    run: Run, identified: IdentifiedModel
) -> None:
    end_s = LOW_S - 7200 + 600
    rows = run.rows(60, 0, end_s)
    rows[-9:, 1] = np.nan
    rows[-9:, 4:] = np.nan
    before, after = (follow(identified, recording(rows[: -9 + late or None])) for late in (0, 9))
    assert rings(identified, after)[0] > rings(identified, before)[0] + 2.0
    assert after.revolutions == pytest.approx(
        before.revolutions + 9 * before.operating_point.speed_rpm
    )


def test_the_grease_is_as_run_in_as_the_history_says(run: Run, identified: IdentifiedModel) -> None:
    # The model's data ended at 21600 s and 540 000 revolutions; this history shows another run.
    rows = run.rows(60)
    turned = float(rows[:-1, 1].sum())
    state = follow(identified, recording(rows))
    assert state.revolutions == pytest.approx(540_000.0 + turned, rel=1e-3)
    # A history of the same run, by its temperatures, begins where the data did.
    run_in = replace(
        identified.run_in,
        time_s=rows[:, 0],
        revolutions=np.concatenate(([0.0], np.cumsum(rows[:-1, 1]))),
        temperatures_c={"t_inner_ring_c": rows[:, 4]},
    )
    same = follow(replace(identified, run_in=run_in), recording(rows))
    assert same.revolutions == pytest.approx(turned, rel=1e-3)


def test_a_start_at_rest_is_known_from_the_data_of_the_model(
    run: Run, identified: IdentifiedModel
) -> None:
    rows = run.rows(60)[:1]
    rows[0, 1] = 1500.0  # the shaft begins to turn with the first row
    run_in = replace(
        identified.run_in, time_s=rows[:, 0], revolutions=np.zeros(1),
        temperatures_c={"t_inner_ring_c": rows[:, 4]},
    )  # fmt: skip
    known = follow(replace(identified, run_in=run_in), recording(rows))
    guessed = follow(replace(identified, run_in=replace(run_in, at_rest=False)), recording(rows))
    assert np.max(np.abs(known.temperatures_c - rows[0, 3])) < 0.5
    assert np.trace(known.covariance) < 0.5 * np.trace(guessed.covariance)


def test_after_a_long_gap_the_estimate_starts_anew_but_the_run_in_goes_on(
    run: Run, identified: IdentifiedModel
) -> None:
    rows = run.rows(60)
    broken = np.delete(rows, slice(20, 100), axis=0)
    state = follow(identified, recording(broken))
    truth = (run.inner_c[LOW_S], run.outer_c[LOW_S])
    assert rings(identified, state) == pytest.approx(truth, abs=0.5)
    turned = rows[:20, 1].sum() + rows[100:-1, 1].sum()
    assert state.revolutions == pytest.approx(540_000.0 + turned + 3.5 * 1500.0, rel=1e-3)
    broken[20:, 4:] = np.nan
    with pytest.raises(UnusableHistoryError, match="in the last contiguous span"):
        follow(identified, recording(broken))


def test_a_history_without_temperatures_is_refused(run: Run, identified: IdentifiedModel) -> None:
    with pytest.raises(UnusableHistoryError, match="expected at least one"):
        follow(identified, recording(run.rows(60), temperatures=False))
