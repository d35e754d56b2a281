"""The study of trust on runs of minutes; its figures are quoted from runs of hours."""

import json

import pytest

from bearing_twin_laboratory.studies import trust
from bearing_twin_laboratory.studies.study import Options

pytestmark = pytest.mark.laboratory


def test_each_target_is_asked_with_each_kind_of_sisters() -> None:
    tasks = trust.cases(Options(benches=3, seed=104, quick=True))
    assert [task.sisters for task in tasks] == [trust.TRUE, trust.STEEP, trust.FLAT]
    found = [trust.examine(task) for task in tasks[:2]]
    report = trust.STUDY.report(found)
    json.dumps(report.document, allow_nan=False)
    rows = {(row["own"], row["how"], row["sisters"]): row for row in report.document["rows"]}
    light = ("2650 N", "running on")
    assert rows[(*light, trust.TRUE)]["benches"] == 3
    # Light data say nothing of the load law: a tenth of doubt is what there was before.
    assert rows[(*light, trust.STEEP)]["weight_load"] == pytest.approx(0.9, abs=0.05)
    assert rows[(*light, trust.LITERATURE)]["accepted"] == 0
    for table in report.tables:
        assert all(len(row) == len(table.columns) for row in table.rows)
