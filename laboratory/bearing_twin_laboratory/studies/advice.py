"""Study ``advice``: whether following the excitation advice narrows and betters the forecast.

Four arrangements. ``known-speed``: a 6016 has run at 5800 rpm under 2650 N for six hours, as in the
study ``variable-load``, and may be run up to 5900 rpm and 3400 N; 5500 N is to be forecast at that
speed. ``unknown-speed``: a 6311 has run the demo's staircase up to 4200 rpm under 2650 N; 5500 N at
6200 rpm is to be forecast. ``first-hour``: the 6016 after its first hour. ``first-hour-speed``: a
6311 after one hour at 1500 rpm, with 2450 rpm allowed; 6200 rpm is to be forecast.

The twin identified from that is asked how to learn the point best. The bench then runs the step
that was ranked first, the next step (of at most 20 min where that is worth while), the step that
was ranked last, one that was refused because it changes speed and load at once, or nothing; the
twin is identified again from all of it and forecasts the point. What was expected is scored by what
came out.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from adapters.virtual_bench import BenchParameters
from bearing_twin_laboratory.studies.bench_runs import (
    RINGS,
    Stage,
    follow,
    forecast_from,
    identify_twin,
    run_bench,
)
from bearing_twin_laboratory.studies.bench_scores import Score, score_rings
from bearing_twin_laboratory.studies.study import (
    Document,
    Drawing,
    Options,
    Study,
    Table,
    cell,
    figure,
    mean,
    named,
    share,
    table,
    text,
)
from twin_core.forecasting.advice import Advice, advise
from twin_core.forecasting.labels import RUNAWAY
from twin_core.profiles import Step
from twin_core.windows import LowRiskRegion

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BENCHES = 20
WARNING_C = {"t_inner_ring_c": 90.0, "t_outer_ring_c": 80.0}
ALARM_C = {"t_inner_ring_c": 105.0, "t_outer_ring_c": 95.0}
ARMS = {
    "none": "no step",
    "next": "next step",
    "advised": "ranked first",
    "worst": "ranked last",
    "refused": "speed and load at once",
}


class Arrangement(NamedTuple):
    """What a bench has run, where it may run, and what is to be forecast.

    - ``light``: what the twin is identified from first.
    - ``region``: where steps may be.
    - ``heavy``: the target.
    """

    bearing: str
    light: tuple[Stage, ...]
    region: LowRiskRegion
    heavy: Stage

    @property
    def light_minutes(self) -> int:
        """Rows of the first identification."""
        return sum(stage.minutes for stage in self.light)


ARRANGEMENTS = {
    "known-speed": Arrangement(
        "6016",
        (Stage(360, 5800.0, 2650.0),),
        LowRiskRegion(speed_rpm_max=5900.0, load_n_max=3400.0),
        Stage(180, 5800.0, 5500.0),
    ),
    "unknown-speed": Arrangement(
        "6311",
        tuple(
            Stage(minutes, n, 2650.0) for minutes, n in ((55, 1500.0), (55, 2400.0), (70, 4200.0))
        ),
        LowRiskRegion(speed_rpm_max=4300.0, load_n_max=3400.0),
        Stage(120, 6200.0, 5500.0),
    ),
    "first-hour": Arrangement(
        "6016",
        (Stage(60, 5800.0, 2650.0),),
        LowRiskRegion(speed_rpm_max=5900.0, load_n_max=3400.0),
        Stage(180, 5800.0, 5500.0),
    ),
    "first-hour-speed": Arrangement(
        "6311",
        (Stage(60, 1500.0, 2650.0),),
        LowRiskRegion(speed_rpm_max=2450.0, load_n_max=3400.0),
        Stage(180, 6200.0, 2650.0),
    ),
}


class Chosen(NamedTuple):
    """A step, and what is cautiously expected after it: half-widths by sensor, and a runaway."""

    levels: tuple[Step, ...]
    half_width_k: Mapping[str, float]
    runaway: float | None


class Task(NamedTuple):
    """One bench in one arrangement."""

    arrangement: str
    seed: int


@dataclass(frozen=True, slots=True)
class Arm:
    """What one choice of step led to on one bench.

    - ``levels``: the step, empty for none.
    - ``predicted_k``: half-width at the end of the target that the advice expected, by sensor; of a
      refused step none.
    - ``obtained_k``: half-width that the twin then had.
    - ``rings``: scores of the forecast.
    - ``warned``: whether it said "runaway not excluded".
    - ``refused_fit``: why the new fit must not forecast; empty if it may.
    - ``runaway_predicted``, ``runaway_obtained``: probability of a runaway at the target that the
      advice expected, and that the twin then had; of a refused step none was expected.
    """

    levels: tuple[Step, ...]
    predicted_k: Mapping[str, float]
    obtained_k: Mapping[str, float]
    rings: Mapping[str, Score]
    warned: bool
    refused_fit: str
    runaway_predicted: float | None = None
    runaway_obtained: float | None = None


@dataclass(frozen=True, slots=True)
class BenchResult:
    """One bench: the arms there were, and whether it truly ran away at the target or before."""

    task: Task
    arms: Mapping[str, Arm]
    ran_away: bool

    @property
    def advisable(self) -> bool:
        """Whether there was a step to advise."""
        return "advised" in self.arms


def examine(task: Task) -> BenchResult:
    """Ask for advice on one bench and run all arms."""
    arrangement = ARRANGEMENTS[task.arrangement]
    bench = BenchParameters.random(task.seed, arrangement.bearing)
    arms = {}
    ran_away = False
    for name, (levels, predicted, runaway) in chosen(asked(arrangement, bench, task.seed)).items():
        stages = tuple(
            Stage(round(level.duration_s / 60), level.speed_rpm, level.load_n) for level in levels
        )
        done = run_bench(bench, (*arrangement.light, *stages, arrangement.heavy), task.seed)
        end = done.minutes.size
        first = end - arrangement.heavy.minutes
        twin = identify_twin(done, first)
        made = forecast_from(twin, done, first - 1, done.measured(first - 1, end))
        arms[name] = Arm(
            levels,
            predicted,
            {ring: float(0.5 * np.ptp(made.quantile(ring)[[0, 4], -1])) for ring in RINGS},
            score_rings(made, done, first - 1, first, end),
            RUNAWAY in made.labels,
            "" if twin.may_forecast else twin.result.reason,
            runaway,
            made.runaway_probability,
        )
        ran_away = ran_away or done.ran_away(0, end)
    return BenchResult(task, arms, ran_away)


def asked(arrangement: Arrangement, bench: BenchParameters, seed: int) -> Advice:
    """Identify from what has been run, and ask how to learn the target."""
    done = run_bench(bench, arrangement.light, seed)
    twin = identify_twin(done, arrangement.light_minutes)
    observer = follow(twin, done, arrangement.light_minutes - 1)
    state = observer.state(float(done.minutes.ambient_c[-1]))
    heavy = arrangement.heavy
    return advise(
        twin.model,
        twin.posterior,
        state,
        Step(heavy.speed_rpm, heavy.load_n, 60.0 * heavy.minutes),
        arrangement.region,
        WARNING_C,
        alarm_limits=ALARM_C,
    )


def chosen(advice: Advice) -> dict[str, Chosen]:
    """The step of every arm, and what the advice expects after it.

    Without a feasible step there is only the arm without any; where all speeds are known, nothing
    changes speed and load at once.
    """
    present = None if advice.margin is None else advice.margin.probability
    now_k = {name: found.half_width_k for name, found in advice.now.items()}
    arms = {"none": Chosen((), now_k, present)}
    if not advice.steps:
        return arms
    steps = {"next": advice.next_step, "advised": advice.steps[0], "worst": advice.steps[-1]}
    for name, step in steps.items():
        if step is not None:
            arms[name] = Chosen(step.levels, step.cautious_half_width_k, step.runaway_probability)
    both = [step.levels for step in advice.excluded if "at once" in step.reason]
    if both:
        # The one that looks most tempting: a single level, heavy, held long.
        tempting = max(both, key=lambda step: (-len(step), step[0].load_n, step[0].duration_s))
        arms["refused"] = Chosen(tempting, {}, None)
    return arms


def figures_of(found: Sequence[BenchResult]) -> Document:
    """Figures of every arm in every arrangement, and the benches that stand apart."""
    return {
        "seeds": sorted({one.task.seed for one in found}),
        "arrangements": {
            name: _arrangement(arrangement, [one for one in found if one.task.arrangement == name])
            for name, arrangement in ARRANGEMENTS.items()
        },
    }


def _arrangement(arrangement: Arrangement, benches: Sequence[BenchResult]) -> Document:
    normal = [one for one in benches if one.advisable and not one.ran_away]
    return {
        "bearing": arrangement.bearing,
        "target": {"speed_rpm": arrangement.heavy.speed_rpm, "load_n": arrangement.heavy.load_n},
        "arms": {
            arm: _figures([one.arms[arm] for one in normal if arm in one.arms]) for arm in ARMS
        },
        "no_feasible_step": [one.task.seed for one in benches if not one.advisable],
        "ran_away": {
            one.task.seed: {
                arm: {"warned": run.warned, "probability": run.runaway_obtained}
                for arm, run in one.arms.items()
            }
            for one in benches
            if one.ran_away
        },
        "steps": {
            one.task.seed: {
                arm: [[level.speed_rpm, level.load_n, level.duration_s] for level in run.levels]
                for arm, run in one.arms.items()
            }
            for one in benches
        },
    }


def _figures(arms: Sequence[Arm]) -> Document:
    used = [arm for arm in arms if not arm.refused_fit]

    def means(values: Callable[[Arm], Mapping[str, float]]) -> dict[str, float | None]:
        # Of a refused step nothing is predicted.
        found = [by_ring for arm in used if (by_ring := values(arm))]
        return {ring: mean(by_ring[ring] for by_ring in found) for ring in RINGS}

    def means_of(score: str) -> dict[str, float | None]:
        return means(lambda arm: {ring: getattr(arm.rings[ring], score) for ring in RINGS})

    return {
        "benches": len(used),
        "fits_refused": len(arms) - len(used),
        "half_width_predicted_k": means(lambda arm: arm.predicted_k),
        "half_width_obtained_k": means(lambda arm: arm.obtained_k),
        "obtained_over_predicted": _promise(used),
        "steady_error_c": means_of("steady_error_k"),
        "steady_bias_c": means_of("steady_bias_k"),
        "coverage_95": means_of("coverage_95"),
        "worst_coverage_95": {
            ring: min((arm.rings[ring].coverage_95 for arm in used), default=None) for ring in RINGS
        },
        "runaway_not_excluded": sum(arm.warned for arm in used),
        "runaway_predicted": mean(
            arm.runaway_predicted for arm in used if arm.runaway_predicted is not None
        ),
        "runaway_obtained": mean(
            arm.runaway_obtained for arm in used if arm.runaway_obtained is not None
        ),
    }


def _promise(used: Sequence[Arm]) -> Document | None:
    """How the half-width of the inner ring came out against what was expected."""
    ring = RINGS[0]
    ratios = [arm.obtained_k[ring] / arm.predicted_k[ring] for arm in used if arm.predicted_k]
    if not ratios:
        return None
    return {
        "median": float(np.median(ratios)),
        "least": min(ratios),
        "most": max(ratios),
        "kept": sum(ratio <= 1.0 for ratio in ratios),
    }


def tables(found: Sequence[BenchResult], document: Document) -> Iterator[Table]:
    """One per arrangement."""
    for name, arrangement in document["arrangements"].items():
        benches = [one for one in found if one.task.arrangement == name]
        used = sum(one.advisable and not one.ran_away for one in benches)
        target = arrangement["target"]
        yield table(
            f"Excitation advice, {name}: forecasts at {target['speed_rpm']:g} rpm, "
            f"{target['load_n']:g} N (T_ir / T_or)",
            named(arrangement["arms"]),
            (
                ("step before", lambda arm: ARMS[arm["name"]]),
                ("benches", cell("benches")),
                ("half-width predicted, K", cell("half_width_predicted_k", _both)),
                ("obtained, K", cell("half_width_obtained_k", _both)),
                ("T_ir: obtained / predicted", cell("obtained_over_predicted", _ratio)),
                ("not wider", cell("obtained_over_predicted.kept", text, 0)),
                ("steady error, K", cell("steady_error_c", _both, 1.0, 2)),
                ("coverage, %", cell("coverage_95", _both, 100.0, 0)),
                ("worst bench, %", cell("worst_coverage_95", _both, 100.0, 0)),
                ("runaway expected, %", cell("runaway_predicted", share, 1)),
                ("then said, %", cell("runaway_obtained", share, 1)),
            ),
            f"Means over {used} of {len(benches)} random benches; the others ran away at the "
            "target, or were too hot for any step. Obtained over predicted: median, least to most, "
            "and on how many benches it was not wider than predicted. Half-widths are those of the "
            "95 % band at the end of the target. What a refused step would bring is not predicted.",
        )


def _ratio(found: Document | None) -> str:
    if found is None:
        return "-"
    return f"{found['median']:.2f} ({found['least']:.2f} to {found['most']:.2f})"


def _both(by_ring: Mapping[str, float | None], factor: float = 1.0, digits: int = 1) -> str:
    values = [by_ring[ring] for ring in RINGS]
    return " / ".join("-" if value is None else f"{factor * value:.{digits}f}" for value in values)


def plots(found: Sequence[BenchResult], document: Document) -> dict[str, Drawing]:
    """Half-widths, predicted over obtained."""
    return {"advice-widths": partial(_draw_widths, found)}


def _draw_widths(found: Sequence[BenchResult]) -> "Figure":
    """Half-widths of the inner ring: predicted over obtained, one point per bench and arm."""
    from matplotlib.ticker import LogLocator

    drawing = figure(10.0, 9.0)
    ring = RINGS[0]
    for axes, (name, arrangement) in zip(
        drawing.subplots(2, 2).flat, ARRANGEMENTS.items(), strict=True
    ):
        ends = []
        for arm, label in ARMS.items():
            points = [
                (one.arms[arm].predicted_k[ring], one.arms[arm].obtained_k[ring])
                for one in found
                if one.task.arrangement == name
                and not one.ran_away
                and arm in one.arms
                and one.arms[arm].predicted_k
            ]
            if points:
                axes.plot(*zip(*points, strict=True), "o", markersize=5, alpha=0.8, label=label)
                ends += [value for point in points for value in point]
        if ends:
            axes.plot([min(ends), max(ends)], [min(ends), max(ends)], color="0.5", linewidth=0.8)
            axes.set(xscale="log", yscale="log")
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 4.0)))
                axis.set_major_formatter("{x:g}")
                axis.set_minor_formatter("")
            axes.legend(fontsize="small")
        axes.set(
            xlabel="half-width expected by the advice, K",
            ylabel="half-width after the step, K",
            title=f"T_ir at {arrangement.heavy.speed_rpm:g} rpm, {arrangement.heavy.load_n:g} N",
        )
        axes.grid(alpha=0.3, which="both")
    return drawing


def cases(options: Options) -> list[Task]:
    """All benches in all arrangements."""
    return [Task(name, seed) for name in ARRANGEMENTS for seed in options.seeds(BENCHES)]


STUDY = Study("advice", cases, examine, figures_of, tables, plots)
