"""Minute averages of one asset from the store, and the low-risk windows in them."""

from collections.abc import Sequence

import anyio.to_thread
import numpy as np
from numpy.typing import NDArray

from adapters.protocol import Clock
from service.clock import MINUTE_US, rfc3339
from service.documents.identification import WindowDocument
from service.documents.profiles import StepLevel
from service.domain.channels import AMBIENT, OPERATING_CHANNELS, is_modelled
from service.site.asset_section import AssetSection
from service.site.machines.machine import Machine
from service.store import MinuteTable, Store
from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.minute_rows import StepMeans, minute_rows, row_step_s
from twin_core.time_constants import fastest_time_s
from twin_core.windows import (
    MEASURED_TOLERANCE,
    STANDING_RPM,
    LowRiskRegion,
    MinuteData,
    Window,
    find_windows,
    is_at_rest,
    varied,
)

LOOK_BACK_US = 72 * 3600 * 1_000_000
SHORTEST_WINDOW_S = 1800.0
# How many good minutes there must be in them: of three in a row two may be missing.
FEWEST_MINUTES = 10
# What is left of a minute with bad or uncertain samples must be this many good ones for each of
# them, and so much of the channel's usual number of samples in a minute.
GOOD_FOR_EACH_DOUBTFUL = 3
FEWEST_OF_USUAL = 0.75
_ANYWHERE = LowRiskRegion(np.inf, np.inf)
# What the drivers and the sample writer may still hold, in wall seconds.
UNWRITTEN_WALL_S = 1.0
# What must have come again at one operating point before a re-identification is worth its while.
NEW_POINT_S = 1500.0


