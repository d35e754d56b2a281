"""Pushed samples, each judged for itself."""

import json
import math
from collections.abc import Callable, Coroutine, Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Annotated, Any

from fastapi.routing import APIRoute
from pydantic import ConfigDict, Field, WithJsonSchema
from pydantic_core import from_json
from starlette.requests import Request
from starlette.responses import Response

from adapters.samples import Quality, Sample, is_bad
from service.clock import MICROSECONDS, rfc3339
from service.documents.measurements import Rejected
from service.domain.requests import PUSH_SOURCE, RequestBody
from service.domain.times import parse_time
from service.web.api.turns import caller_of, turns_of

SAMPLES_MAX = 20_000
#: This many rejected samples of a push are answered with their reason, the others with a word.
REASONS_MAX = 100
_ONE_OF_MANY = f"also rejected; only the first {REASONS_MAX} give a reason"
_SHOWN_CHARACTERS = 60
#: This many samples are judged in less time than a thread takes to begin.
_FEW = 200
_BYTES_OF_A_SAMPLE = 80
_AHEAD_S = 300.0

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
_ANYTHING_ELSE = {"description": "Anything else is rejected on its own."}


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
    """The samples that can be taken, in the order of their times, and what is wrong with others.

    Attributes
    ----------
    samples : list of Sample
        Good to be stored.
    rejected : list of Rejected
        Index of each of the others, and why; after the first `REASONS_MAX` a word must do.
    too_old : list of Sample
        Those of the others that are only wrong by their time.
    wired : dict of str to int
        Channels that take no pushes, each with the index of its first sample.
    """

    samples: list[Sample] = field(default_factory=list)
    rejected: list[Rejected] = field(default_factory=list)
    too_old: list[Sample] = field(default_factory=list)
    wired: dict[str, int] = field(default_factory=dict)


def judge(
    samples: Sequence[Any],
    asset: str,
    channels: Mapping[str, str],
    now_us: int,
    rate: float,
    kept_from_us: int,
) -> Verdict:
    """Tell the samples that can be taken from those that cannot.

    Parameters
    ----------
    samples : sequence
        As they came in.
    asset : str
        Whose samples.
    channels : mapping of str to str
        Its channels with their sources.
    now_us : int
        Process time; a sample too far ahead of it would hide what comes after.
    rate : float
        Process seconds per wall second.
    kept_from_us : int
        The store takes no samples from before this time, UTC microseconds.
    """
    verdict = Verdict()
    latest_us = now_us + round(_AHEAD_S * max(rate, 1.0) * MICROSECONDS)
    for index, raw in enumerate(samples):
        try:
            sample = _sample(raw, asset, channels, now_us, latest_us)
            if sample.time_us < kept_from_us:
                verdict.too_old.append(sample)
                raise ValueError(
                    f"time {raw['time']!r}: too old, history before {rfc3339(kept_from_us)} has "
                    "been removed"
                )
        except ValueError as error:
            few = len(verdict.rejected) < REASONS_MAX
            detail = str(error) if few else _ONE_OF_MANY
            verdict.rejected.append(Rejected(index=index, detail=detail))
        else:
            verdict.samples.append(sample)
            continue
        channel = raw.get("channel") if isinstance(raw, dict) else None
        if isinstance(channel, str) and channels.get(channel, PUSH_SOURCE) != PUSH_SOURCE:
            verdict.wired.setdefault(channel, index)
    verdict.samples.sort(key=attrgetter("time_us"))
    return verdict


def _sample(
    raw: Any, asset: str, channels: Mapping[str, str], now_us: int, latest_us: int
) -> Sample:
    if not isinstance(raw, dict):
        raise ValueError('expected {"channel", "time", "value", "quality"?}')
    channel = raw.get("channel")
    if not isinstance(channel, str) or channels.get(channel) != PUSH_SOURCE:
        pushed = [name for name, source in channels.items() if source == PUSH_SOURCE]
        known = ", ".join(pushed) or "none"
        raise ValueError(f"channel {_shown(channel)}: unknown; pushed channels are: {known}")
    try:
        time_us = parse_time(raw.get("time"))
    except ValueError as error:
        raise ValueError(f"time {_shown(raw.get('time'))}: {error}") from error
    if time_us > latest_us:
        raise ValueError(f"time {_shown(raw.get('time'))}: lies in the future")
    value, quality = _value(raw.get("value")), raw.get("quality")
    if quality is None:
        quality = Quality.BAD if value is None else Quality.GOOD
    if isinstance(quality, bool) or not isinstance(quality, int) or not 0 <= quality <= 255:
        raise ValueError(f"quality {_shown(quality)}: expected an OPC DA byte from 0 to 255")
    if value is None and not is_bad(quality):
        raise ValueError(f"value null: expected a number with quality {quality}")
    kept = math.nan if value is None or is_bad(quality) else value
    return Sample(asset, channel, time_us, kept, int(quality), now_us)


def _value(raw: Any) -> float | None:
    if raw is None:
        return None
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise ValueError(f"value {_shown(raw)}: expected a number or null")
    try:
        value = float(raw)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise ValueError("value: expected a finite number or null")
    return value


def _shown(value: object) -> str:
    """A wrong value, not at any length."""
    text = repr(value[:_SHOWN_CHARACTERS] if isinstance(value, str) else value)
    return text if len(text) <= 2 * _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]}…"


class PushRoute(APIRoute):
    """A route whose body may be long: it is read, parsed and judged in turns, off the event loop.

    The route gives the turn back with `give_turn_back` before it waits for the disk.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Give what FastAPI calls for a request."""
        answer = super().get_route_handler()

        async def in_turn(request: Request) -> Response:
            turns, caller = turns_of(request), caller_of(request)
            push = _Push(request.scope, request.receive)
            async with turns.pushes.turn(caller):
                await push.body()
                async with AsyncExitStack() as stack:
                    await stack.enter_async_context(turns.judging.turn(caller))
                    push.state.judging = stack
                    return await answer(push)

        return in_turn


async def give_turn_back(request: Request) -> None:
    """End the turn of a push: what remains is to wait."""
    stack: AsyncExitStack = request.state.judging
    await stack.aclose()


async def in_thread(request: Request, size: int, work: Callable[..., Any], *arguments: Any) -> Any:
    """Work on this many samples or bytes: a few at once here, many in a thread."""
    if size < _FEW:
        return work(*arguments)
    return await turns_of(request).judge(work, *arguments)


class _Push(Request):
    """A request whose long body is parsed in a thread."""

    async def json(self) -> Any:
        """Give what the body holds."""
        if not hasattr(self, "_json"):
            body = await self.body()
            self._json = await in_thread(self, len(body) // _BYTES_OF_A_SAMPLE, _parse, body)
        return self._json


def _parse(body: bytes) -> Any:
    try:
        return from_json(body)
    except ValueError:
        return json.loads(body)  # which says where it fails, and knows other encodings
