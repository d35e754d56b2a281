"""Study ``advice``: whether following the excitation advice narrows and betters the forecast.

A 6016 runs at 5800 rpm under 2650 N for six hours, as in the study ``variable-load``. The twin
identified from that is asked how to learn 5500 N best within 5900 rpm and 3400 N. The bench then
runs what was advised, or the step that was ranked last, or a step that was refused because it
changes speed and load at once, or nothing; the twin is identified again from all of it and
forecasts three hours at 5500 N.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from adapters.virtual_bench import BenchParameters
from service.studies.bench_runs import (
    RINGS,
    Stage,
    Twin,
    follow,
    forecast_from,
    identify_twin,
    run_bench,
)
from service.studies.bench_scores import Score, score_rings
from service.studies.common import (
    Options,
    Plot,
    Progress,
    Report,
    Table,
    figure,
    in_processes,
)
from twin_core.forecasting.advice import Advice, advise
from twin_core.forecasting.design import Level, Present
from twin_core.forecasting.labels import RUNAWAY
from twin_core.windows import LowRiskRegion

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAME = "advice"
BEARING = "6016"
BENCHES = 20
LIGHT = Stage(360, 5800.0, 2650.0)
HEAVY = Stage(180, 5800.0, 5500.0)
REGION = LowRiskRegion(speed_rpm_max=5900.0, load_n_max=3400.0)
WARNING_C = {"t_inner_ring_c": 90.0, "t_outer_ring_c": 80.0}
ALARM_C = {"t_inner_ring_c": 105.0, "t_outer_ring_c": 95.0}
ARMS = {
    "none": "no step",
    "advised": "ranked first",
    "worst": "ranked last",
    "refused": "speed and load at once",
}


@dataclass(frozen=True, slots=True)
class Arm:
    """What one choice of step led to on one bench.

    Parameters
    ----------
    levels
        The step, empty for none.
    predicted_k
        Half-width at the end of the target that the advice expected, by sensor; of a refused
        step none.
    obtained_k
        Half-width that the twin then had.
    rings
        Scores of the forecast.
    warned
        Whether it said "runaway not excluded".
    refused_fit
        Why the new fit must not forecast; empty if it may.
    """

    levels: tuple[Level, ...]
    predicted_k: Mapping[str, float]
    obtained_k: Mapping[str, float]
    rings: Mapping[str, Score]
    warned: bool
    refused_fit: str


@dataclass(frozen=True, slots=True)
class BenchResult:
    """One bench: all arms, and whether it truly ran away at the target or before."""

    seed: int
    arms: Mapping[str, Arm]
    ran_away: bool

    @property
    def complete(self) -> bool:
        """Whether there was a step to advise."""
        return len(self.arms) == len(ARMS)


def run(progress: Progress, options: Options) -> Report:
    """Run all arms on all benches."""
    return report(in_processes(examine, options.seeds(BENCHES), progress))


def examine(seed: int) -> BenchResult:
    """Ask for advice on one bench and run all arms."""
    bench = BenchParameters.random(seed, BEARING)
    advice = asked(*identify_light(bench, seed))
    arms = {}
    ran_away = False
    for name, (levels, predicted) in chosen(advice).items():
        stages = tuple(
            Stage(round(level.duration_s / 60), level.speed_rpm, level.load_n) for level in levels
        )
        done = run_bench(bench, (LIGHT, *stages, HEAVY), seed)
        first = done.first_row(1 + len(stages))
        end = first + HEAVY.minutes
        twin = identify_twin(done, first)
        made = forecast_from(twin, done, first - 1, done.measured(first - 1, end))
        arms[name] = Arm(
            levels,
            predicted,
            {ring: float(0.5 * np.ptp(made.quantile(ring)[[0, 4], -1])) for ring in RINGS},
            score_rings(made, done, first - 1, first, end),
            RUNAWAY in made.labels,
            "" if twin.may_forecast else twin.result.reason,
        )
        ran_away = ran_away or done.ran_away(0, end)
    return BenchResult(seed, arms, ran_away)


def identify_light(bench: BenchParameters, seed: int) -> tuple[Twin, Present]:
    """Identify from the single load, and where the machine then is."""
    done = run_bench(bench, (LIGHT,), seed)
    twin = identify_twin(done, LIGHT.minutes)
    observer = follow(twin, done, LIGHT.minutes - 1)
    present = Present(
        observer.temperatures_c,
        observer.covariance,
        observer.revolutions,
        float(done.minutes.ambient_c[-1]),
        observer.heat_disturbance_w,
    )
    return twin, present


def asked(twin: Twin, present: Present) -> Advice:
    """The advice of a twin on how to learn the target."""
    target = Level(HEAVY.speed_rpm, HEAVY.load_n, 60.0 * HEAVY.minutes)
    return advise(
        twin.model,
        twin.posterior,
        present,
        target,
        REGION,
        WARNING_C,
        alarm_limits=ALARM_C,
    )


def chosen(advice: Advice) -> dict[str, tuple[tuple[Level, ...], Mapping[str, float]]]:
    """The step of every arm, and the half-widths that the advice expects after it.

    Without a feasible step there is only the arm without any.
    """
    both = [step.levels for step in advice.excluded if "at once" in step.reason]
    # The one that looks most tempting: heaviest, held longest, a single level.
    tempting = max(
        both, key=lambda levels: (-len(levels), levels[0].load_n, levels[0].duration_s), default=()
    )
    arms: dict[str, tuple[tuple[Level, ...], Mapping[str, float]]] = {
        "none": ((), {name: found.half_width_k for name, found in advice.now.items()})
    }
    if advice.steps:
        best, worst = advice.steps[0], advice.steps[-1]
        arms["advised"] = (best.levels, best.half_width_k)
        arms["worst"] = (worst.levels, worst.half_width_k)
        arms["refused"] = (tempting, {})
    return arms


def report(found: Sequence[BenchResult]) -> Report:
    """Put all benches together."""
    normal = [one for one in found if one.complete and not one.ran_away]
    figures = {name: _figures([one.arms[name] for one in normal], name) for name in ARMS}
    document = {
        "study": NAME,
        "bearing": BEARING,
        "seeds": [one.seed for one in found],
        "target": {"speed_rpm": HEAVY.speed_rpm, "load_n": HEAVY.load_n},
        "arms": figures,
        "no_feasible_step": [one.seed for one in found if not one.complete],
        "ran_away": {
            one.seed: {name: arm.warned for name, arm in one.arms.items()}
            for one in found
            if one.ran_away
        },
        "steps": {
            one.seed: {
                name: [[level.speed_rpm, level.load_n, level.duration_s] for level in arm.levels]
                for name, arm in one.arms.items()
            }
            for one in found
        },
    }
    plots = (Plot("advice-widths", partial(draw_widths, normal)),)
    return Report(NAME, document, (_table(figures, len(normal), len(found)),), plots)


def _figures(arms: Sequence[Arm], name: str) -> dict[str, Any]:
    used = [arm for arm in arms if not arm.refused_fit]

    def mean(values: Sequence[float]) -> float | None:
        return float(np.mean(values)) if values else None

    return {
        "benches": len(used),
        "fits_refused": len(arms) - len(used),
        "half_width_predicted_k": {
            ring: mean([arm.predicted_k[ring] for arm in used if arm.predicted_k]) for ring in RINGS
        },
        "half_width_obtained_k": {
            ring: mean([arm.obtained_k[ring] for arm in used]) for ring in RINGS
        },
        "steady_error_c": {
            ring: mean([arm.rings[ring].steady_error_k for arm in used]) for ring in RINGS
        },
        "steady_bias_c": {
            ring: mean([arm.rings[ring].steady_bias_k for arm in used]) for ring in RINGS
        },
        "coverage_95": {
            ring: mean([arm.rings[ring].coverage_95 for arm in used]) for ring in RINGS
        },
        "worst_coverage_95": {
            ring: min((arm.rings[ring].coverage_95 for arm in used), default=None) for ring in RINGS
        },
        "runaway_not_excluded": sum(arm.warned for arm in used),
    }


def _table(figures: Mapping[str, Any], used: int, benches: int) -> Table:
    def both(by_ring: Mapping[str, float | None], factor: float = 1.0, digits: int = 1) -> str:
        return " / ".join(
            "-" if by_ring[ring] is None else f"{factor * by_ring[ring]:.{digits}f}"  # type: ignore[operator]
            for ring in RINGS
        )

    rows = tuple(
        (
            text,
            both(figures[name]["half_width_predicted_k"]),
            both(figures[name]["half_width_obtained_k"]),
            both(figures[name]["steady_error_c"], digits=2),
            both(figures[name]["coverage_95"], 100.0, 0),
            both(figures[name]["worst_coverage_95"], 100.0, 0),
        )
        for name, text in ARMS.items()
    )
    return Table(
        f"Excitation advice: forecasts at {HEAVY.speed_rpm:g} rpm, {HEAVY.load_n:g} N "
        "(T_ir / T_or)",
        (
            "step before",
            "half-width predicted, K",
            "obtained, K",
            "steady error, K",
            "coverage, %",
            "worst bench, %",
        ),
        rows,
        (
            f"Means over {used} of {benches} random benches; the others ran away at "
            f"{HEAVY.load_n:g} N, or were too hot for any step. Half-widths are those of the 95 % "
            "band at the end of the three hours. What a refused step would bring is not predicted.",
        ),
    )


def draw_widths(found: Sequence[BenchResult]) -> "Figure":
    """Half-widths of the inner ring: predicted over obtained, one point per bench and arm."""
    drawing = figure(5.5, 4.5)
    axes = drawing.add_subplot()
    ring = RINGS[0]
    longest = 1.0
    for name, text in ARMS.items():
        pairs = [
            (one.arms[name].predicted_k[ring], one.arms[name].obtained_k[ring])
            for one in found
            if one.arms[name].predicted_k
        ]
        if pairs:
            predicted, obtained = zip(*pairs, strict=True)
            longest = max(longest, *predicted, *obtained)
            axes.plot(predicted, obtained, "o", markersize=5, alpha=0.8, label=text)
    axes.plot([1.0, longest], [1.0, longest], color="0.5", linewidth=0.8)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="half-width expected by the advice, K",
        ylabel="half-width after the step, K",
        title=f"T_ir at {HEAVY.speed_rpm:g} rpm, {HEAVY.load_n:g} N",
    )
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small")
    return drawing