class AssetHistory:
    """What an asset's store holds that identification may use.

    Parameters
    ----------
    settings : AssetSection
        Channels and low-risk region.
    store, clock
        Where the samples are; process time.
    """

    def __init__(self, settings: AssetSection, store: Store, clock: Clock) -> None:
        self._asset = settings.id
        self._region = settings.low_risk.region
        self._temperatures = tuple(name for name in settings.channels if is_modelled(name))
        self._sensors = settings.sensor_names
        self._operating = (*OPERATING_CHANNELS, *settings.input_names)
        self._inputs = settings.input_names
        self._machine = Machine(settings.model, settings.bearing, settings.network)
        self._fastest_s: float | None = None
        self._has_ambient = AMBIENT in settings.channels
        self._store = store
        self._clock = clock

    async def windows(self) -> list[Window]:
        """Low-risk windows of the last days, oldest first."""
        minutes = await self._minutes()
        return self._find(minutes) if minutes is not None else []

    async def window_documents(self) -> list[WindowDocument]:
        """Low-risk windows as documents."""
        return [window_document(window) for window in await self.windows()]

    async def are_worth_identifying(self, found: list[Window], tried: list[Window]) -> bool:
        """Return whether windows hold enough that is new and varied.

        Parameters
        ----------
        found : list of Window
            All windows there are.
        tried : list of Window
            What does not count as new, next to the windows of all model versions.
        """
        if not found:
            return False
        versions = await anyio.to_thread.run_sync(self._store.models.versions, self._asset)
        used = [
            Window.from_dict(window)
            for version in versions
            for window in version.document["window_records"]
        ]
        return varied(used + tried, found, NEW_POINT_S)

    async def all_operation(self, look_back_us: int) -> list[Window]:
        """Give every window of good data, whatever the machine ran, oldest first.

        Parameters
        ----------
        look_back_us
            How far to look back.
        """
        minutes = await self._minutes(self._clock.now_us() - look_back_us)
        if minutes is None:
            return []
        return list(find_windows(minutes, _ANYWHERE, SHORTEST_WINDOW_S))

    async def running_minutes(self, since_us: int) -> MinuteData | None:
        """Give the good rows of the running machine since a time; None without any."""
        minutes = await self._minutes(since_us)
        if minutes is None:
            return None
        running = minutes.take(minutes.good & (np.abs(minutes.speed_rpm) >= STANDING_RPM))
        return running if running.size else None

    def span_us(self, window: Window) -> tuple[int, int]:
        """Start and end of a window as process time."""
        return _span_us(window)

    async def problem_with(self, start_us: int, end_us: int) -> str | None:
        """Say why a span asked for by a user cannot be identified from; None when it can."""
        minutes = await self._minutes(start_us, end_us)
        if minutes is None or not minutes.good.any():
            return (
                f"no good data from {rfc3339(start_us)} to {rfc3339(end_us)}; "
                "expected speed, load, ambient and ring temperatures"
            )
        good = minutes.good
        outside = good & ~self._region.contains(
            minutes.speed_rpm, minutes.load_n, MEASURED_TOLERANCE
        )
        if outside.any():
            return (
                f"{int(outside.sum())} min are outside the low-risk region "
                f"({self._region.speed_rpm_max:g} rpm, {self._region.load_n_max:g} N)"
            )
        running_s = minutes.time_s[good & (np.abs(minutes.speed_rpm) >= STANDING_RPM)]
        if running_s.size < FEWEST_MINUTES or np.ptp(running_s) < SHORTEST_WINDOW_S - 120:
            return (
                f"less than {SHORTEST_WINDOW_S / 60:g} min of good data on the running machine "
                f"({running_s.size} min)"
            )
        return None

    async def identification_data(self, spans_us: Sequence[tuple[int, int]]) -> IdentificationData:
        """Data set of given spans; raises ValueError when there is nothing good in them."""
        windows = []
        for start_us, end_us in spans_us:
            minutes = await self._minutes(start_us, end_us, finely=True)
            if minutes is None:
                raise ValueError(f"no data from {rfc3339(start_us)} to {rfc3339(end_us)}")
            revolutions = await self._revolutions_before(start_us)
            windows.append(
                IdentificationWindow(
                    minutes=minutes, at_rest=is_at_rest(minutes), revolutions=revolutions
                )
            )
        return IdentificationData(tuple(windows))

    # ------------------------------------------------------------------ from the store
    async def _revolutions_before(self, time_us: int) -> float:
        """Revolutions of the shaft from the first stored sample until then."""
        minutes = await self._minutes(time_us - LOOK_BACK_US, time_us)
        if minutes is None:
            return 0.0
        return float(np.nansum(minutes.speed_rpm))

    async def _minutes(
        self, start_us: int | None = None, end_us: int | None = None, finely: bool = False
    ) -> MinuteData | None:
        """Read the whole minutes of a span; by default the last days'.

        Finely: in the steps that the asset's network needs, where they are shorter.
        """
        written_us = self._clock.now_us() - round(UNWRITTEN_WALL_S * self._clock.rate * 1e6)
        last_us = (written_us // MINUTE_US - 1) * MINUTE_US
        end_us = last_us if end_us is None else min(end_us, last_us)
        start_us = end_us - LOOK_BACK_US if start_us is None else start_us
        start_us, end_us = -(-start_us // MINUTE_US) * MINUTE_US, end_us // MINUTE_US * MINUTE_US
        return await anyio.to_thread.run_sync(self._read, start_us, end_us, finely)

    def _step_us(self, start_us: int, end_us: int) -> int:
        """Step of the rows that the asset's network is identified from, by its data's spacing."""
        if self._machine.network is None:
            return MINUTE_US
        if self._fastest_s is None:
            self._fastest_s = fastest_time_s(self._machine.build())
        names = (*self._operating, *(name for name in self._sensors if name in self._temperatures))
        table = self._store.history.minute_averages(self._asset, names, start_us, end_us)
        counts = [count[count > 0] for count in table.good_count.values()]
        fewest = min((float(np.median(count)) for count in counts if count.size), default=1.0)
        spacing_s = 60.0 / max(fewest, 1.0)
        return round(1e6 * row_step_s(self._fastest_s, spacing_s, (end_us - start_us) / 1e6))

    def _read(self, start_us: int, end_us: int, finely: bool = False) -> MinuteData | None:
        """Operating point over each step, temperatures around its beginning."""
        if end_us <= start_us or not self._temperatures:
            return None
        step_us = self._step_us(start_us, end_us) if finely else MINUTE_US
        over = self._store.history.minute_averages(
            self._asset, self._operating, start_us, end_us, step_us=step_us
        )
        around = self._store.history.minute_averages(
            self._asset,
            self._temperatures,
            start_us - step_us // 2,
            end_us - step_us // 2,
            -step_us // 2,
            step_us,
        )
        if not over.minute_us.size and not around.minute_us.size:
            return None
        operating = dict(over.mean)
        if not self._has_ambient:
            # Nothing on the machine is colder than the ambient.
            known = [values[np.isfinite(values)] for values in around.mean.values()]
            coldest = min((float(values.min()) for values in known if values.size), default=np.nan)
            operating[AMBIENT] = np.full(over.minute_us.size, coldest)
        return minute_rows(
            StepMeans(over.minute_us / 1e6, operating, _soundness(over)),
            StepMeans((around.minute_us + step_us // 2) / 1e6, around.mean, _soundness(around)),
            needed=self._sensors,
        )

    def _find(self, minutes: MinuteData) -> list[Window]:
        return list(find_windows(minutes, self._region, SHORTEST_WINDOW_S))


def _soundness(table: MinuteTable) -> dict[str, NDArray[np.bool_]]:
    """Whether the means of a table stand for their minutes, by channel."""
    return {name: _is_sound(table, name) for name in table.mean}


def _is_sound(table: MinuteTable, channel: str) -> NDArray[np.bool_]:
    """Whether the mean of a channel's good samples stands for the minute, minute by minute.

    It does when none of the minute's samples was bad or uncertain; and when a few were, as of a
    sensor that spikes, but the good ones are by far more and nearly as many as usual. A minute in
    which the channel fell silent has a bad sample too, and fewer good ones than usual.
    """
    good, doubtful = table.good_count[channel], table.bad_count[channel]
    count = good + doubtful
    usual = float(np.median(count[count > 0])) if count.any() else 0.0
    enough = np.maximum(GOOD_FOR_EACH_DOUBTFUL * doubtful, FEWEST_OF_USUAL * usual)
    return np.asarray((doubtful == 0) | (good >= enough), np.bool_)


def _span_us(window: Window) -> tuple[int, int]:
    """Half-open span of a window: its last row is still part of it."""
    return round(window.start_s * 1e6), round(window.end_s * 1e6) + MINUTE_US


def window_document(window: Window) -> WindowDocument:
    """Show a window."""
    start_us, end_us = _span_us(window)
    return WindowDocument(
        start=rfc3339(start_us),
        end=rfc3339(end_us),
        speed_rpm_max=round(window.speed_rpm_max, 1),
        load_n_max=round(window.load_n_max, 1),
        operating_points=[
            StepLevel(
                speed_rpm=round(point.speed_rpm, 1),
                load_n=round(point.load_n, 1),
                duration_s=point.duration_s,
            )
            for point in window.operating_points
        ],
        score=window.score,
    )
