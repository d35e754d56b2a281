"""Figures of the comparison from runs with known ends; and from real ones, in processes."""

import json
from pathlib import Path

import numpy as np
import pytest

from bearing_twin_laboratory.studies.methods import METHODS
from bearing_twin_laboratory.studies.noa_vs_pso import (
    STUDY,
    Run,
    Task,
    ratio_of_k4,
    search,
    summary,
)
from bearing_twin_laboratory.studies.processes import in_processes
from bearing_twin_laboratory.studies.study import prepare

pytestmark = pytest.mark.laboratory


def _run(method: str, seed: int, reached: int | None, k4: int | None) -> Run:
    trace = np.array([[1.0, 2.0], [50.0, 1.0]])
    return Run(method, seed, 1000, reached, k4, k4, 0.5, trace)


def test_a_failed_run_counts_with_its_budget() -> None:
    facts = summary(
        [_run("noa", seed, reached, 10) for seed, reached in enumerate((100, 200, None))]
    )
    assert facts["success_rate"] == pytest.approx(2 / 3)
    assert facts["median_evaluations"] == 200
    assert facts["max_evaluations"] == 1000


def test_where_more_than_half_fail_there_is_no_median() -> None:
    facts = summary(
        [_run("pso", seed, reached, None) for seed, reached in enumerate((1, None, None))]
    )
    assert facts["median_evaluations"] is None
    assert facts["max_evaluations"] is None
    assert facts["k4_first_median"] is None
    half = summary([_run("pso", 0, 100, None), _run("pso", 1, None, None)])
    assert half["median_evaluations"] == 550


@pytest.mark.parametrize(
    ("pso", "ratio", "is_bound"),
    [((300, 500, None), 5.0, False), ((300, None, None), 10.0, True), ((None,) * 3, 10.0, True)],
)
def test_the_ratio_is_a_bound_where_most_swarms_never_get_there(
    pso: tuple[int | None, ...], ratio: float, is_bound: bool
) -> None:
    runs = [_run("noa", seed, 100, 100) for seed in range(3)]
    runs += [_run("pso", seed, None, k4) for seed, k4 in enumerate(pso)]
    assert ratio_of_k4(runs, "k4_first") == (ratio, is_bound)


def test_report_of_all_methods_with_table_and_plot(tmp_path: Path) -> None:
    runs = [
        _run(name, seed, None if name == "pso" else 100 + seed, None if name == "pso" else 50)
        for name in METHODS
        for seed in range(4)
    ]
    made = STUDY.report(runs)
    document = json.loads(json.dumps(made.document, allow_nan=False))
    assert document["runs"] == 4
    assert set(document["methods"]) == set(METHODS)
    assert document["methods"]["pso"]["success_rate"] == 0.0
    assert document["methods"]["trf"]["median_evaluations"] == 101.5
    assert document["ratio_pso_over_noa"] == 20.0
    assert document["ratio_is_lower_bound"] is True
    (table,) = made.tables
    assert [row[0] for row in table.rows] == list(METHODS)
    assert "more than 20.0 times" in table.notes[0]
    assert "103 s against 1045 s" in table.notes[0]
    prepare(tmp_path / "new" / "folder")
    written = made.write(tmp_path / "new" / "folder")
    assert [path.name for path in written] == [
        "noa-vs-pso.json",
        "noa-vs-pso.md",
        "fig09-noa-vs-pso.png",
    ]
    assert written[2].read_bytes().startswith(b"\x89PNG")


def test_runs_in_other_processes_are_those_of_this_one() -> None:
    """Order kept, seeds kept, and no bit depends on where a run was made."""
    tasks = [Task("noa+refine", 5, 2000), Task("trf", 6, 2000), Task("cma-es", 7, 300)]
    told: list[float] = []
    elsewhere = in_processes(search, tasks, lambda fraction, _: told.append(fraction))
    assert told == pytest.approx([1 / 3, 2 / 3, 1.0])
    for task, there in zip(tasks, elsewhere, strict=True):
        here = search(task)
        assert (there.method, there.seed, there.budget) == (task.method, task.seed, task.budget)
        assert (there.reached, there.k4_first) == (here.reached, here.k4_first)
        assert there.k4.tolist() == here.k4.tolist()


def test_an_error_in_another_process_is_raised_here() -> None:
    with pytest.raises(KeyError, match="unheard of"):
        in_processes(search, [Task("unheard of", 0, 100)], lambda *_: None)
