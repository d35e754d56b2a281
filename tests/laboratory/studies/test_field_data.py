"""The study field-data: on made-up turbines always, on the recorded ones where they are.

``BEARING_TWIN_FIELD_DATA`` names the folder with the recorded files.
"""

import csv
import os
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from bearing_twin_laboratory.studies.field_data import STUDY, judge
from bearing_twin_laboratory.studies.field_data_ledger import issue, scored
from bearing_twin_laboratory.studies.field_data_runs import (
    CASES,
    HIGH_KW,
    LOW_KW,
    NESTED_LOW_KW,
    RECENT_S,
    RECENT_SPANS,
    VARIANTS,
    Order,
    case_network,
    examine,
    excursions,
    fit,
    recent,
    spans,
    variant_of,
)
from bearing_twin_laboratory.studies.registry import chosen
from bearing_twin_laboratory.studies.study import Options, StudyError
from bearing_twin_laboratory.studies.turbines import (
    GENERATOR_BEARING,
    HUB,
    NACELLE,
    POWER,
    ROTOR_BEARING,
    SPEED,
    TIME,
    TORQUE,
    read_record,
    turbine_files,
)
from service.site.machines.machine import Machine
from twin_core.naive import fit_naive
from twin_core.network import FrictionKind
from twin_core.verification import LEAD_TIMES_S, verify

pytestmark = pytest.mark.laboratory

DAYS = 14
ROTOR, GENERATOR = CASES


def write_turbine(
    folder: Path,
    name: str = "X1",
    load_heat_k: float = 3.0,
    start: datetime = datetime(2020, 1, 1, tzinfo=UTC),
    offset_k: float = 0.0,
) -> Path:
    """Two weeks of a turbine by physics of its own: wind that rises and falls, two lags."""
    rng = np.random.default_rng(7)
    hours = np.arange(DAYS * 144) / 6.0
    slow = np.convolve(rng.standard_normal(hours.size + 72), np.hanning(73), "valid")
    wind = np.clip(0.48 + 0.42 * np.sin(2 * np.pi * hours / 60.0) + 0.02 * slow, 0.0, 1.0)
    power = 2000.0 * wind**3
    speed = np.clip(2300.0 * wind, 0.0, 1800.0)
    torque = np.where(speed > 100.0, 9550.0 * power / np.maximum(speed, 100.0), 0.0)
    outdoor = 10.0 + 3.0 * np.sin(2 * np.pi * hours / 24.0)
    nacelle, hub = outdoor + 12.0, outdoor + 7.0
    rotor, generator = np.empty(hours.size), np.empty(hours.size)
    warm, hot = 22.0, 35.0
    for row in range(hours.size):
        rotor[row], generator[row] = warm, hot
        drive = 9.0 * (speed[row] / 1800.0) ** 1.3 + load_heat_k * torque[row] / 1e4
        warm += (1.0 - np.exp(-1.0 / 33.0)) * ((nacelle[row] + hub[row]) / 2.0 + drive - warm)
        push = 22.0 * speed[row] / (speed[row] + 600.0)
        hot += (1.0 - np.exp(-1.0 / 4.0)) * (nacelle[row] + 6.0 + push - hot)
    columns = {
        SPEED: speed,
        TORQUE: torque,
        POWER: power,
        NACELLE: nacelle,
        HUB: hub,
        ROTOR_BEARING: rotor + offset_k + 0.1 * rng.standard_normal(hours.size),
        GENERATOR_BEARING: generator + 0.3 * rng.standard_normal(hours.size),
        "wind_speed_m_per_s": 20.0 * wind,
    }
    file = folder / f"lhb_{name}_{start:%Y%m%d}.csv"
    with file.open("w", newline="") as lines:
        writer = csv.writer(lines)
        writer.writerow([TIME, *columns])
        for row, hour in enumerate(hours):
            moment = (start + timedelta(hours=float(hour))).strftime("%Y-%m-%dT%H:%M:%SZ")
            writer.writerow([moment, *(f"{values[row]:.2f}" for values in columns.values())])
    return file


