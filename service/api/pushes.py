"""Pushed samples, each judged for itself."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import ConfigDict, Field, WithJsonSchema

from adapters.samples import Quality, Sample, is_bad
from service.api.context import PUSH_SOURCE, AssetTwin, RequestBody
from service.api.times import parse_time
from service.clock import rfc3339

SAMPLES_MAX = 20_000
_AHEAD_S = 300.0
_MICROSECONDS = 1_000_000

_SAMPLE_SCHEMA = {
    "type": "object",
    "title": "PushedSample",
    "required": ["channel", "time", "value"],
    "properties": {
        "channel": {"type": "string", "examples": ["t_inner_ring_c"]},
        "time": {
            "type": "string",
            "format": "date-time",
            "description": "RFC 3339 with an offset.",
        },
        "value": {
            "type": ["number", "null"],
            "description": "In the channel's unit; null with a bad quality.",
        },
        "quality": {
            "type": "integer",
            "minimum": 0,
            "maximum": 255,
            "description": "OPC DA byte; absent: 192 (good) with a value, 0 (bad) without.",
        },
    },
}
_ANYTHING_ELSE = {"description": "Anything else is rejected, for itself."}


class PushRequest(RequestBody):
    """Samples of pushed channels of one asset, in any order."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "samples": [
                        {
                            "channel": "t_inner_ring_c",
                            "time": "2026-11-21T08:00:00Z",
                            "value": 63.4,
                            "quality": 192,
                        }
                    ]
                }
            ]
        },
    )

    samples: Annotated[
        list[Any],
        Field(max_length=SAMPLES_MAX),
        WithJsonSchema(
            {
                "type": "array",
                "maxItems": SAMPLES_MAX,
                "items": {"anyOf": [_SAMPLE_SCHEMA, _ANYTHING_ELSE]},
            }
        ),
    ]


@dataclass(slots=True)
class Verdict:
    """The samples that can be taken, and for each of the others its index and what is wrong.

    `too_old` holds those of the others that are only wrong by their time.
    """

    samples: list[Sample] = field(default_factory=list)
    rejected: list[dict[str, Any]] = field(default_factory=list)
    too_old: list[Sample] = field(default_factory=list)


def judge(
    samples: Sequence[Any], asset: AssetTwin, now_us: int, rate: float, kept_from_us: int
) -> Verdict:
    """Tell the samples that can be taken from those that cannot.

    Parameters
    ----------
    samples : sequence
        As they came in.
    asset : AssetTwin
        Knows the channels.
    now_us : int
        Process time; a sample too far ahead of it would hide what comes after.
    rate : float
        Process seconds per wall second.
    kept_from_us : int
        The store takes no samples from before this time, UTC microseconds.
    """
    verdict = Verdict()
    latest_us = now_us + round(_AHEAD_S * max(rate, 1.0) * _MICROSECONDS)
    for index, raw in enumerate(samples):
        try:
            sample = _sample(raw, asset, now_us, latest_us)
            if sample.time_us < kept_from_us:
                verdict.too_old.append(sample)
                raise ValueError(
                    f"time {raw['time']!r}: too old, history before {rfc3339(kept_from_us)} has "
                    "been removed"
                )
            verdict.samples.append(sample)
        except ValueError as error:
            verdict.rejected.append({"index": index, "detail": str(error)})
    return verdict


def _sample(raw: Any, asset: AssetTwin, now_us: int, latest_us: int) -> Sample:
    if not isinstance(raw, dict):
        raise ValueError('expected {"channel", "time", "value", "quality"?}')
    channel = raw.get("channel")
    if not isinstance(channel, str) or channel not in asset.channels:
        pushed = [name for name, source in asset.channels.items() if source == PUSH_SOURCE]
        known = ", ".join(pushed) or "none"
        raise ValueError(f"channel {channel!r}: unknown; pushed channels are: {known}")
    try:
        time_us = parse_time(raw.get("time"))
    except ValueError as error:
        raise ValueError(f"time {raw.get('time')!r}: {error}") from error
    if time_us > latest_us:
        raise ValueError(f"time {raw.get('time')!r}: lies in the future")
    value, quality = _value(raw.get("value")), raw.get("quality")
    if quality is None:
        quality = Quality.BAD if value is None else Quality.GOOD
    if isinstance(quality, bool) or not isinstance(quality, int) or not 0 <= quality <= 255:
        raise ValueError(f"quality {quality!r}: expected an OPC DA byte from 0 to 255")
    if value is None and not is_bad(quality):
        raise ValueError(f"value null: expected a number with quality {quality}")
    kept = math.nan if value is None or is_bad(quality) else value
    return Sample(asset.id, channel, time_us, kept, int(quality), now_us)


def _value(raw: Any) -> float | None:
    if raw is None:
        return None
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise ValueError(f"value {raw!r}: expected a number or null")
    try:
        value = float(raw)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise ValueError("value: expected a finite number or null")
    return value
