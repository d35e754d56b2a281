"""Gates: what is left out and predicted, and which candidates pass."""

import json
from dataclasses import replace

import numpy as np
import pytest

from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.gates import judge
from twin_core.identification.identify import FitSettings, identify
from twin_core.identification.posterior import TrainedRange, prior_posterior
from twin_core.identification.prediction_tests import predict_rows, prediction_tests
from twin_core.identification.refinement import IdentificationCancelled


def at_rest(*windows) -> IdentificationData:  # type: ignore[no-untyped-def]
    return IdentificationData(tuple(IdentificationWindow(rows, at_rest=True) for rows in windows))


@pytest.fixture(scope="module")
def candidate(model, cold_start):  # type: ignore[no-untyped-def]
    return identify(model, cold_start, FitSettings(method="refine", samples=0))


def test_leaves_out_the_most_demanding_and_the_latest_point(synthesise, true_z) -> None:  # type: ignore[no-untyped-def]
    stages = ((3, 0.0, 2650.0), (30, 1500.0, 2650.0), (30, 4200.0, 2650.0), (30, 2400.0, 2650.0))
    tests = {test.name: test for test in prediction_tests(at_rest(synthesise(true_z, stages)))}
    extrapolation, latest = tests["extrapolation"], tests["latest"]
    assert extrapolation.point.speed_rpm == pytest.approx(4200.0)
    assert extrapolation.training.windows[0].minutes.speed_rpm.max() == 1500.0
    assert extrapolation.rows.speed_rpm[0] == 1500.0  # the prediction starts from there
    assert set(extrapolation.rows.speed_rpm[1:]) == {4200.0}
    assert latest.point.speed_rpm == pytest.approx(2400.0)
    assert latest.training.windows[0].minutes.speed_rpm.max() == 4200.0


def test_no_other_window_may_teach_the_demanding_point(synthesise, true_z) -> None:  # type: ignore[no-untyped-def]
    rise = ((3, 0.0, 2650.0), (30, 1500.0, 2650.0), (30, 4200.0, 2650.0))
    easy = ((3, 0.0, 2650.0), (40, 2000.0, 2650.0))
    data = at_rest(synthesise(true_z, rise), synthesise(true_z, easy), synthesise(true_z, rise))
    extrapolation, latest = prediction_tests(data)
    speeds = [window.minutes.speed_rpm.max() for window in extrapolation.training.windows]
    assert speeds == [1500.0, 2000.0, 1500.0]
    # what came later must not teach the latest point either, what came before may
    assert [w.minutes.speed_rpm.max() for w in latest.training.windows] == [4200.0, 2000.0, 1500.0]


def test_a_single_point_is_predicted_in_its_last_third(synthesise, true_z) -> None:  # type: ignore[no-untyped-def]
    data = at_rest(synthesise(true_z, ((1, 0.0, 2650.0), (90, 1500.0, 2650.0))))
    (test,) = prediction_tests(data)
    assert test.name == "latest"
    assert test.rows.size == 31
    assert test.training.windows[0].minutes.size == 61


def test_nothing_lasting_gives_no_test(synthesise, true_z) -> None:  # type: ignore[no-untyped-def]
    assert (
        prediction_tests(at_rest(synthesise(true_z, ((3, 0.0, 0.0), (15, 1500.0, 2650.0))))) == []
    )


def test_true_parameters_predict_the_left_out_rows(model, synthesise, true_z) -> None:  # type: ignore[no-untyped-def]
    for test in prediction_tests(at_rest(synthesise(true_z))):
        true, prior = predict_rows(model, [true_z, np.zeros(true_z.size)], test)
        assert max(true.values()) < 0.05
        assert max(prior.values()) > 0.3
        # One with others is one alone.
        assert predict_rows(model, [true_z], test) == [true]


def test_a_fresh_twin_is_beaten(model, cold_start, candidate) -> None:  # type: ignore[no-untyped-def]
    report = judge(model, cold_start, candidate, active=prior_posterior(model))
    assert report.accepted
    assert [check.name for check in report.checks] == [
        "fit",
        "ranges",
        "residuals",
        "extrapolation",
    ]
    scores = report.scores["extrapolation"]
    assert scores["nested_rms_k"] < scores["active_rms_k"]
    assert not scores["active_has_seen_it"]
    assert set(report.naive["extrapolation"]) == {"persistence", "static_linear", "arx"}
    assert "3300 N" in report.reason
    json.dumps(report.to_dict(), allow_nan=False)


