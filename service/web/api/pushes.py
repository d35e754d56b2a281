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
from adapters.times import EARLIEST_US, POSSIBLE, latest_us, source_limit_us
from adapters.words import shown
from service.clock import MICROSECONDS, rfc3339
from service.documents.measurements import Rejected
from service.domain.errors import PushRefusedError
from service.domain.requests import PUSH_SOURCE, RequestBody
from service.domain.times import parse_time
from service.web.api.problems import Problem
from service.web.api.turns import caller_of, turns_of

SAMPLES_MAX = 20_000
#: Wall seconds that a push may wait for its turn in the cell.
PUSH_PATIENCE_S = 10.0
#: This many rejected samples of a push are answered with their reason, the others with a word.
REASONS_MAX = 100
_ONE_OF_MANY = f"also rejected; only the first {REASONS_MAX} give a reason"
#: This many samples are judged in less time than a thread takes to begin.
_FEW = 200
_BYTES_OF_A_SAMPLE = 80


def sample_schema(names: Mapping[str, Any], title: str) -> dict[str, Any]:
    """Describe a pushed sample for OpenAPI; ``names`` are properties before the usual ones."""
    properties = {
        **names,
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
    }
    sample = {
        "type": "object",
        "title": title,
        "required": [*names, "channel", "time", "value"],
        "properties": properties,
    }
    return {"anyOf": [sample, {"description": "Anything else is rejected on its own."}]}


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
                "items": sample_schema({}, "PushedSample"),
            }
        ),
    ]


@dataclass(slots=True)
class Verdict:
    """The samples that can be taken, in the order of their times, and what is wrong with others.

    - ``samples``: good to be stored.
    - ``rejected``: index of each of the others, and why; after the first `REASONS_MAX` a word must
      do.
    - ``too_old``: those of the others that are only wrong by their time.
    - ``wired``: channels that take no pushes, each with the index of its first sample.
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
    kept_from_us: int,
) -> Verdict:
    """Sort samples into those that can be taken and those that cannot.

    - ``now_us``: process time; no sample can be of more than a day later.
    - ``kept_from_us``: the store takes no samples from before this time, UTC microseconds.
    """
    verdict = Verdict()
    judge = Judge(now_us, kept_from_us)
    for index, raw in enumerate(samples):
        try:
            sample = judge.sample(raw, asset, channels)
        except ValueError as error:
            if isinstance(error, TooOldError):
                verdict.too_old.append(error.sample)
            reject(verdict.rejected, index, error)
        else:
            verdict.samples.append(sample)
            continue
        channel = raw.get("channel") if isinstance(raw, dict) else None
        if isinstance(channel, str) and channels.get(channel, PUSH_SOURCE) != PUSH_SOURCE:
            verdict.wired.setdefault(channel, index)
    verdict.samples.sort(key=attrgetter("time_us"))
    return verdict


def reject(rejected: list[Rejected], index: int, error: ValueError) -> None:
    """Note why a sample is not taken; after the first `REASONS_MAX` without the reason."""
    detail = str(error) if len(rejected) < REASONS_MAX else _ONE_OF_MANY
    rejected.append(Rejected(index=index, detail=detail))


def clock_ahead_s(newest_us: int | None, now_us: int, rate: float) -> float | None:
    """Process seconds by which the newest sample is too far ahead; None where it is not."""
    if newest_us is None or newest_us <= source_limit_us(now_us, rate):
        return None
    return round((newest_us - now_us) / MICROSECONDS, 1)


class TooOldError(ValueError):
    """The store takes no sample of this time any more."""

    def __init__(self, sample: Sample, time: str, kept_from_us: int) -> None:
        if sample.time_us < EARLIEST_US:
            super().__init__(f"time {time}: expected {POSSIBLE}")
        else:
            kept_from = rfc3339(kept_from_us)
            super().__init__(f"time {time}: too old, history before {kept_from} has been removed")
        self.sample = sample


class Judge:
    """Makes samples of what was pushed in one call, or says what is wrong with it.

    - ``now_us``: process time; no sample can be of more than a day later.
    - ``kept_from_us``: the store takes no samples from before this time, UTC microseconds.
    """

    def __init__(self, now_us: int, kept_from_us: int) -> None:
        self.now_us = now_us
        self._latest_us = latest_us(now_us)
        self._kept_from_us = max(kept_from_us, EARLIEST_US)
        # The samples of one moment have one time: it is read once.
        self._times_us: dict[str, int] = {}

    def sample(self, raw: Any, asset: str, channels: Mapping[str, str]) -> Sample:
        """Judge a sample as JSON has it. Raises `ValueError` that says what was expected."""
        if not isinstance(raw, dict):
            raise ValueError('expected {"channel", "time", "value", "quality"?}')
        channel, time = pushed_channel(raw.get("channel"), channels), raw.get("time")
        time_us = self.time_us(time)
        value, quality = finite_number(raw.get("value")), raw.get("quality")
        if quality is None:
            quality = Quality.BAD if value is None else Quality.GOOD
        if isinstance(quality, bool) or not isinstance(quality, int) or not 0 <= quality <= 255:
            raise ValueError(f"quality {shown(quality)}: expected an OPC DA byte from 0 to 255")
        if value is None and not is_bad(quality):
            raise ValueError(f"value null: expected a number with quality {quality}")
        kept = math.nan if value is None or is_bad(quality) else value
        return self.in_time(Sample(asset, channel, time_us, kept, int(quality), self.now_us), time)

    def time_us(self, time: Any) -> int:
        """Read a time. Raises `ValueError` where it is none."""
        if isinstance(time, str) and time in self._times_us:
            return self._times_us[time]
        try:
            time_us = self._times_us[time] = parse_time(time)
        except ValueError as error:
            raise ValueError(f"time {shown(time)}: {error}") from error
        return time_us

    def in_time(self, sample: Sample, time: object) -> Sample:
        """Give a sample whose time can be taken. Raises `ValueError`, with the time as it came."""
        if self.takes(sample.time_us):
            return sample
        if sample.time_us > self._latest_us:
            raise ValueError(f"time {shown(time)}: expected {POSSIBLE}")
        raise TooOldError(sample, shown(time), self._kept_from_us)

    def takes(self, time_us: int) -> bool:
        """Whether a sample of a time can be taken."""
        return self._kept_from_us <= time_us <= self._latest_us


def pushed_channel(channel: Any, channels: Mapping[str, str]) -> str:
    """Give the name of a channel. Raises `ValueError` where it takes no pushes."""
    if isinstance(channel, str) and channels.get(channel) == PUSH_SOURCE:
        return channel
    pushed = [name for name, source in channels.items() if source == PUSH_SOURCE]
    known = ", ".join(pushed) or "none"
    if isinstance(channel, str) and channel in channels:
        raise ValueError(
            f"channel {shown(channel)}: comes from {channels[channel]!r} and takes no pushes; "
            f"pushed channels are: {known}"
        )
    raise ValueError(f"channel {shown(channel)}: unknown; pushed channels are: {known}")


def finite_number(raw: Any) -> float | None:
    """Read a value. Raises `ValueError` where it is no finite number and not null."""
    if raw is None:
        return None
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise ValueError(f"value {shown(raw)}: expected a number or null")
    try:
        value = float(raw)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise ValueError("value: expected a finite number or null")
    return value


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


def refused(error: PushRefusedError) -> Problem:
    """Build the problem of a push of which nothing was stored."""
    return Problem(
        503,
        f"none of the samples was stored: {error}; expected the same push again later",
        headers={"Retry-After": str(error.retry_after_s)},
    )


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