def test_forecasts_begin_low_reach_high_and_learn_from_nothing_else(tmp_path: Path) -> None:
    record = read_record(write_turbine(tmp_path))
    power = dict(zip(record.time_s.tolist(), record.values[POWER].tolist(), strict=True))
    low = spans([record], ROTOR, LOW_KW)
    ahead = excursions([record], ROTOR, LOW_KW, HIGH_KW, np.inf)
    within = excursions([record], ROTOR, NESTED_LOW_KW, 400.0, LOW_KW)
    assert len(low) >= 4
    assert len(ahead) >= 4
    assert len(within) >= 3
    for rows in low:
        assert max(power[t] for t in rows.time_s) < LOW_KW
        assert rows.time_s[-1] - rows.time_s[0] >= 6 * 3600.0
    for rows in ahead:
        assert power[rows.time_s[0]] < LOW_KW
        assert max(power[t] for t in rows.time_s) >= HIGH_KW
        assert rows.time_s[-1] - rows.time_s[0] <= 24 * 3600.0
    assert all(a.time_s[-1] <= b.time_s[0] for a, b in pairwise(ahead))
    # The gate's test must not look at the high part.
    assert max(power[t] for rows in within for t in rows.time_s) < LOW_KW


def test_gaps_and_empty_cells_end_a_span(tmp_path: Path) -> None:
    file = write_turbine(tmp_path)
    lines = file.read_text().splitlines()
    whole = sum(rows.size for rows in spans([read_record(file)], ROTOR, LOW_KW))
    cells = lines[1 + 30].split(",")
    cells[1] = ""
    file.write_text("\n".join([*lines[:31], ",".join(cells), *lines[32:200], *lines[210:]]))
    record = read_record(file)
    assert not record.known[30]
    for rows in spans([record], ROTOR, LOW_KW):
        assert np.diff(rows.time_s).max() == 600.0
        assert not rows.time_s[0] < record.time_s[30] < rows.time_s[-1]
    assert sum(rows.size for rows in spans([record], ROTOR, LOW_KW)) < whole


def test_the_variants_differ_in_the_law_of_the_heat_alone() -> None:
    for case in CASES:
        prior, speed, free = (variant_of(case_network(case), variant) for variant in VARIANTS)
        assert prior == case_network(case)
        assert "load" not in speed.parameters
        assert free.network().source.kind is FrictionKind.TWO_PART
        assert prior.edges == speed.edges == free.edges


def test_a_forecast_knows_the_last_spans_of_the_time_before_it(tmp_path: Path) -> None:
    record = read_record(write_turbine(tmp_path))
    low = spans([record], ROTOR, LOW_KW)
    for rows in excursions([record], ROTOR, LOW_KW, HIGH_KW, np.inf):
        own = recent(low, rows)
        assert own == [one for one in low if one.time_s[-1] <= rows.time_s[0]][-RECENT_SPANS:]
        assert own, "the span that it begins at the end of"
        later = replace(rows, time_s=rows.time_s + RECENT_S + DAYS * 86400.0)
        assert recent(low, later) == []


def test_hourly_forecasts_see_nothing_of_what_comes_and_are_scored_as_live_ones(
    tmp_path: Path,
) -> None:
    record = read_record(write_turbine(tmp_path))
    low = spans([record], ROTOR, LOW_KW)
    rows = excursions([record], ROTOR, LOW_KW, HIGH_KW, np.inf)[0]
    model = Machine("default", None, case_network(ROTOR)).build()
    posterior, _ = fit(model, low)
    naive = fit_naive(low)
    made = issue(model, posterior, naive, rows, ROTOR.sensor)
    assert set(made) == set(LEAD_TIMES_S) - {300}, "ten-minute rows have no five minutes"
    # Ten hours in, the sensor goes mad: what was issued before is what it was.
    mad = rows.temperatures_c[ROTOR.sensor].copy()
    mad[60:] = np.where(np.arange(mad.size - 60) % 2, np.nan, 90.0)
    other = issue(
        model, posterior, naive, replace(rows, temperatures_c={ROTOR.sensor: mad}), ROTOR.sensor
    )
    for lead, readings in made.items():
        step = lead // 600
        before = sum(row + step < rows.size for row in range(0, 60, 6))
        assert np.array_equal(other[lead].quantiles_c[:before], readings.quantiles_c[:before])
        came = rows.temperatures_c[ROTOR.sensor][np.arange(readings.measured_c.size) * 6 + step]
        assert np.array_equal(readings.measured_c, came)
    scores = scored([made, made])
    assert scores[3600].twin == verify(
        np.tile(made[3600].quantiles_c, (2, 1)), np.tile(made[3600].measured_c, 2)
    )
    for lead in (7200, 14400):
        assert scores[lead].twin.mae_k < min(scores[lead].naive_mae_k.values())
    assert scores[14400].twin.mae_k > scores[600].twin.mae_k


