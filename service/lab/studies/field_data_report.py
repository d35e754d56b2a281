"""Tables, figures and plots of the study ``field-data``."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from service.lab.studies.common import Plot, Report, Table, figure
from service.lab.studies.field_data import (
    CASES,
    HIGH_KW,
    LOW_KW,
    NAME,
    NESTED_LOW_KW,
    VARIANTS,
    BearingCase,
    Outcome,
)
from twin_core.identification.gates import GateCheck
from twin_core.naive import NAIVE_KINDS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Errors this near to each other are a matter of luck; what decides then is the order of VARIANTS.
_TIE_FACTOR, _TIE_K = 1.1, 0.1

NOTES = (
    f"Identified below {LOW_KW:g} kW, forecast from there for up to 24 h that reach "
    f"{HIGH_KW:g} kW. All methods learn from the same rows, know the same speed, torque and "
    "ambient ahead, and the temperature at the start.",
    f"The variant was chosen by the nested test alone: identified below {NESTED_LOW_KW:g} kW, "
    f"forecast up to {LOW_KW:g} kW. The errors of refused variants at high power are printed to "
    "show what the gate has kept out.",
    "What was learned from the turbines R80711 and R80721 and may flatter the figures there: "
    "which temperatures are the ambient, that the heat is linear in speed and torque, the priors' "
    "orders of magnitude, the size of the errors. Nothing is set per turbine.",
    "The reference is the best static or lumped model on another turbine of the farm, over other "
    "spans.",
)


@dataclass(frozen=True, slots=True)
class Verdict:
    """All variants of one bearing, judged."""

    turbine: str
    case: BearingCase
    outcomes: tuple[Outcome, ...]
    checks: tuple[tuple[GateCheck, ...], ...]

    @property
    def chosen(self) -> Outcome | None:
        """The first variant that passes every check; None where none may forecast."""
        for outcome, checks in zip(self.outcomes, self.checks, strict=True):
            if all(check.passed for check in checks):
                return outcome
        return None


def judge(outcomes: Sequence[Outcome]) -> list[Verdict]:
    """Judge the variants of every bearing, from what they do within the low part alone."""
    verdicts = []
    for turbine in dict.fromkeys(outcome.order.turbine for outcome in outcomes):
        for case in CASES:
            own = sorted(
                (o for o in outcomes if (o.order.turbine, o.order.case) == (turbine, case)),
                key=lambda outcome: VARIANTS.index(outcome.order.variant),
            )
            if not own:
                continue
            best_k = min(outcome.nested.rmse_k["twin"] for outcome in own)
            checks = tuple((*outcome.checks, _nested(outcome, best_k)) for outcome in own)
            verdicts.append(Verdict(turbine, case, tuple(own), checks))
    return verdicts


def _nested(outcome: Outcome, best_k: float) -> GateCheck:
    error_k = outcome.nested.rmse_k["twin"]
    return GateCheck(
        "extrapolation",
        error_k <= _TIE_FACTOR * best_k + _TIE_K,
        f"extrapolation: {error_k:.2f} K rms from below {NESTED_LOW_KW:g} kW to "
        f"{LOW_KW:g} kW, the best variant {best_k:.2f} K",
        {"nested_rms_k": error_k, "best_rms_k": best_k},
    )


def report(outcomes: Sequence[Outcome]) -> Report:
    """Put the report together."""
    verdicts = judge(outcomes)
    document: dict[str, Any] = {"turbines": {}, "notes": list(NOTES)}
    for verdict in verdicts:
        by_bearing = document["turbines"].setdefault(verdict.turbine, {})
        by_bearing[verdict.case.name] = _document(verdict)
    judged = [
        by["better"] for bearings in document["turbines"].values() for by in bearings.values()
    ]
    document["better_than_every_naive"] = f"{sum(judged)} of {len(judged)}"
    return Report(
        NAME,
        document,
        (_forecast_table(verdicts), _gate_table(verdicts)),
        (Plot(NAME, lambda: _draw(verdicts)),),
    )


def _document(verdict: Verdict) -> dict[str, Any]:
    chosen = verdict.chosen
    naive = dict(verdict.outcomes[0].high.rmse_k)
    del naive["twin"]
    best = min(naive, key=lambda kind: naive[kind])
    twin_k = None if chosen is None else chosen.high.rmse_k["twin"]
    return {
        "variant": None if chosen is None else chosen.order.variant,
        "twin_rmse_k": twin_k,
        "naive_rmse_k": naive,
        "best_naive": best,
        "better": twin_k is not None and twin_k < naive[best],
        "reference_rmse_k": verdict.case.reference_k,
        "coverage_95": None if chosen is None else chosen.high.coverage,
        "half_width_k": None if chosen is None else chosen.high.half_width_k,
        "train_rms_k": None if chosen is None else chosen.train_rms_k,
        "parameters": None if chosen is None else chosen.parameters,
        "forecasts": verdict.outcomes[0].high.count,
        "spans": verdict.outcomes[0].spans,
        "variants": {
            outcome.order.variant: {
                "accepted": all(check.passed for check in checks),
                "reason": "; ".join(check.detail for check in checks if not check.passed),
                "checks": [check.to_dict() for check in checks],
                "nested_rmse_k": dict(outcome.nested.rmse_k),
                "nested_forecasts": outcome.nested.count,
                "high_rmse_k": outcome.high.rmse_k["twin"],
            }
            for outcome, checks in zip(verdict.outcomes, verdict.checks, strict=True)
        },
    }


def _forecast_table(verdicts: Sequence[Verdict]) -> Table:
    rows = []
    for verdict in verdicts:
        found = _document(verdict)
        twin_k, coverage = found["twin_rmse_k"], found["coverage_95"]
        rows.append(
            (
                verdict.turbine,
                verdict.case.name,
                str(found["forecasts"]),
                "refused" if twin_k is None else f"{twin_k:.2f}",
                *(f"{found['naive_rmse_k'][kind]:.2f}" for kind in NAIVE_KINDS),
                f"{verdict.case.reference_k:.1f}",
                "better" if found["better"] else f"loses to {found['best_naive']}",
                "–" if coverage is None else f"{100.0 * coverage:.0f} %",
                "–" if coverage is None else f"{found['half_width_k']:.1f}",
            )
        )
    return Table(
        "Forecasts of the high part: rms error in K",
        (
            "turbine",
            "bearing",
            "forecasts",
            "twin",
            *(kind.replace("_", " ") for kind in NAIVE_KINDS),
            "reference",
            "verdict",
            "in the 95 % band",
            "half-width, K",
        ),
        tuple(rows),
        NOTES,
    )


def _gate_table(verdicts: Sequence[Verdict]) -> Table:
    rows = []
    for verdict in verdicts:
        for outcome, checks in zip(verdict.outcomes, verdict.checks, strict=True):
            failed = [check.detail for check in checks if not check.passed]
            naive_k = min(outcome.nested.rmse_k[kind] for kind in NAIVE_KINDS)
            rows.append(
                (
                    verdict.turbine,
                    verdict.case.name,
                    outcome.order.variant,
                    f"{outcome.train_rms_k:.2f}",
                    f"{outcome.nested.rmse_k['twin']:.2f}",
                    f"{naive_k:.2f}",
                    "refused: " + "; ".join(failed)
                    if failed
                    else "chosen"
                    if outcome is verdict.chosen
                    else "passes",
                    f"{outcome.high.rmse_k['twin']:.2f}",
                )
            )
    return Table(
        "The gate: nested extrapolation within the low part",
        (
            "turbine",
            "bearing",
            "variant",
            "fit, K",
            "nested, K",
            "best naive there, K",
            "gate",
            "high part, K",
        ),
        tuple(rows),
    )


def _draw(verdicts: Sequence[Verdict]) -> "Figure":
    """The forecast that rose most, of every bearing."""
    shown = figure(10.0, 3.2 * len(verdicts))
    axes = np.atleast_1d(shown.subplots(len(verdicts), 1))
    for axis, verdict in zip(axes, verdicts, strict=True):
        outcome = verdict.chosen or verdict.outcomes[0]
        hours, measured, (low, median, high) = outcome.high.curves
        axis.fill_between(hours, low, high, color="tab:blue", alpha=0.2, label="twin, 95 %")
        axis.plot(hours, median, color="tab:blue", label="twin")
        axis.plot(hours, measured, color="black", linewidth=1.0, label="measured")
        refused = "" if verdict.chosen else " (refused)"
        axis.set_title(
            f"{verdict.turbine}, {verdict.case.name}: {outcome.order.variant}{refused}", fontsize=10
        )
        axis.set_ylabel("°C")
        axis.set_xlabel("h from the end of the low span")
        axis.legend(fontsize=8, loc="best")
    return shown
