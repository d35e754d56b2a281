"""The study of the advice: one bench for real, and what the report makes of several."""

from dataclasses import replace
from pathlib import Path

import pytest

from bearing_twin_laboratory.studies import advice
from bearing_twin_laboratory.studies.advice import ARMS, ARRANGEMENTS, BenchResult, Task, examine
from bearing_twin_laboratory.studies.bench_runs import RINGS, Stage

pytestmark = pytest.mark.laboratory


@pytest.fixture(scope="module")
def bench() -> BenchResult:
    """Two and a half hours of training and one of target, instead of six and three."""
    short = ARRANGEMENTS["known-speed"]._replace(
        light=(Stage(150, 5800.0, 2650.0),), heavy=Stage(60, 5800.0, 5500.0)
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(advice.ARRANGEMENTS, "known-speed", short)
        return examine(Task("known-speed", 102))


def test_following_the_advice_narrows_the_forecast_and_betters_it(bench: BenchResult) -> None:
    none, advised = bench.arms["none"], bench.arms["advised"]
    assert not bench.ran_away
    assert none.levels == ()
    for ring in RINGS:
        assert advised.obtained_k[ring] < 0.6 * none.obtained_k[ring]
        assert advised.rings[ring].steady_error_k < 1.5
        assert advised.rings[ring].coverage_95 >= 0.95
    # the ring that the steps were ranked by
    obtained = advised.obtained_k["t_inner_ring_c"]
    assert obtained == pytest.approx(advised.predicted_k["t_inner_ring_c"], rel=0.4)


def test_what_was_ranked_last_or_refused_is_worse(bench: BenchResult) -> None:
    advised, worst, refused = (bench.arms[name] for name in ("advised", "worst", "refused"))
    ring = "t_inner_ring_c"
    assert worst.obtained_k[ring] > 1.3 * advised.obtained_k[ring]
    assert refused.rings[ring].steady_error_k > 3.0 * advised.rings[ring].steady_error_k
    (level,) = refused.levels
    assert level.speed_rpm < 5800.0
    assert level.load_n == 3400.0
    assert refused.predicted_k == {}


def test_benches_that_ran_away_stand_apart(bench: BenchResult, tmp_path: Path) -> None:
    other = replace(bench, task=Task("known-speed", 7), ran_away=True)
    elsewhere = replace(bench, task=Task("unknown-speed", 7))
    made = advice.STUDY.report([bench, other, elsewhere])
    assert made.document["seeds"] == [7, 102]
    known = made.document["arrangements"]["known-speed"]
    assert list(known["ran_away"]) == [7]
    assert set(known["arms"]) == set(ARMS)
    advised = known["arms"]["advised"]
    assert advised["benches"] == 1
    assert advised["half_width_obtained_k"]["t_inner_ring_c"] == pytest.approx(
        bench.arms["advised"].obtained_k["t_inner_ring_c"]
    )
    assert known["arms"]["refused"]["half_width_predicted_k"]["t_inner_ring_c"] is None
    table, other_table, *_ = made.tables
    assert "1 of 2 random benches" in table.notes[0]
    assert "1 of 1 random benches" in other_table.notes[0]
    assert [row[0] for row in table.rows] == list(ARMS.values())
    written = made.write(tmp_path)
    assert {path.name for path in written} == {"advice.json", "advice.md", "advice-widths.png"}
    assert all(path.stat().st_size > 500 for path in written)


def test_a_fit_that_must_not_forecast_is_counted_not_averaged(bench: BenchResult) -> None:
    refused = {name: replace(arm, refused_fit="too bad a fit") for name, arm in bench.arms.items()}
    made = advice.STUDY.report([bench, replace(bench, task=Task("known-speed", 8), arms=refused)])
    for found in made.document["arrangements"]["known-speed"]["arms"].values():
        assert (found["benches"], found["fits_refused"]) == (1, 1)


def test_a_bench_too_hot_for_any_step_stands_apart(bench: BenchResult) -> None:
    hot = replace(bench, task=Task("known-speed", 9), arms={"none": bench.arms["none"]})
    found = advice.STUDY.report([bench, hot]).document["arrangements"]["known-speed"]
    assert found["no_feasible_step"] == [9]
    assert found["arms"]["none"]["benches"] == 1


def test_arms_that_there_are_not_are_left_out(bench: BenchResult) -> None:
    """Where all speeds are known nothing is refused."""
    arms = {name: arm for name, arm in bench.arms.items() if name != "refused"}
    found = advice.STUDY.report([replace(bench, arms=arms)]).document["arrangements"][
        "known-speed"
    ]["arms"]
    assert found["refused"]["benches"] == 0
    assert found["refused"]["steady_error_c"]["t_inner_ring_c"] is None
    assert found["advised"]["benches"] == 1
