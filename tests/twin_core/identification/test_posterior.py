"""Posterior: Laplace covariance, verdicts, what it was trained on, JSON."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from twin_core.bearings import bearing
from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.posterior import (
    Posterior,
    TrainedRange,
    posterior_at,
    prior_posterior,
)
from twin_core.identification.problem import IdentificationProblem
from twin_core.models import build_model
from twin_core.operating_points import OperatingSpan


def test_covariance_is_the_inverse_information(model, cold_start) -> None:  # type: ignore[no-untyped-def]
    problem = IdentificationProblem(model, cold_start)
    unknowns = np.zeros(problem.unknown_count)
    posterior = posterior_at(problem, unknowns)
    jacobian = problem.jacobian(unknowns)
    p = model.parameters.size
    assert_allclose(posterior.covariance, np.linalg.inv(jacobian.T @ jacobian)[:p, :p], atol=1e-7)
    assert posterior.samples.shape == (0, p)
    assert np.all(posterior.std <= 1.0 + 1e-9)
    assert 1 <= posterior.informed_combinations < p
    assert posterior.rank <= p
    assert posterior.condition > 10.0


def test_few_data_leave_the_prior_where_they_are_silent(model, synthesise, true_z) -> None:  # type: ignore[no-untyped-def]
    rows = synthesise(true_z).take(slice(0, 6))
    data = IdentificationData((IdentificationWindow(rows, at_rest=True),))
    problem = IdentificationProblem(model, data)
    posterior = posterior_at(problem, np.zeros(problem.unknown_count))
    assert posterior.rank <= 12
    verdicts = dict(zip(model.parameters.names, posterior.verdicts(), strict=True))
    assert verdicts["gs"] == "prior only"
    assert np.all(np.isfinite(posterior.covariance))


def test_verdicts_by_the_ratio_of_standard_deviations(model) -> None:  # type: ignore[no-untyped-def]
    prior = prior_posterior(model)
    p = model.parameters.size
    std = np.ones(p)
    std[:3] = 0.49, 0.51, 0.91
    posterior = replace(prior, covariance=np.diag(std**2))
    assert posterior.verdicts()[:3] == ["informed", "weak", "prior only"]
    table = posterior.parameters(model)
    level = table["M0"]
    assert level["verdict"] == "informed"
    # log-normal with ln-sd 0.4: 95 % interval exp(-+1.96 * 0.49 * 0.4)
    assert level["value"] == pytest.approx(1.0)
    assert level["low"] == pytest.approx(np.exp(-1.96 * 0.49 * 0.4), rel=1e-4)
    assert level["high"] == pytest.approx(np.exp(1.96 * 0.49 * 0.4), rel=1e-4)
    assert level["unit"] == "-"


def test_prior_is_not_identified_and_knows_no_operating_point(model) -> None:  # type: ignore[no-untyped-def]
    prior = prior_posterior(model)
    assert not prior.identified
    assert set(prior.verdicts()) == {"prior only"}
    assert prior.trained.speed_rpm_max == 0.0
    assert prior.trained.distinct_loads == 0


def test_trained_range_counts_lasting_points_only() -> None:
    trained = TrainedRange(
        (
            OperatingSpan(1500.0, 2650.0, 3600.0, 0.0),
            OperatingSpan(4200.0, 2700.0, 3600.0, 3600.0),
            OperatingSpan(4200.0, 3300.0, 600.0, 7200.0),
            OperatingSpan(4300.0, 2000.0, 1800.0, 7800.0),
        ),
        minutes=160,
    )
    assert trained.distinct_speeds == 2
    assert trained.distinct_loads == 2
    assert trained.load_n_max == 3300.0
    assert trained.speed_rpm_max == 4300.0


def test_json_round_trip(model, cold_start) -> None:  # type: ignore[no-untyped-def]
    problem = IdentificationProblem(model, cold_start)
    posterior = posterior_at(problem, np.zeros(problem.unknown_count), 20, 1)
    document = json.loads(json.dumps(posterior.to_dict(), allow_nan=False))
    again = Posterior.from_dict(document)
    assert again.to_dict() == posterior.to_dict()
    assert again.trained == posterior.trained
    assert again.sensor_lag_s == pytest.approx(15.0)
    assert again.trained.from_rest
    assert again.identified
    assert_allclose(again.samples, posterior.samples, atol=1e-4)
    prior = prior_posterior(model)
    assert Posterior.from_dict(json.loads(json.dumps(prior.to_dict()))).samples.shape == (0, 24)


def test_a_posterior_of_another_model_is_refused(model) -> None:  # type: ignore[no-untyped-def]
    prior = prior_posterior(model)
    with pytest.raises(ValueError, match="6016"):
        prior.parameters(build_model(bearing=bearing("6016")))
    with pytest.raises(ValueError, match="paper"):
        prior.check(build_model("paper", bearing=bearing("6311")))
