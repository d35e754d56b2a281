"""The study recorded-sisters: on made-up boards always, on the recorded ones where they are.

``BEARING_TWIN_BOARD_DATA`` names the folder with the recorded files.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bearing_twin_laboratory.studies.recorded_sisters import (
    ALONE,
    CONDITIONS,
    LOW_S,
    OTHER_BOARDS,
    OTHER_DAYS,
    STUDY,
    examine,
)
from bearing_twin_laboratory.studies.study import Options, StudyError

pytestmark = pytest.mark.laboratory

RECORDED = Path(os.environ.get("BEARING_TWIN_BOARD_DATA", "/nowhere"))
DAY_S = 5000.0


def write_board(folder: Path, name: str, watts: tuple[float, float], seed: int) -> Path:
    """A run of a board by physics of its own: radiation, free convection, a lag of the sensors."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, DAY_S, 5.0)
    levels = rng.uniform(25.0, 60.0, (11, 2))
    levels[0], levels[7:] = 50.0, rng.uniform(65.0, 85.0, (4, 2))
    percent = levels[np.minimum(time_s // 480.0, 10).astype(int)]

    def rate(now_s: float, bodies: np.ndarray) -> np.ndarray:
        heaters, sensors = bodies[:2], bodies[2:]
        row = min(int(now_s // 5.0), time_s.size - 1)
        heat = np.array(watts) * percent[row] / 100.0
        rise = heaters - 22.0
        lost = 0.0085 * np.sign(rise) * np.abs(rise) ** 1.15
        lost += 0.9 * 1.2e-3 * 5.67e-8 * ((heaters + 273.15) ** 4 - 295.15**4)
        across = (heaters - heaters[::-1]) / 140.0
        return np.concatenate(((heat - lost - across) / 2.5, (heaters - sensors) / 20.0))

    solved = solve_ivp(rate, (0.0, DAY_S), np.full(4, 22.0), t_eval=time_s, max_step=5.0)
    read = solved.y[2:].T + rng.normal(0.0, 0.15, (time_s.size, 2))
    read[0] = 22.0
    file = folder / f"{name}.csv"
    np.savetxt(
        file,
        np.column_stack((time_s, percent, read)),
        fmt="%.3f",
        delimiter=",",
        header="time_s,heater1_percent,heater2_percent,t1_c,t2_c",
        comments="",
    )
    return file


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("boards")
    for day in (1, 2, 3):
        write_board(folder, f"saopaulo_{day:02}", (1.3, 0.9), day)
    write_board(folder, "apmonitor_a", (1.2, 0.85), 11)
    write_board(folder, "apmonitor_b", (1.4, 0.95), 12)
    write_board(folder, "kantor", (1.25, 0.9), 13)
    return folder


def test_the_hot_part_of_a_run_is_forecast_under_each_condition(boards: Path) -> None:
    (order, *_) = STUDY.cases(Options(data=boards))
    assert order.target.stem == "saopaulo_01"
    assert [path.stem for path in order.same_board] == ["saopaulo_02", "saopaulo_03"]
    outcome = examine(order)
    assert tuple(outcome.sensors) == CONDITIONS, outcome.not_learned
    for condition, sensors in outcome.sensors.items():
        for name, found in sensors.items():
            assert found.rms_k < 1.5, (condition, name)
            assert found.coverage_95 > 0.6, (condition, name)
    assert set(outcome.accepted) == {OTHER_BOARDS, OTHER_DAYS}
    report = STUDY.report([outcome])
    assert report.document["conditions"][ALONE]["sensor_runs"] == 2
    (shown,) = report.tables
    assert [row[0] for row in shown.rows] == list(CONDITIONS)


def test_what_lies_ahead_is_not_learned(boards: Path, tmp_path: Path) -> None:
    """A machine that changes when it becomes hot is off, however well the low part was met."""
    for path in boards.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    target = tmp_path / "saopaulo_01.csv"
    rows = np.genfromtxt(target, delimiter=",", skip_header=1)
    rows[rows[:, 0] > LOW_S, 3:] += 8.0
    header = target.read_text().splitlines()[0]
    np.savetxt(target, rows, fmt="%.3f", delimiter=",", header=header, comments="")
    (order,) = STUDY.cases(Options(data=tmp_path, quick=True))
    for sensors in examine(order).sensors.values():
        for found in sensors.values():
            assert found.rms_k == pytest.approx(8.0, abs=1.5)
            assert not found.held_whole


def test_a_folder_that_does_not_do_is_named(boards: Path, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"0 files saopaulo_\*\.csv, expected at least 2"):
        STUDY.cases(Options(data=tmp_path))
    for path in boards.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    broken = tmp_path / "kantor.csv"
    broken.write_text(broken.read_text().replace("heater1_percent", "heater_percent", 1))
    with pytest.raises(StudyError, match=r"kantor\.csv: .*heater1_percent"):
        STUDY.cases(Options(data=tmp_path))
    broken.write_text(broken.read_text().replace("heater_percent", "heater1_percent", 1))
    lines = broken.read_text().splitlines()
    broken.write_text("\n".join([*lines[:9], lines[9].replace(",", ",x", 1), *lines[10:]]))
    with pytest.raises(StudyError, match=r"kantor\.csv: heater1_percent, row 9: not a number"):
        STUDY.cases(Options(data=tmp_path))


if RECORDED.is_dir():

    def test_a_recorded_board_is_forecast_from_low_heat_to_high_heat() -> None:
        (order,) = STUDY.cases(Options(data=RECORDED, quick=True))
        outcome = examine(order)
        for found in outcome.sensors[ALONE].values():
            assert found.rms_k < 1.5
            assert found.coverage_95 > 0.7
            assert found.outside_whole < 0.02
