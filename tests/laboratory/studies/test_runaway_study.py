"""The study of runaways, on hours shortened to minutes, and its figures by hand."""

import json
from dataclasses import replace

from bearing_twin_laboratory.studies import runaway
from bearing_twin_laboratory.studies.study import Options


def test_figures_tables_and_json_of_a_quick_run() -> None:
    task = runaway.cases(Options(quick=True))[0]
    calm = runaway.examine(task)
    assert not calm.lost
    assert calm.margin is not None
    away = replace(calm, ran_away=True, refused="", probability=0.8, share=0.0, labelled=True)
    silent = replace(calm, refused="", probability=0.01, share=0.2, labelled=False)
    lost = runaway.RunawayRun(task, ran_away=True, lost=True)
    report = runaway.STUDY.report([away, silent, lost])
    rules = {row["name"]: row for row in report.document["rules"]}
    probable, share = (rules[f"one load, all fits: {name}"] for name in ("probability", "share"))
    assert (probable["recalled"], probable["false"], probable["benches"]) == (1, 0, 2)
    assert (share["recalled"], share["false"]) == (0, 1)
    assert probable["brier"] == ((0.8 - 1.0) ** 2 + 0.01**2) / 2
    assert report.document["ran_away_in_training"] == 1
    said = [(row["said"], row["happened"]) for row in report.document["reliability"]]
    assert said == [(0.01, 0.0), (0.8, 1.0)]
    json.dumps(report.document, allow_nan=False)
    assert all(table.markdown() for table in report.tables)
