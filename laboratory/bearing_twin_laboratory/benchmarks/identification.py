"""Identification with the default method from a bench's 270 minutes with two sensors."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from adapters.virtual_bench import BenchParameters
from bearing_twin_laboratory.benchmarks.cold import identified, keep
from bearing_twin_laboratory.benchmarks.common import (
    BenchmarkError,
    Measurement,
    Progress,
    shortest_s,
)
from bearing_twin_laboratory.studies.bench_runs import (
    RINGS,
    BenchRun,
    Stage,
    run_bench,
    with_sensors,
)
from twin_core.identification import IdentificationData, IdentificationWindow
from twin_core.identification.problem import IdentificationProblem
from twin_core.models import build_model
from twin_core.windows import MinuteData

SAMPLES = 270
STAGES = tuple(Stage(90, speed, 2650.0) for speed in (1500.0, 2400.0, 3300.0))
BENCH_SEED = 100


def identify_15_parameters(progress: Progress) -> Measurement:
    """The paper's 15 parameters, also in a process of its own."""
    return _measured("paper", progress, cold=True)


def identify_default_model(progress: Progress) -> Measurement:
    """The default model."""
    return _measured("default", progress, cold=False)


def _measured(name: str, progress: Progress, *, cold: bool) -> Measurement:
    progress(0.0, "a virtual bench runs")
    run = bench_run()
    rows = with_sensors(run.minutes.take(slice(0, SAMPLES)), RINGS)
    progress(0.2, "identification")
    value = shortest_s(lambda: identified(name, run.bearing, rows), at_least=3)
    progress(0.5, "a library's least squares")
    reference = shortest_s(lambda: _library(name, run.bearing, rows), at_least=1, at_least_s=0.0)
    result = identified(name, run.bearing, rows)
    extra: dict[str, object] = {
        "parameters": result.posterior.z.size,
        "rms_error_k": dict(result.posterior.train_rms_k),
        "evaluations": result.evaluations,
        "status": result.status,
    }
    if cold:
        progress(0.8, "a cold process")
        extra["cold_s"] = _cold_s(name, run.bearing, rows)
    return Measurement(
        value,
        "s",
        reference,
        "scipy least_squares, finite differences, one start at the priors' centre: "
        "no search, no covariance, no samples",
        extra,
    )


def bench_run() -> BenchRun:
    """A random bench of the virtual bench's family over three speeds of 90 minutes."""
    return run_bench(BenchParameters.random(BENCH_SEED), STAGES, BENCH_SEED)


def _library(name: str, designation: str, rows: MinuteData) -> None:
    from twin_core.bearings import bearing

    model = build_model(name, bearing=bearing(designation))
    window = IdentificationWindow(rows, at_rest=True)
    problem = IdentificationProblem(model, IdentificationData((window,)))
    bounds = (problem.lower, problem.upper)
    start = np.clip(np.zeros(problem.unknown_count), *bounds)
    least_squares(lambda unknowns: problem.residuals(unknowns)[0], start, bounds=bounds)


def _cold_s(name: str, designation: str, rows: MinuteData) -> float:
    """Duration of a process that only imports and identifies; the first fills the cache."""
    durations = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.npz"
        keep(file, rows)
        for _ in range(2):
            begun = time.perf_counter()
            ended = subprocess.run(
                [
                    sys.executable,
                    "-m",
                    f"{__package__}.cold",
                    name,
                    designation,
                    str(file),
                ],
                capture_output=True,
                text=True,
                check=False,
            )
            durations.append(time.perf_counter() - begun)
            if ended.returncode != 0:
                last = (ended.stderr.strip().splitlines() or ["no message"])[-1]
                raise BenchmarkError(f"the cold process failed: {last}")
    return durations[-1]
