"""The study of sisters on runs of minutes; its figures are quoted from runs of hours."""

import json

import pytest

from bearing_twin_laboratory.studies import sisters, sisters_runs
from bearing_twin_laboratory.studies.bench_runs import RINGS, Stage
from bearing_twin_laboratory.studies.study import Options

pytestmark = pytest.mark.laboratory


def test_each_bench_is_the_target_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sisters_runs, "STRANGERS", 1)
    (task,) = sisters.cases(Options(benches=3, seed=104, quick=True))
    short = (Stage(40, 5800.0, 2650.0),), (Stage(35, 5800.0, 5500.0),)
    question = sisters_runs.Question("6016", *short)
    found = sisters_runs.examine(sisters_runs.Task("load", question, task.family, 104, 3))
    assert found.seeds == (104, 105, 106)
    assert {len(outcomes) for outcomes in found.outcomes.values()} == {3}
    report = sisters.STUDY.report([found])
    json.dumps(report.document, allow_nan=False)
    conditions = report.document["questions"]["load"]["catalogue"]["conditions"]
    literature, all_of_them = conditions[sisters_runs.LITERATURE], conditions[sisters_runs.ALL]
    assert (literature["sisters_used"], all_of_them["sisters_used"]) == (0, 2)
    for ring in RINGS:
        assert all_of_them["end_half_width_c"][ring] < literature["end_half_width_c"][ring]
        assert all_of_them["max_error_c"][ring] < 5.0
    labels = [found.outcomes[one][0].labels for one in (sisters_runs.LITERATURE, sisters_runs.ALL)]
    assert "load law from prior only" in labels[0]
    assert "load law from 2 sisters" in labels[1]
    for table in report.tables:
        assert all(len(row) == len(table.columns) for row in table.rows)


def test_all_families_are_asked_all_questions() -> None:
    tasks = sisters.cases(Options())
    assert [(task.name, task.family) for task in tasks] == [
        (name, family)
        for name in ("load", "speed")
        for family in ("catalogue", "palmgren", "steep")
    ]
    assert {task.benches for task in tasks} == {20}
