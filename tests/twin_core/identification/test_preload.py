"""What a refused fit says of an inner ring that loses its clearance."""

from dataclasses import replace

import numpy as np
import pytest

from adapters.virtual_bench.families import random_bench
from bearing_twin_laboratory.studies.bench_runs import Stage, identify_twin, run_bench
from twin_core.identification import IdentificationData, IdentificationWindow
from twin_core.identification.gates import judge
from twin_core.identification.posterior import prior_posterior
from twin_core.identification.preload import preload_warning
from twin_core.windows import MinuteData


@pytest.mark.parametrize(
    ("above_k", "climb_k_per_min", "warns"),
    [(25.0, 0.05, True), (25.0, 0.0, True), (15.0, 0.05, False), (25.0, -0.2, False)],
)
def test_only_a_ring_that_is_hot_and_does_not_cool(
    above_k: float, climb_k_per_min: float, warns: bool
) -> None:
    time_s = 60.0 * np.arange(90)
    inner = 60.0 + above_k + climb_k_per_min * (np.arange(90) - 89)
    minutes = MinuteData(
        time_s,
        np.full(90, 5800.0),
        np.full(90, 2650.0),
        np.full(90, 22.0),
        {"t_inner_ring_c": inner, "t_outer_ring_c": np.full(90, 60.0)},
        np.ones(90, np.bool_),
    )
    said = preload_warning(IdentificationData((IdentificationWindow(minutes, at_rest=True),)))
    assert ("a runaway is possible" in said) == warns


def test_a_bench_that_is_about_to_run_away_is_refused_with_that_reason() -> None:
    """Mounted 14 um too tight; it runs away at 4000 N, three hours later."""
    bench = random_bench(1163, "6016")
    bench = replace(bench, clearance_um=bench.clearance_um - 14.0)
    run = run_bench(bench, (Stage(360, 5800.0, 2650.0), Stage(180, 5800.0, 4000.0)), 1163)
    assert not run.ran_away(0, 360)
    assert run.ran_away(360, 540)
    twin = identify_twin(run, 360)
    low = run.minutes.take(slice(0, 360))
    data = IdentificationData((IdentificationWindow(low, at_rest=True),))
    report = judge(twin.model, data, twin.result, active=prior_posterior(twin.model))
    assert not report.accepted
    assert "K rms only" in report.reason
    assert "losing its clearance (thermal preload), a runaway is possible" in report.reason
