"""A forecast ensemble: 200 members, 4 h at 60 s, all nodes, quantiles."""

import numpy as np

from bearing_twin_laboratory.benchmarks.common import Measurement, Progress, shortest_s
from bearing_twin_laboratory.benchmarks.identification import SAMPLES, bench_run
from bearing_twin_laboratory.studies.bench_runs import follow, identify_twin
from twin_core.forecasting import forecast
from twin_core.simulation import OperatingProfile, simulate

MEMBERS = 200
MINUTES = 240


def forecast_ensemble(progress: Progress) -> Measurement:
    """A step to 5600 rpm and 4000 N, next to as many single simulations one after the other."""
    progress(0.0, "a virtual bench runs")
    run = bench_run()
    progress(0.2, "identification")
    twin = identify_twin(run, SAMPLES)
    observer = follow(twin, run, SAMPLES - 1)
    count = MINUTES + 1
    ahead = OperatingProfile(
        60.0 * np.arange(count, dtype=np.float64),
        np.full(count, 5600.0),
        np.full(count, 4000.0),
        np.full(count, 22.0),
    )
    progress(0.5, "forecasts")
    value = shortest_s(
        lambda: forecast(twin.model, twin.posterior, observer.state(), ahead, members=MEMBERS),
        at_least_s=2.0,
    )
    progress(0.8, "single simulations")
    samples = twin.model.parameters.values_from_z(twin.posterior.samples[:MEMBERS])

    def one_after_the_other() -> None:
        for values in samples:
            simulate(twin.model, values, ahead, observer.temperatures_c, observer.revolutions)

    return Measurement(
        value,
        "s",
        shortest_s(one_after_the_other),
        f"{len(samples)} single simulations, one after the other, without intervals",
        {"members": MEMBERS, "rows": count},
    )
