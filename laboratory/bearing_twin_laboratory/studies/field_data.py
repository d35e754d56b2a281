"""Study ``field-data``: bearings of wind turbines forecast at high power; see `field_data_runs`."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bearing_twin_laboratory.studies.field_data_ledger import LeadScores
from bearing_twin_laboratory.studies.field_data_runs import (
    CASES,
    HIGH_KW,
    LOW_KW,
    NESTED_LOW_KW,
    RECENT_S,
    RECENT_SPANS,
    VARIANTS,
    BearingCase,
    Outcome,
    cases,
    examine,
)
from bearing_twin_laboratory.studies.study import (
    Document,
    Drawing,
    Study,
    Table,
    cell,
    figure,
    share,
    table,
    text,
)
from twin_core.identification.gates import GateCheck
from twin_core.naive import NAIVE_KINDS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Errors this near to each other are a matter of luck; what decides then is the order of VARIANTS.
_TIE_FACTOR, _TIE_K = 1.1, 0.1

NOTES = (
    f"Identified below {LOW_KW:g} kW, forecast from there for up to 24 h that reach "
    f"{HIGH_KW:g} kW. Each forecast rests on the last {RECENT_SPANS} low spans of the "
    f"{RECENT_S / 86400.0:g} days before it. All methods learn from the same rows, know the same "
    "speed, torque and ambient ahead, and the temperature at the start.",
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


def figures_of(outcomes: Sequence[Outcome]) -> Document:
    """Figures of every bearing, by turbine."""
    by_turbine: Document = {}
    for verdict in judge(outcomes):
        found = by_turbine.setdefault(verdict.turbine, {})
        found[verdict.case.name] = _document(verdict)
    better = [by["better"] for bearings in by_turbine.values() for by in bearings.values()]
    return {
        "turbines": by_turbine,
        "notes": list(NOTES),
        "better_than_every_naive": f"{sum(better)} of {len(better)}",
    }


def _document(verdict: Verdict) -> Document:
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
        "ledger": None if chosen is None else _ledger(chosen.ledger),
        "train_rms_k": None if chosen is None else chosen.train_rms_k,
        "parameters": None if chosen is None else chosen.parameters,
        "forecasts": verdict.outcomes[0].high.count,
        "spans": verdict.outcomes[0].spans,
        "forecasts_without_recent_spans": verdict.outcomes[0].without_recent,
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


def _ledger(found: Mapping[int, LeadScores]) -> Document:
    return {
        str(lead): {**asdict(scores.twin), "naive_mae_k": dict(scores.naive_mae_k)}
        for lead, scores in found.items()
    }


def tables(outcomes: Sequence[Outcome], document: Document) -> Iterator[Table]:
    """Forecasts, then the gate."""

    def naive(kind: str) -> Callable[[Document], str]:
        return lambda row: text(row["naive_rmse_k"][kind])

    def simple(kind: str) -> Callable[[Document], str]:
        return lambda row: text(row["naive_mae_k"][kind])

    yield table(
        "Forecasts of the high part: rms error in K",
        [
            {"turbine": turbine, "bearing": bearing, **found}
            for turbine, bearings in document["turbines"].items()
            for bearing, found in bearings.items()
        ],
        (
            ("turbine", cell("turbine")),
            ("bearing", cell("bearing")),
            ("forecasts", cell("forecasts")),
            ("twin", lambda r: "refused" if r["variant"] is None else text(r["twin_rmse_k"])),
            *((kind.replace("_", " "), naive(kind)) for kind in NAIVE_KINDS),
            ("reference", cell("reference_rmse_k", text, 1)),
            ("verdict", lambda r: "better" if r["better"] else f"loses to {r['best_naive']}"),
            (
                "in the 95 % band",
                cell("coverage_95", lambda v: "–" if v is None else f"{share(v)} %"),
            ),
            ("half-width, K", cell("half_width_k", text, 1)),
        ),
        *NOTES,
    )
    yield table(
        "Hourly forecasts at the ledger's lead times, K",
        [
            {"turbine": turbine, "bearing": bearing, "lead_min": int(lead) / 60.0, **scores}
            for turbine, bearings in document["turbines"].items()
            for bearing, found in bearings.items()
            for lead, scores in (found["ledger"] or {}).items()
        ],
        (
            ("turbine", cell("turbine")),
            ("bearing", cell("bearing")),
            ("lead time, min", cell("lead_min", text, 0)),
            ("readings", cell("n")),
            ("bias", cell("bias_k", text)),
            ("mean abs. error", cell("mae_k", text)),
            *((kind.replace("_", " "), simple(kind)) for kind in NAIVE_KINDS),
            ("CRPS", cell("crps_k", text)),
            ("interval score", cell("interval_score_k", text)),
            ("in the 50 % band, %", cell("coverage_50", share)),
            ("in the 95 % band, %", cell("coverage_95", share)),
        ),
        "Scored by the code that scores the live forecasts of a running service. The observer has "
        "followed the machine up to each forecast.",
    )
    yield table(
        "The gate: nested extrapolation within the low part",
        [
            (verdict, outcome, checks)
            for verdict in judge(outcomes)
            for outcome, checks in zip(verdict.outcomes, verdict.checks, strict=True)
        ],
        (
            ("turbine", lambda row: row[0].turbine),
            ("bearing", lambda row: row[0].case.name),
            ("variant", lambda row: row[1].order.variant),
            ("fit, K", lambda row: text(row[1].train_rms_k)),
            ("nested, K", lambda row: text(row[1].nested.rmse_k["twin"])),
            (
                "best naive there, K",
                lambda row: text(min(row[1].nested.rmse_k[kind] for kind in NAIVE_KINDS)),
            ),
            ("gate", lambda row: _gate(*row)),
            ("high part, K", lambda row: text(row[1].high.rmse_k["twin"])),
        ),
    )


def _gate(verdict: Verdict, outcome: Outcome, checks: Sequence[GateCheck]) -> str:
    failed = [check.detail for check in checks if not check.passed]
    if failed:
        return "refused: " + "; ".join(failed)
    return "chosen" if outcome is verdict.chosen else "passes"


def plots(outcomes: Sequence[Outcome], document: Document) -> dict[str, Drawing]:
    """The forecast that rose most, of every bearing."""
    return {"field-data": partial(_draw, judge(outcomes))}


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


STUDY = Study("field-data", cases, examine, figures_of, tables, plots)
