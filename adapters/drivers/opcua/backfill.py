"""What was missed during a loss, from the history of an OPC UA server."""

import asyncio
import math
from collections.abc import AsyncIterator, Sequence

from adapters.drivers.opcua.session import Session, SessionError
from adapters.drivers.opcua.values import FollowedNode, moment_of
from adapters.protocol import Clock
from adapters.samples import Sample, is_bad

WINDOW_US = 600_000_000  # one answer holds no more than this span of one node
TRIES = 3  # a history may lag behind the present value
RETRY_S = 1.0


async def fill_in(
    session: Session, points: Sequence[FollowedNode], longest_s: float, clock: Clock
) -> AsyncIterator[list[Sample]]:
    """Yield the samples inside the points' gaps, in the order of their times within each.

    A gap that is filled, or that the server has nothing of, is taken from its point; what stays
    open is said in its `history_problem`.

    - ``points``: with gaps: from the latest sample before a loss to the first after it, which both
      have been handed over already.
    - ``longest_s``: longest span that is fetched, behind the end of a gap.
    """
    for point in points:
        while point.gaps:
            begin_us, end_us = point.gaps[0]
            point.history_problem = ""
            if end_us - begin_us > longest_s * 1e6:
                point.history_problem = (
                    f"gap of {(end_us - begin_us) / 1e6:.0f} s: only the last {longest_s:g} s "
                    "are filled in (backfill_max_s)"
                )
                begin_us = end_us - round(longest_s * 1e6)
            try:
                async for samples in _windows(session, point, begin_us, end_us, clock):
                    yield samples
            except SessionError as error:
                if session.lost:
                    return  # the gap is filled in when the server is back
                point.history_problem = (
                    f"gap of {(end_us - begin_us) / 1e6:.0f} s until "
                    f"{moment_of(end_us):%Y-%m-%dT%H:%M:%SZ} stays: {error}"
                )
            del point.gaps[0]


async def _windows(
    session: Session, point: FollowedNode, begin_us: int, end_us: int, clock: Clock
) -> AsyncIterator[list[Sample]]:
    tries = 0
    while begin_us < end_us:
        until_us = min(begin_us + WINDOW_US, end_us)
        found = await session.history(point.config.node, moment_of(begin_us), moment_of(until_us))
        now_us = clock.now_us()
        readings = [point.read(one, now_us, clock.rate) for one in found]
        inside = sorted({one.time_us: one for one in readings}.items())
        samples = [
            Sample(
                point.asset,
                point.channel,
                time_us,
                math.nan if is_bad(one.quality) else one.value,
                one.quality,
                max(now_us, time_us),
            )
            for time_us, one in inside
            if begin_us < time_us <= until_us and time_us < end_us
        ]
        if samples:
            yield samples
            # Handed over: from here on if the connection is lost meanwhile.
            begin_us = samples[-1].time_us
            point.gaps[0] = (begin_us, end_us)
        reached = any(time_us >= until_us for time_us, _ in inside)
        if until_us == end_us and not reached:
            # What came first after the loss is not recorded yet, so others may follow.
            tries += 1
            if tries >= TRIES:
                return
            await asyncio.sleep(RETRY_S)
            continue
        begin_us = until_us
