"""The study of drift: one bench for real, and what the report makes of several."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bearing_twin_laboratory.studies.drift import STUDY
from bearing_twin_laboratory.studies.drift_runs import (
    CASES,
    Finding,
    RunResult,
    Task,
    Version,
    examine,
    scenario_of,
)


@pytest.fixture(scope="module")
def covered() -> RunResult:
    """Three days of a bench whose housing is covered on the third."""
    return examine(Task("cooling-loss", 101, days=3))


def test_covered_housing_is_reported_named_and_measured(covered: RunResult) -> None:
    assert covered.onset_h == 54.0
    assert covered.tripped_h is None
    assert [round(one.end_h) for one in covered.versions] == [36, 48, 60, 72]
    first, second, *_, last = (one.finding for one in covered.versions)
    assert first is None  # nothing to compare with
    assert second is not None
    assert not second.reported
    assert abs(second.truth["friction"]) < 0.01
    assert last is not None
    assert last.sudden
    assert last.group == "convection outside"
    assert last.truth["convection outside"] == pytest.approx(-0.5, abs=0.01)
    change, low, high = last.moves["convection outside"]
    assert change == pytest.approx(-0.5, abs=0.12)
    assert low < -0.5 < high
    reported = covered.first_report()
    assert reported is not None
    assert reported.end_h <= 73.0


def test_controls_do_not_age_and_differ_in_their_plans() -> None:
    same = scenario_of("unchanged", 3)
    assert same.oil_loss == 0.0
    assert same.steps[1:7] == same.steps[7:13]
    other, again, third = (scenario_of("unchanged, other plans", seed) for seed in (3, 3, 4))
    assert other == again != third
    points = {(step.speed_rpm, step.load_n) for step in same.steps[1:7]}
    for day in range(4):
        steps = other.steps[7 + 6 * day : 13 + 6 * day]
        assert {(step.speed_rpm, step.load_n) for step in steps} == points
        assert sum(step.duration_s for step in steps) == pytest.approx(86_400.0)
        assert min(step.duration_s for step in steps) >= 7200.0
        assert steps != same.steps[1:7]
    assert [case for case in CASES if scenario_of(case, 0).changes] == [
        "grease-degradation",
        "cooling-loss",
    ]


def _finding(group: str, change: float, truth: float, sudden: bool = True) -> Finding:
    return Finding(
        1e-9 if sudden else 0.5,
        sudden,
        (),
        group,
        dict.fromkeys(("friction", "convection outside"), (change, change - 0.05, change + 0.05)),
        {"friction": truth, "convection outside": 0.0},
    )


def test_report_counts_false_reports_delays_and_names(tmp_path: Path) -> None:
    calm = _finding("contact", 0.0, 0.0, sudden=False)
    wrong = _finding("contact", 0.1, 0.0)
    grease = (
        Version(48.0),
        Version(54.0, "", wrong),  # before the onset: false
        Version(66.0, "", calm),
        Version(78.0, "fails", None),
        Version(90.0, "", _finding("friction", 0.12, 0.10)),
        Version(102.0, "", _finding("joints", 0.3, 0.25)),
        Version(114.0, "", _finding("friction", 0.4, 0.30)),
    )
    quiet = (Version(48.0), Version(60.0, "", calm), Version(72.0, "", wrong))
    results = [
        RunResult("grease-degradation", 1, 54.0, 120.0, grease),
        RunResult("grease-degradation", 2, 54.0, None, grease[:3]),
        RunResult("unchanged", 1, None, None, quiet),
    ]
    made = STUDY.report(results)
    found = made.document["cases"]["grease-degradation"]
    assert found["false_reports"] == 2  # one on each bench
    assert found["compared_without_change"] == 2
    assert found["detected"] == 1
    assert found["delay_h_median"] == found["delay_h_max"] == 36.0
    assert found["true_change_at_report"] == pytest.approx(0.10)
    assert (found["sudden_reports"], found["named_right"]) == (3, 2)
    assert found["interval_holds_truth"] == 0.5
    assert found["mean_abs_error"] == pytest.approx(0.06)
    assert found["failed_fits"] == 1
    assert (found["tripped"], found["reported_before_trip"]) == (1, 1)
    control = made.document["cases"]["unchanged"]
    assert (control["false_reports"], control["compared_without_change"]) == (1, 2)
    assert control["detected"] == 0
    summary, benches = made.tables
    assert [row[0] for row in summary.rows] == ["unchanged", "grease-degradation"]
    assert summary.rows[1][2] == "2 of 2"
    assert len(benches.rows) == 1
    assert benches.rows[0][4] == "friction"


def test_report_is_written_with_its_plot(covered: RunResult, tmp_path: Path) -> None:
    calm = replace(covered, case="unchanged", onset_h=None, versions=covered.versions[:2])
    written = STUDY.report([calm, covered]).write(tmp_path)
    assert [path.name for path in written] == ["drift.json", "drift.md", "drift-series.png"]
    assert np.all([path.stat().st_size > 1000 for path in written])
