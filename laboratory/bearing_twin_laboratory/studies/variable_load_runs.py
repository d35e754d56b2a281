"""Runs of the study ``variable-load``: one bench with one load law and one training."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

from adapters.virtual_bench import BenchParameters
from bearing_twin_laboratory.studies.bench_runs import (
    Stage,
    forecast_from,
    identify_twin,
    run_bench,
)
from bearing_twin_laboratory.studies.bench_scores import RingScores, beside, score_rings
from bearing_twin_laboratory.studies.drawing import Curves, curves
from bearing_twin_laboratory.studies.forecasters import ForecastScore
from twin_core.forecasting.labels import LOAD_LAW, RUNAWAY

BEARING = "6016"
SPEED_RPM = 5800.0
LIGHT = Stage(360, SPEED_RPM, 2650.0)
FURTHER = Stage(90, SPEED_RPM, 3300.0)
HEAVY = (Stage(180, SPEED_RPM, 4000.0), Stage(180, SPEED_RPM, 5500.0))
LOADS = ("2650", "4000", "5500")
TRAININGS = {"single": (LIGHT,), "with_stage": (LIGHT, FURTHER)}

_CATALOGUE_EXPONENT = 0.54


class LoadLaw(NamedTuple):
    """How a bench's friction depends on the load.

    - ``exponent``: of the rolling friction; its amount at 2650 N stays as it is.
    - ``sliding``: factor on the sliding friction.
    """

    exponent: float
    sliding: float


LAWS = {
    "catalogue": LoadLaw(_CATALOGUE_EXPONENT, 1.0),
    "flat": LoadLaw(0.05, 0.6),
    "steep": LoadLaw(0.90, 1.5),
}


@dataclass(frozen=True, slots=True)
class Task:
    """One bench with one load law and one training."""

    seed: int
    law: str
    training: str


@dataclass(frozen=True, slots=True, eq=False)
class Condition:
    """One load on one bench.

    - ``ran_away``: whether the bench truly passed 110 degC.
    - ``warned``: whether a forecast that ends with this load said "runaway not excluded".
    - ``load_law_labelled``: whether it said that its load law is the prior's.
    - ``methods``: the twin and the methods next to it; none for the training itself and for other
      laws.
    """

    rings: RingScores
    ran_away: bool
    warned: bool
    load_law_labelled: bool
    methods: tuple[ForecastScore, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LoadRun:
    """One bench with one law and one training.

    - ``refused``: why the fit must not forecast; empty if it may.
    - ``lost``: whether the bench ran away in the training already.
    - ``conditions``: by load in newtons.
    - ``fitted``, ``shown``: curves of the training and of the forecast.
    - ``rows``: first row of every heavy stage, and the end.
    """

    task: Task
    refused: str
    lost: bool
    conditions: dict[str, Condition]
    fitted: Curves
    shown: Curves
    rows: tuple[int, ...]


def bench_with(seed: int, law: LoadLaw) -> BenchParameters:
    """A random bench with a load law; rolling friction at 2650 N is that of the random bench."""
    bench = BenchParameters.random(seed, BEARING)
    held = LIGHT.load_n ** (bench.rolling_load_exponent - law.exponent)
    return replace(
        bench,
        rolling_load_exponent=law.exponent,
        rolling_scale=bench.rolling_scale * held,
        sliding_scale=bench.sliding_scale * law.sliding,
    )


def examine(task: Task) -> LoadRun:
    """Identify on one bench and forecast its heavy loads."""
    stages = TRAININGS[task.training]
    bench = run_bench(bench_with(task.seed, LAWS[task.law]), (*stages, *HEAVY), task.seed)
    rows = tuple(bench.first_row(len(stages) + number) for number in range(len(HEAVY) + 1))
    first, end = rows[0], rows[-1]
    twin = identify_twin(bench, first)
    begun = first - 1
    ahead = bench.measured(begun, end)
    made = forecast_from(twin, bench, begun, ahead)
    fitted = forecast_from(twin, bench, 0, bench.measured(0, first))
    light = score_rings(fitted, bench, 0, 1, LIGHT.minutes)
    conditions = {LOADS[0]: Condition(light, False, False, False, ())}
    spans = list(pairwise(rows))
    # What other methods make of other laws is of no interest: theirs is none.
    compared = task.law == "catalogue"
    methods = beside(twin, bench, made, ahead, begun, spans) if compared else [()] * len(spans)
    for load, (start, stop), scored in zip(LOADS[1:], spans, methods, strict=True):
        labels = forecast_from(twin, bench, begun, bench.planned(begun, stop)).labels
        conditions[load] = Condition(
            score_rings(made, bench, begun, start, stop),
            bench.ran_away(first, stop),
            RUNAWAY in labels,
            LOAD_LAW in labels,
            scored,
        )
    return LoadRun(
        task,
        "" if twin.may_forecast else twin.result.reason,
        bench.ran_away(0, first),
        conditions,
        curves(bench, fitted, 0),
        curves(bench, made, begun),
        rows,
    )
