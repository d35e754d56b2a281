"""The study of the bands' calibration, on hours shortened to minutes, and its figures by hand."""

import json
from dataclasses import replace

from bearing_twin_laboratory.studies import calibration
from bearing_twin_laboratory.studies.bench_runs import RINGS
from bearing_twin_laboratory.studies.calibration import CalibrationRun, RingBands
from bearing_twin_laboratory.studies.study import Options


def test_figures_tables_and_json_of_a_quick_run() -> None:
    tasks = calibration.cases(Options(benches=2, seed=104, quick=True))
    assert [(task.seed, task.family) for task in tasks[:2]] == [
        (104, "catalogue"),
        (104, "palmgren"),
    ]
    (run,) = calibration.examine(tasks[0])
    assert not run.ran_away
    assert not run.refused
    for bands in run.rings.values():
        assert bands.half_width_k > 0.0
        assert bands.interval_score_k >= 2.0 * bands.half_width_k - 1e-9
    inside, outside = (
        RingBands(1.0, share, held, 1.4, 2.0, score, 3.0)
        for share, held, score in ((1.0, True, 4.0), (0.7, False, 10.0))
    )
    of = [dict.fromkeys(RINGS, bands) for bands in (inside, outside)]
    found = [
        [replace(run, rings=of[0])],
        [replace(run, rings=of[1])],
        [CalibrationRun(tasks[1], run.question, ran_away=True, refused="", rings={})],
        [CalibrationRun(tasks[2], run.question, ran_away=False, refused="rms", rings={})],
    ]
    report = calibration.STUDY.report(found)
    rows = {row["family"]: row for row in report.document["rows"]}
    everything = rows["all"]
    assert (everything["runs"], everything["ran_away"]) == (2, 1)
    assert everything["refused"] == ["steep 104"]
    assert rows["palmgren"]["runs"] == 0
    for ring in RINGS:
        assert everything["held_whole"][ring] == 0.5
        assert everything["coverage_95"][ring] == 0.85
        assert everything["worst_coverage_95"][ring] == 0.7
        assert everything["interval_score_k"][ring] == 7.0
    json.dumps(report.document, allow_nan=False)
    assert all(table.markdown() for table in report.tables)