def test_an_active_model_that_knows_the_truth_is_not_replaced(
    model,
    cold_start,
    candidate,
    true_z,  # type: ignore[no-untyped-def]
) -> None:
    """The candidate's own procedure does worse than what is active, on data neither has seen."""
    perfect = replace(prior_posterior(model), z=true_z)
    stages_known = TrainedRange(candidate.posterior.trained.operating_points[:2], 80)
    worse = replace(candidate, posterior=replace(candidate.posterior, trained=stages_known))
    active = replace(perfect, trained=stages_known)
    report = judge(model, cold_start, worse, active=active)
    scores = report.scores["extrapolation"]
    assert scores["active_rms_k"] < 0.15
    assert report.accepted == (scores["nested_rms_k"] <= scores["active_rms_k"] - 0.05)
    assert not report.accepted
    assert "extrapolation" in report.reason


def test_more_varied_data_win_a_tie(model, cold_start, candidate) -> None:  # type: ignore[no-untyped-def]
    """Re-identification with an added load stage; the active model comes from the part before."""
    before = at_rest(cold_start.windows[0].minutes.take(slice(0, 83)))
    active = identify(model, before, FitSettings(method="refine", samples=0)).posterior
    report = judge(model, cold_start, candidate, active=active)
    assert report.accepted, report.reason
    scores = report.scores["extrapolation"]
    assert scores["nested_rms_k"] == pytest.approx(scores["active_rms_k"], abs=0.05)


def test_an_equal_model_from_the_same_data_is_accepted_again(model, cold_start, candidate) -> None:  # type: ignore[no-untyped-def]
    report = judge(model, cold_start, candidate, active=candidate.posterior)
    assert report.accepted, report.reason
    assert report.scores["extrapolation"]["active_has_seen_it"]


def test_a_candidate_that_lost_what_the_active_one_knew_is_refused(
    model,
    cold_start,
    candidate,  # type: ignore[no-untyped-def]
) -> None:
    spoilt = candidate.posterior.z.copy()
    spoilt[model.parameters.index("M0")] += 1.0
    worse = replace(candidate, posterior=replace(candidate.posterior, z=spoilt))
    report = judge(model, cold_start, worse, active=candidate.posterior)
    assert not report.accepted
    assert "which has seen it" in report.reason


def test_failed_fit_and_parameters_at_the_edge_are_refused(model, cold_start, candidate) -> None:  # type: ignore[no-untyped-def]
    failed = replace(candidate, status="failed fit", reason="t_outer_ring_c is met with 2 K")
    report = judge(model, cold_start, failed, active=prior_posterior(model))
    assert not report.accepted
    assert report.reason == "fit: t_outer_ring_c is met with 2 K"
    z = candidate.posterior.z.copy()
    z[model.parameters.index("Cs")] = 3.95
    edge = replace(candidate, posterior=replace(candidate.posterior, z=z))
    report = judge(model, cold_start, edge, active=prior_posterior(model))
    assert not report.accepted
    assert "Cs at the edge" in report.reason


def test_systematic_residuals_are_refused(model, synthesise, true_z) -> None:  # type: ignore[no-untyped-def]
    rows = synthesise(true_z)
    rows.temperatures_c["t_outer_ring_c"][:] += 4.0 * np.sin(rows.time_s / 700.0)
    data = at_rest(rows)
    result = identify(model, data, FitSettings(method="refine", samples=0))
    report = judge(model, data, result, active=prior_posterior(model))
    check = {check.name: check for check in report.checks}["residuals"]
    assert not check.passed
    assert "t_outer_ring_c" in check.detail
    assert not report.accepted


def test_cancellation_and_foreign_models(model, cold_start, candidate) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(IdentificationCancelled):
        judge(
            model,
            cold_start,
            candidate,
            active=prior_posterior(model),
            cancelled=lambda: True,
        )
    with pytest.raises(ValueError, match="6016"):
        judge(
            model,
            cold_start,
            candidate,
            active=replace(prior_posterior(model), bearing="6016"),
        )