def test_the_twin_beats_the_naive_forecasts_and_the_free_law_is_refused(tmp_path: Path) -> None:
    write_turbine(tmp_path)
    found = STUDY.run(lambda fraction, text: None, Options(data=tmp_path))
    bearings = found.document["turbines"]["X1"]
    assert set(bearings) == {"rotor bearing", "generator bearing 1"}
    for shown in bearings.values():
        assert shown["better"], shown
        assert shown["twin_rmse_k"] < min(shown["naive_rmse_k"].values())
        assert set(shown["naive_rmse_k"]) == {"persistence", "static_linear", "arx"}
        assert set(shown["variants"]) == set(VARIANTS)
        assert list(shown["ledger"]) == [str(lead) for lead in LEAD_TIMES_S if lead != 300]
    rotor = bearings["rotor bearing"]
    assert rotor["variant"] == "load on its prior"
    assert rotor["twin_rmse_k"] < 1.0
    assert found.document["better_than_every_naive"] == "2 of 2"
    text = "\n".join(table.markdown() for table in found.tables)
    assert "What was learned from the turbines R80711 and R80721" in text


def test_a_variant_that_extrapolates_badly_within_the_low_part_may_not_forecast(
    tmp_path: Path,
) -> None:
    """Whatever its error at high power is: the verdict knows the low part alone."""
    file = write_turbine(tmp_path)
    kept = examine(Order((file,), "X1", ROTOR, "load on its prior"))
    wild = examine(Order((file,), "X1", ROTOR, "speed only"))
    wild.nested.rmse_k["twin"] = 5.0  # type: ignore[index]
    wild.high.rmse_k["twin"] = 0.0  # type: ignore[index]
    (verdict, *_) = judge([wild, kept])
    assert verdict.chosen is kept
    shown = STUDY.report([wild, kept]).document["turbines"]["X1"]["rotor bearing"]["variants"]
    assert shown["speed only"]["accepted"] is False
    assert "extrapolation: 5.00 K rms" in shown["speed only"]["reason"]
    assert shown["load on its prior"]["accepted"] is True


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("power_kW", "power_MW", "missing column 'power_kW'"),
        ("2020-01-01T00:20:00Z", "soon", "line 4: timestamp_utc"),
        ("2020-01-01T00:20:00Z", "2020-01-01T00:10:00Z", "expected a time after that of the line"),
        (",22.", ",x22.", "expected a number or an empty cell"),
    ],
)
def test_an_unusable_file_is_named(tmp_path: Path, old: str, new: str, expected: str) -> None:
    file = write_turbine(tmp_path)
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(StudyError, match=r"^lhb_X1_20200101\.csv: ") as caught:
        STUDY.run(lambda fraction, text: None, Options(data=tmp_path))
    assert expected in str(caught.value)


def test_a_folder_without_files_and_no_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"--data .*: no CSV files; expected a folder with files"):
        turbine_files(tmp_path)
    with pytest.raises(StudyError, match="no CSV files"):
        turbine_files(tmp_path / "absent")
    with pytest.raises(StudyError, match="--data: the study field-data needs it"):
        chosen("field-data", Options())


def test_a_turbine_that_never_runs_high_is_named(tmp_path: Path) -> None:
    file = write_turbine(tmp_path)
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[:60]))
    with pytest.raises(StudyError, match="turbine X1: no "):
        examine(Order((file,), "X1", ROTOR, "speed only"))


def test_files_are_sorted_by_turbine(tmp_path: Path) -> None:
    for name in ("lhb_R80711_20141029", "lhb_R80711_20141120", "lhb_R80721_20141029", "other"):
        (tmp_path / f"{name}.csv").write_text("")
    found = turbine_files(tmp_path)
    assert {turbine: len(files) for turbine, files in found.items()} == {
        "R80711": 2,
        "R80721": 1,
        "other": 1,
    }


RECORDED = Path(os.environ.get("BEARING_TWIN_FIELD_DATA", "/nowhere"))

if RECORDED.is_dir():

    @pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
    def test_the_twin_beats_the_naive_forecasts_on_a_recorded_turbine(case: object) -> None:
        turbine, files = next(iter(turbine_files(RECORDED).items()))
        outcome = examine(
            Order(tuple(files[:2]), turbine, case, VARIANTS[0])  # type: ignore[arg-type]
        )
        naive = {kind: k for kind, k in outcome.high.rmse_k.items() if kind != "twin"}
        assert outcome.high.rmse_k["twin"] < min(naive.values())
        assert outcome.nested.rmse_k["twin"] < 3.5
        assert all(check.passed for check in outcome.checks)
