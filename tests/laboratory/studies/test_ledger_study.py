"""The study of the ledger, on hours shortened to minutes, and its figures by hand."""

import json

from bearing_twin_laboratory.studies import ledger
from bearing_twin_laboratory.studies.ledger import Counts, LedgerRun
from bearing_twin_laboratory.studies.study import Options


def test_a_quick_run_scores_all_three_courses_with_the_ledger_of_the_service() -> None:
    task = ledger.cases(Options(quick=True))[0]
    courses = ledger.examine(task).courses
    assert set(courses) == set(ledger.COURSES)
    ran_on, stopped, lost = (courses[name] for name in ledger.COURSES)
    assert ran_on.left == ran_on.set_aside == 0
    assert ran_on.scored == stopped.scored + stopped.left
    assert stopped.left == stopped.set_aside > 0
    assert lost.left <= lost.set_aside
    assert ran_on.whole_runs > 0


def test_figures_and_tables_by_hand() -> None:
    task = ledger.cases(Options(quick=True))[0]
    hot = LedgerRun(
        task,
        {
            "ran on": Counts(100, 79),
            "stopped": Counts(60, 54, 40, 24, 40, 90, 45, 7),
            "sensors lost": Counts(60, 54, 10, 0, 40),
        },
    )
    report = ledger.STUDY.report([hot, LedgerRun(task, {})])
    document = report.document
    assert (document["benches"], document["too_hot"]) == (2, 1)
    of_stopped = document["courses"][1]
    assert (of_stopped["share_followed"], of_stopped["share"]) == (0.9, 0.78)
    assert of_stopped["whole_runs_share"] == 0.5
    assert abs(document["difference"]["stopped"] + 0.01) < 1e-9
    json.dumps(document, allow_nan=False)
    assert all(table.markdown() for table in report.tables)
    assert ledger.STUDY.report([]).document["difference"]["stopped"] is None
