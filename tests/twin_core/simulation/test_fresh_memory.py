"""Kernels must not read what earlier computations left in memory."""

import numpy as np
import pytest

from twin_core.bearings import bearing
from twin_core.models import build_model
from twin_core.network_model import NetworkModel
from twin_core.networks.simple_5 import simple_5_model
from twin_core.simulation import OperatingProfile, simulate
from twin_core.simulation.sensitivities import simulate_sensitivities


def leave_garbage() -> None:
    """Fill freed memory of many sizes with values that spoil whatever they meet."""
    for size in range(1, 600):
        arrays = [np.full(size, np.nan) for _ in range(6)]
        del arrays


@pytest.mark.parametrize("model", [build_model("paper", bearing=bearing("6311")), simple_5_model()],
                         ids=["paper", "simple-5"])  # fmt: skip
def test_derivatives_do_not_depend_on_what_was_in_memory(model: NetworkModel) -> None:
    nodes = len(model.node_names)
    values, start = model.parameters.centre, np.full(nodes, 25.0)
    for seed in range(30):
        rng = np.random.default_rng(seed)
        profile = OperatingProfile(
            np.arange(20) * 600.0,
            rng.uniform(200.0, 1800.0, 20),
            rng.uniform(200.0, 6000.0, 20),
            np.full(20, 20.0),
        )
        leave_garbage()
        found = simulate_sensitivities(model, values, profile, start)
        assert np.isfinite(found.by_value).all()
        leave_garbage()
        path = simulate(model, values, profile, start).temperatures_c
        assert found.temperatures_c == pytest.approx(path, abs=1e-6)
