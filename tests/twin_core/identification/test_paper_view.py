"""The paper's 15 numbers and their intervals, from a posterior in combinations of them."""

from dataclasses import replace

import numpy as np
import pytest

from twin_core.bearings import bearing
from twin_core.identification.paper_view import paper_view
from twin_core.identification.posterior import Posterior, prior_posterior
from twin_core.models import ThermalModel, build_model


@pytest.fixture(scope="module")
def reduced() -> ThermalModel:
    return build_model("paper-reduced", bearing=bearing("6311"))


@pytest.fixture(scope="module")
def known(reduced: ThermalModel) -> Posterior:
    """Contact resistance and exponent known to a tenth of the prior, nothing else at all."""
    std = np.full(reduced.parameters.size, 1e-9)
    std[reduced.parameters.index("Rc")] = 0.1
    return replace(prior_posterior(reduced), covariance=np.diag(std**2))


def test_intervals_of_the_normal_approximation(reduced: ThermalModel, known: Posterior) -> None:
    view = paper_view(reduced, known)
    assert view is not None
    # Kc2 = Rc sqrt(F n), log-normal with 0.7 * 0.1: 95 % interval exp(-+1.96 * 0.07)
    value = 0.4 * np.sqrt(2650.0 * 3000.0)
    assert view["Kc2"]["value"] == pytest.approx(value)
    assert view["Kc2"]["low"] == pytest.approx(value * np.exp(-1.96 * 0.07), rel=0.03)
    assert view["Kc2"]["high"] == pytest.approx(value * np.exp(1.96 * 0.07), rel=0.03)
    assert view["f2"]["low"] == pytest.approx(0.45, rel=1e-5)
    assert view["f2"]["high"] == pytest.approx(0.45, rel=1e-5)


def test_samples_come_first(reduced: ThermalModel, known: Posterior) -> None:
    samples = np.zeros((101, reduced.parameters.size))
    samples[:, reduced.parameters.index("M0")] = np.linspace(-1.0, 1.0, 101)
    view = paper_view(reduced, replace(known, samples=samples))
    assert view is not None
    assert view["f2"]["low"] == pytest.approx(0.45 * np.exp(-0.5 * 0.95), rel=1e-3)
    assert view["f2"]["high"] == pytest.approx(0.45 * np.exp(0.5 * 0.95), rel=1e-3)
    assert view["Kc2"]["low"] == pytest.approx(view["Kc2"]["high"])


def test_other_models_have_none_and_other_posteriors_are_refused(
    reduced: ThermalModel, known: Posterior
) -> None:
    default = build_model(bearing=bearing("6311"))
    assert paper_view(default, prior_posterior(default)) is None
    with pytest.raises(ValueError, match="does not belong"):
        paper_view(reduced, prior_posterior(default))
