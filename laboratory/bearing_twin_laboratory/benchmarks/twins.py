"""Ten thousand live estimates, advanced together."""

import time

import numpy as np

from bearing_twin_laboratory.benchmarks.common import Measurement, Progress, shortest_s
from twin_core.bearings import bearing
from twin_core.identification.posterior import prior_posterior
from twin_core.models import build_model
from twin_core.observer import Observer
from twin_core.observers import Observers

MACHINES = 10_000
ALONE = 50
STEPS = 20
STEP_S = 1.0
SENSORS = ("t_inner_ring_c", "t_outer_ring_c")


def twins_10000(progress: Progress) -> Measurement:
    """A step of 1 s of 10,000 machines at ever new operating points, with two readings each.

    The reference is the same machines by `Observer`, one after the other: some of them are, and
    their time stands for all. These are also compared with those advanced together.
    """
    progress(0.0, "10,000 machines")
    rng = np.random.default_rng(0)
    model = build_model("default", bearing=bearing("6311"))
    spread = rng.normal(0.0, 0.1, (MACHINES, model.parameters.size))
    values = model.parameters.values_from_z(prior_posterior(model).z + spread)
    nodes = len(model.node_names)
    start_c = 40.0 + rng.normal(0.0, 3.0, (MACHINES, nodes))
    covariance = 4.0 * np.eye(nodes)
    together = Observers(
        model, values, start_c, np.tile(covariance, (MACHINES, 1, 1)), np.zeros(MACHINES)
    )
    alone = [
        Observer(model, own, begin_c, covariance)
        for own, begin_c in zip(values[:ALONE], start_c[:ALONE], strict=True)
    ]
    point = np.array([2400.0, 2650.0, 23.0])
    progress(0.3, "steps")
    processor_s, greatest_k = float("inf"), 0.0
    for _ in range(STEPS):
        points = point * (1.0 + 0.01 * rng.standard_normal((MACHINES, 3)))
        readings = 45.0 + rng.normal(0.0, 2.0, (MACHINES, len(SENSORS)))
        began_s = time.process_time()
        together.predict(STEP_S, *points.T)
        together.update(SENSORS, readings)
        processor_s = min(processor_s, time.process_time() - began_s)
        for observer, own, given in zip(alone, points.tolist(), readings.tolist(), strict=False):
            observer.predict(STEP_S, *own)
            observer.update(dict(zip(SENSORS, given, strict=True)))
    for observer, all_c in zip(alone, together.temperatures_c, strict=False):
        greatest_k = max(greatest_k, float(np.abs(observer.temperatures_c - all_c).max()))
    progress(0.8, "one after the other")

    def one_after_the_other() -> None:
        for observer, own in zip(alone, points.tolist(), strict=False):
            observer.predict(STEP_S, *own)
            observer.update(dict.fromkeys(SENSORS, 45.0))

    return Measurement(
        processor_s,
        "s",
        shortest_s(one_after_the_other) / ALONE * MACHINES,
        f"{ALONE} of them one after the other, times {MACHINES // ALONE}",
        {"machines": MACHINES, "greatest_difference_k": greatest_k},
    )
