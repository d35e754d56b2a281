"""Makes the live forecasts of one asset, again and again, and hands each on to who follows them."""

import asyncio
import contextlib
from collections.abc import Callable, Iterator

from adapters.protocol import Clock
from service.live.forecasting import Forecasting
from service.live.guard import Guard
from service.live.issues import ForecastFollower
from service.live.judgement import Judgement

# With the step of the twin and the time that computing takes a forecast is never a minute old.
FORECAST_EVERY_S = 45.0
FORECAST_LEAST_WALL_S = 1.0


class ForecastLoop:
    """Makes a forecast when it is due, or wanted sooner.

    - ``forecasting``: makes them.
    - ``is_first``: whether none was wanted yet since the start.
    """

    __slots__ = (
        "_asset",
        "_clock",
        "_followers",
        "_guard",
        "_judgement",
        "_wanted",
        "forecasting",
        "is_first",
    )

    def __init__(
        self,
        asset: str,
        forecasting: Forecasting,
        judgement: Judgement,
        clock: Clock,
    ) -> None:
        self._asset = asset
        self.forecasting = forecasting
        self._judgement = judgement
        self._clock = clock
        self._followers: list[tuple[ForecastFollower, Guard]] = []
        self._wanted = asyncio.Event()
        self._guard = Guard("forecast", asset)
        self.is_first = True

    @property
    def failing(self) -> bool:
        """Whether the last forecast could not be made."""
        return self._guard.failing

    @property
    def followers(self) -> Iterator[ForecastFollower]:
        """What follows the forecasts."""
        return (follower for follower, _ in self._followers)

    def follow(self, follower: ForecastFollower) -> None:
        """Have each live forecast noted."""
        self._followers.append((follower, Guard(f"forecast_{follower.name}", self._asset)))

    def record(self, channel: str, lead_time_s: float | None) -> str:
        """Say how forecasts of a channel so far ahead have done; empty where that is unknown."""
        said = (follower.record(channel, lead_time_s) for follower in self.followers)
        return "; ".join(one for one in said if one)

    def want(self) -> None:
        """Have a forecast made soon."""
        self._wanted.set()

    async def run(self, made: Callable[[int], None]) -> None:
        """Make forecasts until cancelled.

        ``made``: called after each, with the process time of that moment.
        """
        period_wall_s = max(FORECAST_EVERY_S / self._clock.rate, FORECAST_LEAST_WALL_S)
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(period_wall_s):
                    await self._wanted.wait()
            self._wanted.clear()
            # What was kept is of the time before the start: its first step comes first.
            if self.forecasting.has_begun and not self.is_first:
                with self._guard():
                    await self._once(made)
            await asyncio.sleep(FORECAST_LEAST_WALL_S)

    async def _once(self, made: Callable[[int], None]) -> None:
        if not await self.forecasting.make(self._judgement.blind):
            return
        issue = self.forecasting.take_issue()
        if issue is not None:
            for follower, guard in self._followers:
                with guard():
                    follower.issued(issue)
        made(self._clock.now_us())
