"""Tables and plots of the study ``variable-load``."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from service.lab.studies.bench_runs import RINGS
from service.lab.studies.bench_scores import pair, percent, text
from service.lab.studies.common import Table, figure
from service.lab.studies.drawing import RING_NAMES, draw_agreement, draw_curves

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from service.lab.studies.variable_load import LoadRun

Found = Mapping[str, Mapping[str, Any]]
"""Figures by load law and training."""

# A band that reaches into a runaway would press all else flat.
_HIGHEST_SHOWN_C = 130.0
_TRAINING_NAMES = {"single": "2650 N", "with_stage": "2650, 3300 N"}


def tables(found: Found) -> tuple[Table, ...]:
    """All tables but that of the other methods."""
    return (_errors(found["catalogue"]), _bands(found["catalogue"]), _laws(found), _verdicts(found))


def _conditions(by_training: Mapping[str, Any]) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    for training, figures in by_training.items():
        for load, condition in figures["conditions"].items():
            yield training, load, condition


def _errors(by_training: Mapping[str, Any]) -> Table:
    rows = [
        (
            _TRAINING_NAMES[training],
            f"{load} N" + (" (fit)" if load == "2650" else ""),
            pair(condition["paper"]["rise_max_c"], 1),
            pair(condition["rise_max_c"]),
            pair(condition["paper"]["steady_error_c"], 1),
            pair((condition["offline_scheme"] or {}).get("steady_error_c")),
            pair(condition["steady_error_c"]),
            pair(condition["worst_steady_error_c"], 1),
            str(condition["benches"]),
        )
        for training, load, condition in _conditions(by_training)
    ]
    refused = sum(len(figures["refused"]) for figures in by_training.values())
    lost = sum(len(figures["ran_away_in_training"]) for figures in by_training.values())
    return Table(
        "Variable load, 6016 at 5800 rpm: errors in K, T_ir/T_or",
        (
            "identified at",
            "load",
            "rise, paper",
            "ours",
            "steady, paper",
            "offline scheme",
            "ours",
            "worst bench",
            "benches",
        ),
        tuple(rows),
        (
            "Rise: largest error before the last half hour of the load; steady: mean absolute "
            "error over that half hour; both against the noise-free temperature, means over the "
            "benches that do not run away. The paper: one bench.",
            f"Fits that failed and would not forecast: {refused}; runs in which the bench ran away "
            f"during the training already: {lost}. They count in no figure.",
        ),
    )


def _bands(by_training: Mapping[str, Any]) -> Table:
    rows = [
        (
            _TRAINING_NAMES[training],
            f"{load} N" + (" (fit)" if load == "2650" else ""),
            percent(condition["coverage_95_by_sensor"]),
            percent(condition["worst_coverage_95"]),
            f"{text(condition['rise_coverage_95'])}/{text(condition['steady_coverage_95'])}",
            pair(condition["half_width_c"], 1),
            pair((condition["offline_scheme"] or {}).get("half_width_c"), 1),
            pair(condition["r_squared"]),
        )
        for training, load, condition in _conditions(by_training)
    ]
    return Table(
        "Variable load: 95 % bands, T_ir/T_or",
        (
            "identified at",
            "load",
            "covers, %",
            "worst bench, %",
            "rise/steady",
            "half-width, K",
            "offline",
            "R2",
        ),
        tuple(rows),
        (
            "Coverage of the measured data. The paper: R2 0.995 for the outer ring at 4000 N, 0.95 "
            "to 0.98 for the other three curves, whose points leave its 95 % intervals at times.",
        ),
    )


def _laws(found: Found) -> Table:
    rows = [
        (
            law,
            _TRAINING_NAMES[training],
            f"{load} N",
            pair(condition["steady_bias_c"], 1),
            pair(condition["worst_steady_error_c"], 1),
            percent(condition["coverage_95_by_sensor"]),
            percent(condition["worst_coverage_95"]),
            pair(condition["half_width_c"], 1),
            f"{condition['benches']} + {len(condition['ran_away'])}",
        )
        for law, by_training in found.items()
        for training, load, condition in _conditions(by_training)
        if load != "2650"
    ]
    return Table(
        "Variable load: benches with other load laws, T_ir/T_or",
        (
            "law",
            "identified at",
            "load",
            "bias, K",
            "worst bench, K",
            "covers, %",
            "worst, %",
            "half-width, K",
            "benches + runaway",
        ),
        tuple(rows),
        (
            "Exponent of the rolling friction and factor on the sliding friction: catalogue 0.54 "
            "and 1, flat 0.05 and 0.6, steep 0.90 and 1.5; the rolling friction at 2650 N is the "
            "same. From one load the law cannot be known, so the band has to say so.",
        ),
    )


def _verdicts(found: Found) -> Table:
    rows = [
        (
            law,
            _TRAINING_NAMES[training],
            f"{load} N",
            *(str(counts[name]) for name in ("true", "missed", "false", "rightly_silent")),
            f"{counts['no_forecast_and_ran_away']} + {counts['no_forecast_and_calm']}",
            str(counts["load_law_from_prior_labelled"]),
        )
        for law, by_training in found.items()
        for training, figures in by_training.items()
        for load, counts in figures["runaway_verdicts"].items()
    ]
    return Table(
        'Variable load: the verdict "runaway not excluded" before the step',
        (
            "law",
            "identified at",
            "up to",
            "true",
            "missed",
            "false",
            "rightly silent",
            "no forecast",
            "load law labelled",
        ),
        tuple(rows),
        (
            "True: given, and the bench ran away. No forecast: fits that failed, on "
            "benches that ran away + on others. Last column: forecasts that said that their load "
            "law comes from the prior only.",
        ),
    )


def draw_loads(drawn: Sequence["LoadRun"]) -> "Figure":
    """Figure 16 of the paper: fit and forecast, from one load and from two."""
    made = figure(12.0, 4.8)
    for axes, one in zip(made.subplots(1, 2, sharey=True), drawn, strict=True):
        draw_curves(axes, one.fitted, legend=True)
        draw_curves(axes, one.shown, legend=False)
        axes.axvspan(0.0, one.rows[0] / 60.0, color="0.92", zorder=0)
        hottest = max(values.max() for values in one.shown.measured_c.values())
        upper = max(quantiles.max() for quantiles in one.shown.quantiles_c.values())
        axes.set_ylim(15.0, 1.05 * max(hottest, min(upper, _HIGHEST_SHOWN_C)))
        errors = [
            f"{load} N {pair({ring: score.steady_error_k for ring, score in found.rings.items()})}"
            for load, found in one.conditions.items()
        ]
        axes.set_title(
            f"identified at {_TRAINING_NAMES[one.task.training]}; steady errors in K:\n"
            f"{', '.join(errors[1:])}",
            fontsize="medium",
        )
    made.suptitle(
        f"Bench {drawn[0].task.seed}: samples (grey), then 4000 N and 5500 N for 3 h each"
    )
    return made


def draw_agreements(drawn: Sequence["LoadRun"]) -> "Figure":
    """Figure 17 of the paper: real over predicted temperatures under both heavy loads."""
    made = figure(15.0, 7.5)
    for row, one in zip(made.subplots(2, 4), drawn, strict=True):
        axes = iter(row)
        heavy = list(one.conditions.items())[1:]
        for (load, found), start, stop in zip(heavy, one.rows, one.rows[1:], strict=False):
            ahead = slice(start - one.rows[0] + 1, stop - one.rows[0] + 1)
            for ring in RINGS:
                draw_agreement(
                    next(axes),
                    one.shown.measured_c[ring][start:stop],
                    one.shown.quantiles_c[ring][:, ahead],
                    f"{load} N, {RING_NAMES[ring]}: R2 {found.rings[ring].r_squared:.3f}",
                )
        row[0].set_ylabel(f"identified at {_TRAINING_NAMES[one.task.training]}\n\nreal, °C")
    made.suptitle(f"Bench {drawn[0].task.seed}")
    return made
