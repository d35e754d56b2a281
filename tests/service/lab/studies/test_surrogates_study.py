"""The study of the paper's three kinds of virtual model, with stages of minutes."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.virtual_bench import BenchParameters
from service.lab.studies import surrogates
from service.lab.studies.bench_runs import RINGS, Stage, forecast_from, identify_twin, run_bench
from service.lab.studies.forecasters import TWIN
from service.lab.studies.study import Options, StudyError
from service.lab.surrogates import SURROGATE_KINDS
from twin_core.forecasting import of_ensemble
from twin_core.naive import NAIVE_KINDS

FEW = (Stage(2, 0.0, 2650.0), Stage(25, 1500.0, 2650.0), Stage(25, 3500.0, 2650.0))
MANY = (*FEW, Stage(25, 3500.0, 2000.0), Stage(25, 4200.0, 3300.0))
TESTS = {"between": (Stage(20, 2500.0, 2650.0),), "heavier": (Stage(25, 3500.0, 5000.0),)}


@pytest.fixture(scope="module")
def result() -> Iterator[surrogates.BenchResult]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surrogates, "TRAININGS", {surrogates.FEW: FEW, surrogates.MANY: MANY})
        patch.setattr(surrogates, "TESTS", TESTS)
        patch.setattr(surrogates, "BACK", Stage(15, 3500.0, 2650.0))
        yield surrogates.examine(100)


def test_all_methods_forecast_all_tests(result: surrogates.BenchResult) -> None:
    twins = [TWIN, "twin_gp", "paper_model", "paper_model_gp"]
    expected = [*twins, *NAIVE_KINDS, *SURROGATE_KINDS]
    for tests in result.scores.values():
        assert list(tests) == list(TESTS)
        for found in tests.values():
            assert list(dict.fromkeys(one.method for one in found)) == expected
            assert all(np.isfinite([one.max_error_k, one.rms_k, one.crps_k]).all() for one in found)
    assert not result.ran_away


def test_a_plain_surrogate_knows_nothing_of_a_load_it_has_not_seen(
    result: surrogates.BenchResult,
) -> None:
    """With a single load its forecast is that of the speed alone; the twin's is not."""
    found = {(one.method, one.sensor): one for one in result.scores[surrogates.FEW]["heavier"]}
    for kind in SURROGATE_KINDS:
        assert found[kind, RINGS[0]].max_error_k > found[TWIN, RINGS[0]].max_error_k, kind
        assert found[kind, RINGS[0]].coverage != 1.0, kind


def test_figures_of_the_report_are_those_of_the_benches(
    result: surrogates.BenchResult, tmp_path: Path
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surrogates, "TESTS", TESTS)
        lost = replace(result, seed=101, ran_away=True)
        made = surrogates.STUDY.report([result, lost])
        written = made.write(tmp_path)
    assert [path.suffix for path in written] == [".json", ".md", ".png", ".png"]
    assert all(path.stat().st_size > 20_000 for path in written[2:])
    document = json.loads(written[0].read_text(encoding="utf-8"))
    assert document["seeds"] == [100, 101]
    assert document["ran_away"] == [101]
    assert document["benches"] == 1
    own = next(one for one in result.scores[surrogates.MANY]["between"] if one.method == "kriging")
    shown = document["trainings"][surrogates.MANY]["tests"]["between"]["kriging"][own.sensor]
    assert shown["max_error_k"] == pytest.approx(own.max_error_k)
    gain = document["trainings"][surrogates.MANY]["hybrid_gain"][TWIN]["between"]
    assert gain["benches_better"] in (0, 1)
    assert gain["hybrid_rms_k"] == pytest.approx(gain["twin_rms_k"], abs=0.5)
    text = written[1].read_text(encoding="utf-8")
    assert "Learned from 12 points: largest error (CRPS), K, T_ir/T_or, 1 benches" in text


def test_a_report_without_any_usable_bench_has_no_figures(
    result: surrogates.BenchResult,
) -> None:
    made = surrogates.STUDY.report([replace(result, ran_away=True)])
    json.dumps(made.document, allow_nan=False)
    assert made.document["benches"] == 0
    assert list(made.plots) == ["surrogates-errors"]


def test_the_twins_path_starts_where_the_bench_does_and_follows_it() -> None:
    bench = run_bench(BenchParameters.random(100, "6311"), FEW, 100)
    twin = identify_twin(bench, 52)
    for ring, path in surrogates.twin_path(twin, bench).items():
        assert path.shape == (52,)
        assert np.max(np.abs(path - bench.minutes.temperatures_c[ring])) < 1.5
    made = forecast_from(twin, bench, 30, bench.planned(30, 52))
    corrected = surrogates.hybrid(twin, bench, of_ensemble(made), 30, 52)
    np.testing.assert_allclose(corrected.centre_c[0], of_ensemble(made).centre_c[0])
    assert np.max(np.abs(corrected.centre_c - of_ensemble(made).centre_c)) < 1.0


def test_the_study_says_how_to_install_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.lab.studies.study.find_spec", lambda name: None)
    with pytest.raises(StudyError, match=r"pip install 'bearing-twin\[bench\]'"):
        surrogates.STUDY.run(lambda fraction, text: None, Options())
