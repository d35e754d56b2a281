"""The studies on random benches, with stages of minutes instead of hours."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bearing_twin_laboratory.studies import (
    rapid_acceleration,
    reference_nodes,
    sample_size,
    variable_load,
    variable_speed,
)
from bearing_twin_laboratory.studies import variable_load_runs as load_runs
from bearing_twin_laboratory.studies.bench_results import SchemesResult
from bearing_twin_laboratory.studies.bench_runs import NODES, RINGS, Stage, run_bench
from bearing_twin_laboratory.studies.study import Report

pytestmark = pytest.mark.laboratory

SHORT = tuple(Stage(20, speed, 2650.0) for speed in (1500.0, 2400.0, 4200.0))


@pytest.fixture(autouse=True)
def short_runs() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for module in (sample_size, variable_speed, rapid_acceleration, reference_nodes):
            patch.setattr(module, "STAIRCASE", SHORT)
        patch.setattr(sample_size, "SCHEMES", {"N_90": 20, "N_180": 40})
        patch.setattr(reference_nodes, "SAMPLES", 40)
        patch.setattr(rapid_acceleration, "STANDSTILL", Stage(30, 0.0, 2650.0))
        patch.setattr(
            rapid_acceleration,
            "ACCELERATIONS",
            (Stage(15, 4900.0, 2650.0), Stage(5, 0.0, 2650.0), Stage(10, 4900.0, 2650.0)),
        )
        trainings = {
            "single": (Stage(40, 5800.0, 2650.0),),
            "with_stage": (Stage(40, 5800.0, 2650.0), Stage(25, 5800.0, 3300.0)),
        }
        patch.setattr(load_runs, "TRAININGS", trainings)
        patch.setattr(load_runs, "LIGHT", trainings["single"][0])
        heavy = (Stage(35, 5800.0, 4000.0), Stage(35, 5800.0, 5500.0))
        patch.setattr(load_runs, "HEAVY", heavy)
        yield


def document_of(made: Report, folder: Path, plots: int) -> dict:  # type: ignore[type-arg]
    """Write everything and read the document back: all of it is strict JSON."""
    written = made.write(folder)
    pictures = [path for path in written if path.suffix == ".png"]
    assert len(pictures) == plots
    assert all(path.stat().st_size > 20_000 for path in pictures)
    for table in made.tables:
        assert all(len(row) == len(table.columns) for row in table.rows)
        assert table.title in (folder / f"{made.study}.md").read_text(encoding="utf-8")
    json.dumps(made.document, allow_nan=False)
    document: dict = json.loads((folder / f"{made.study}.json").read_text())  # type: ignore[type-arg]
    return document


@pytest.fixture(scope="module")
def sizes() -> list[SchemesResult]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sample_size, "STAIRCASE", SHORT)
        patch.setattr(sample_size, "SCHEMES", {"N_90": 20, "N_180": 40})
        return [sample_size.examine(seed) for seed in (100, 101)]


def test_sample_sizes_are_means_over_the_benches(
    sizes: list[SchemesResult], tmp_path: Path
) -> None:
    document = document_of(sample_size.STUDY.report(sizes), tmp_path, 3)
    assert document["seeds"] == [100, 101]
    for name in ("N_90", "N_180"):
        found = document["schemes"][name]
        runs = [result.schemes[name] for result in sizes]
        assert found["benches"] == 2
        assert found["rms_error_k"] == pytest.approx(
            np.mean([run.rings[ring].rms_error_k for run in runs for ring in RINGS])
        )
        assert found["coverage_95"] == pytest.approx(
            np.mean([run.rings[ring].coverage_95 for run in runs for ring in RINGS])
        )
        for ring in RINGS:
            errors = [run.rings[ring].max_error_k for run in runs]
            assert found["max_error_c"][ring] == pytest.approx(np.mean(errors))
            assert found["methods"]["twin"][ring]["max_error_k"] == pytest.approx(np.mean(errors))
            assert set(found["methods"]) >= {"persistence", "static_linear", "arx"}
        for number, node in enumerate(NODES):
            distances = [np.linalg.norm(run.node_errors_k[number]) for run in runs]
            assert found["nodes"][node]["euclidean_distance_k"] == pytest.approx(np.mean(distances))
    assert document["schemes"]["N_90"]["paper"]["max_error_c"]["t_inner_ring_c"] == 3.74
    assert document["schemes"]["N_180"]["paper"]["euclidean_distance_k"] == 7.8


def test_a_refused_fit_counts_in_no_figure_but_is_named(
    sizes: list[SchemesResult],
) -> None:
    first, second = sizes
    schemes = {**first.schemes, "N_90": replace(first.schemes["N_90"], refused="poor fit")}
    found = sample_size.STUDY.report([replace(first, schemes=schemes), second]).document["schemes"]
    assert found["N_90"]["benches"] == 1
    assert found["N_90"]["refused"] == {100: "poor fit"}
    assert found["N_180"]["benches"] == 2
    only = second.schemes["N_90"].rings["t_inner_ring_c"].max_error_k
    assert found["N_90"]["max_error_c"]["t_inner_ring_c"] == pytest.approx(only)


def test_a_bench_that_runs_away_is_reported_apart(
    sizes: list[SchemesResult],
) -> None:
    first, second = sizes
    made = sample_size.STUDY.report([replace(first, ran_away=True), second])
    assert list(made.document["ran_away"]) == [100]
    apart = made.document["ran_away"][100]["N_90"]
    assert apart["warned"] == first.schemes["N_90"].warned
    assert apart["max_error_c"] == {
        ring: first.schemes["N_90"].rings[ring].max_error_k for ring in RINGS
    }
    assert made.document["schemes"]["N_90"]["benches"] == 1
    nobody = sample_size.STUDY.report([replace(one, ran_away=True) for one in sizes])
    assert nobody.document["schemes"]["N_90"]["coverage_95"] is None
    json.dumps(nobody.document, allow_nan=False)


@pytest.fixture(scope="module")
def loads() -> list[load_runs.LoadRun]:
    """Of two benches; the flat law on one of them."""
    with pytest.MonkeyPatch.context() as patch:
        light = Stage(40, 5800.0, 2650.0)
        trainings = {"single": (light,), "with_stage": (light, Stage(25, 5800.0, 3300.0))}
        patch.setattr(load_runs, "TRAININGS", trainings)
        patch.setattr(load_runs, "LIGHT", light)
        heavy = (Stage(35, 5800.0, 4000.0), Stage(35, 5800.0, 5500.0))
        patch.setattr(load_runs, "HEAVY", heavy)
        tasks = [
            load_runs.Task(101, "catalogue", "single"),
            load_runs.Task(101, "catalogue", "with_stage"),
            load_runs.Task(102, "catalogue", "single"),
            load_runs.Task(101, "flat", "single"),
        ]
        return [load_runs.examine(task) for task in tasks]


def test_variable_load_has_the_papers_conditions(
    loads: list[load_runs.LoadRun], tmp_path: Path
) -> None:
    document = document_of(variable_load.STUDY.report(loads[:2]), tmp_path, 2)
    assert list(document["conditions"]) == ["2650", "4000", "5500"]
    run = loads[0].conditions["5500"].rings["t_inner_ring_c"]
    found = document["conditions"]["5500"]
    assert found["rise_max_c"]["t_inner_ring_c"] == pytest.approx(run.rise_max_k)
    assert found["steady_error_c"]["t_inner_ring_c"] == pytest.approx(run.steady_error_k)
    assert found["half_width_c"]["t_inner_ring_c"] == pytest.approx(run.half_width_k)
    assert found["paper"]["steady_error_c"] == {"t_inner_ring_c": 2.6, "t_outer_ring_c": 0.6}
    assert document["single"]["conditions"] == document["conditions"]
    assert document["with_stage"]["conditions"]["4000"]["benches"] == 1
    assert document["load_laws"]["flat"]["single"]["conditions"]["4000"]["benches"] == 0


def test_other_laws_have_the_same_rolling_friction_at_the_light_load() -> None:
    catalogue, flat = (
        load_runs.bench_with(101, load_runs.LAWS[name]) for name in ("catalogue", "flat")
    )
    assert flat.rolling_load_exponent == 0.05
    assert flat.sliding_scale == pytest.approx(0.6 * catalogue.sliding_scale)
    rolling = [one.rolling_scale * 2650.0**one.rolling_load_exponent for one in (catalogue, flat)]
    assert rolling[0] == pytest.approx(rolling[1])
    runs = [
        run_bench(replace(one, sliding_scale=catalogue.sliding_scale), stages, 101)
        for one in (catalogue, flat)
        for stages in [(Stage(20, 5800.0, 2650.0), Stage(20, 5800.0, 5500.0))]
    ]
    light, heavy = (
        [run.truth_c["t_inner_ring_c"][row] - run.truth_c["t_inner_ring_c"][0] for run in runs]
        for row in (19, 39)
    )
    assert light[0] == pytest.approx(light[1], rel=0.08)
    assert heavy[0] > heavy[1] + 1.0


def test_verdicts_are_counted_against_what_happened(
    loads: list[load_runs.LoadRun],
) -> None:
    def told(run: load_runs.LoadRun, ran_away: bool, warned: bool) -> load_runs.LoadRun:
        conditions = {
            load: replace(one, ran_away=ran_away and load == "5500", warned=warned)
            for load, one in run.conditions.items()
        }
        return replace(run, conditions=conditions)

    base = loads[0]
    runs = [
        told(base, True, True),
        told(base, True, True),
        told(base, True, False),
        told(base, False, True),
        told(base, False, False),
        replace(told(base, True, False), refused="poor fit"),
        replace(told(base, True, False), lost=True),
    ]
    found = variable_load.STUDY.report(runs).document["single"]
    verdicts = found["runaway_verdicts"]["5500"]
    names = ("true", "missed", "false", "rightly_silent", "no_forecast_and_ran_away")
    assert [verdicts[name] for name in names] == [2, 1, 1, 1, 1]
    assert found["conditions"]["5500"]["benches"] == 2
    assert found["conditions"]["4000"]["benches"] == 5
    assert found["ran_away_in_training"] == [101]


def test_a_single_load_says_that_its_law_is_the_priors(
    loads: list[load_runs.LoadRun],
) -> None:
    single, with_stage = loads[:2]
    assert single.conditions["5500"].load_law_labelled
    assert not with_stage.conditions["5500"].load_law_labelled


def test_a_runaway_bench_is_drawn_apart(loads: list[load_runs.LoadRun], tmp_path: Path) -> None:
    away = [
        replace(
            run,
            conditions={**run.conditions, "5500": replace(run.conditions["5500"], ran_away=True)},
        )
        for run in loads[:2]
    ]
    made = variable_load.STUDY.report(away)
    assert list(made.plots) == ["variable-load-runaway"]
    document_of(made, tmp_path, 1)


def test_variable_speed_fits_its_samples_and_scores_every_node(tmp_path: Path) -> None:
    result = variable_speed.examine(100)
    document = document_of(variable_speed.STUDY.report([result]), tmp_path, 2)
    assert document["samples"] == 60
    for ring in RINGS:
        assert document["max_error_c"][ring] < 1.5
    assert list(document["nodes"]) == list(NODES)
    expected = np.sqrt(np.mean(result.node_errors_k[11] ** 2))
    assert document["nodes"]["t_node_12_c"]["rms_error_k"] == pytest.approx(expected)
    refused = variable_speed.STUDY.report([replace(result, refused="poor fit")]).document
    assert refused["benches"] == 0
    json.dumps(refused, allow_nan=False)


def test_rapid_acceleration_is_forecast_from_standstill(tmp_path: Path) -> None:
    result = rapid_acceleration.examine(100)
    assert result.shown.time_h[0] == 0.0
    assert result.shown.ahead_h[0] == 0.0
    assert result.shown.ahead_h.size == 31
    document = document_of(rapid_acceleration.STUDY.report([result]), tmp_path, 1)
    for ring in RINGS:
        own = result.rings[ring]
        assert document["r_squared"][ring] == own.r_squared
        parts = (result.parts["running"][ring], result.parts["standing"][ring])
        assert own.max_error_k == max(part.max_error_k for part in parts)
        assert own.coverage_95 == pytest.approx(
            (25 * parts[0].coverage_95 + 5 * parts[1].coverage_95) / 30
        )
        assert own.r_squared > 0.5


def test_more_reference_nodes_are_compared_in_all_nodes(tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        chosen = {name: reference_nodes.SCHEMES[name] for name in ("rings", "N_Ref_4", "N_Ref_13")}
        patch.setattr(reference_nodes, "SCHEMES", chosen)
        patch.setattr(reference_nodes, "PAPER_DISTANCE_K", {"N_Ref_4": 13.7, "N_Ref_13": 0.7})
        result = reference_nodes.examine(100)
        document = document_of(reference_nodes.STUDY.report([result]), tmp_path, 1)
    assert set(result.schemes["N_Ref_4"].node_errors_k.shape) == {13, 20}
    for name, one in result.schemes.items():
        distance = np.mean(np.linalg.norm(one.node_errors_k, axis=1))
        assert document["schemes"][name]["euclidean_distance_k"] == pytest.approx(distance)
    assert document["schemes"]["N_Ref_4"]["sensors"] == list(NODES[:4])
    four, all_nodes = (
        document["schemes"][name]["euclidean_distance_k"] for name in ("N_Ref_4", "N_Ref_13")
    )
    assert all_nodes < 0.8 * four, "what the study is about"
    assert document["falls_monotonically"] is True


@pytest.mark.parametrize(
    ("distances_k", "falls"),
    [
        ([13.7, 8.0, 0.7], True),
        ([13.7, 0.7, 8.0], False),
        ([3.0, 3.0], False),
        ([3.0, None], False),
    ],
)
def test_distances_fall_only_if_each_is_smaller_than_the_one_before(
    distances_k: list[float | None], falls: bool
) -> None:
    assert reference_nodes._falls(distances_k) is falls
