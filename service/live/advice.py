"""Excitation advice for a running machine, as the REST interface shows it."""

from collections.abc import Mapping, Sequence
from typing import Any

from service.clock import rfc3339
from service.live.estimate import EstimatedState
from service.site.settings import AssetSection
from twin_core.forecasting.advice import Advice, advise
from twin_core.forecasting.design import Level
from twin_core.forecasting.stepping import (
    LARGEST_RATIO,
    RULES,
    SHORTEST_HOLD_S,
    STEADY_K,
    STEADY_WITHIN_S,
)
from twin_core.windows import LowRiskRegion


def give_advice(
    settings: AssetSection, state: EstimatedState, measured: Sequence[str], target: Level
) -> Mapping[str, Any]:
    """Compute the advice; takes some tenths of a second, so not in the event loop.

    Parameters
    ----------
    settings : AssetSection
        Low-risk region and limits.
    state : EstimatedState
        The machine at this moment.
    measured : sequence of str
        Its channels.
    target : Level
        The point to be learned about.

    Raises
    ------
    NothingIdentifiedError
        Before the first identification.
    """
    active = state.active
    sensors = active.model.sensor_names
    limits = {name: pair for name, pair in settings.limits.items() if name in sensors}
    region = settings.low_risk.region
    advice = advise(
        active.model,
        active.posterior,
        state.machine,
        target,
        region,
        {name: pair.warning for name, pair in limits.items()},
        alarm_limits={name: pair.alarm for name, pair in limits.items()},
        measured=measured,
    )
    return advice_json(advice, region) | {
        "made_at": rfc3339(state.time_us),
        "model_version": active.version,
    }


def advice_json(advice: Advice, region: LowRiskRegion) -> dict[str, Any]:
    """Advice as plain JSON types."""
    target = advice.target
    return {
        "target": _level(target)
        | {
            "inside_low_risk": bool(region.contains(target.speed_rpm, target.load_n)),
            "sensor": advice.sensor,
            "sensors": {
                name: {
                    "q025": round(found.q025, 2),
                    "q50": round(found.q50, 2),
                    "q975": round(found.q975, 2),
                    "half_width_k": round(found.half_width_k, 2),
                }
                for name, found in advice.now.items()
            },
            "labels": list(advice.labels),
        },
        "worth_while": advice.worth_while,
        "steps": [
            {
                "rank": rank,
                "levels": [_level(level) for level in step.levels],
                "duration_s": step.duration_s,
                "half_width_k": _rounded(step.half_width_k),
                "cautious_half_width_k": _rounded(step.cautious_half_width_k),
                "narrower_by": round(step.narrower_by, 3),
                "peak_c": _rounded(step.peak_c),
                "why": step.why,
            }
            for rank, step in enumerate(advice.steps, start=1)
        ],
        "excluded": [
            {"levels": [_level(level) for level in step.levels], "reason": step.reason}
            for step in advice.excluded
        ],
        "stop_rule": {
            "rules": list(RULES),
            "largest_ratio": LARGEST_RATIO,
            "hold_at_least_s": SHORTEST_HOLD_S,
            "steady": {"change_k": STEADY_K, "within_s": STEADY_WITHIN_S},
            "levels": [
                {
                    "speed_rpm": round(step.speed_rpm, 1),
                    "load_n": round(step.load_n, 1),
                    "expected_c": _rounded(step.expected_c),
                    "stop_above_c": _rounded(step.stop_above_c),
                    "runaway_not_excluded": step.runaway_not_excluded,
                    "allowed": step.allowed,
                    "reason": step.reason,
                }
                for step in advice.stepping
            ],
        },
    }


def _level(level: Level) -> dict[str, Any]:
    return {
        "speed_rpm": level.speed_rpm,
        "load_n": level.load_n,
        "duration_s": level.duration_s,
    }


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    return {name: round(value, 2) for name, value in values.items()}
