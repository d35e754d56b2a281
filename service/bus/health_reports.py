"""What the cell, or each of several, last reported of its health and its metrics."""

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Generic, TypeVar

import msgspec

from service.bus.commands import HealthCheck
from service.bus.exposition import merged
from service.bus.fleet_cells import Fleet
from service.bus.interface import AWAY_AFTER_S, HEALTH_TOPIC, METRICS_TOPIC, ReaderBus

#: Wall seconds after which a report says nothing any more: there is one each second.
HEALTH_HOLDS_S: Final = 5.0
_FORGET_AFTER_S: Final = 600.0

What = TypeVar("What")


class HealthReports:
    """Keeps the latest reports: who asks for them never asks a cell.

    Parameters
    ----------
    reader : ReaderBus
        Where they come from.

    Attributes
    ----------
    own : list of callable
        Checks of this process.
    """

    def __init__(self, reader: ReaderBus) -> None:
        self.own: list[Callable[[], HealthCheck]] = []
        self._reader = reader
        self._checks: _Latest[list[HealthCheck]] = _Latest()
        self._metrics: _Latest[bytes] = _Latest()
        self._decoder = msgspec.msgpack.Decoder(list[HealthCheck])

    async def run(self) -> None:
        """Take reports until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._take_checks())
            tasks.create_task(self._take_metrics())

    async def _take_checks(self) -> None:
        async for change in self._reader.changes(HEALTH_TOPIC):
            self._checks.take(change.epoch, self._decoder.decode(change.body))

    async def _take_metrics(self) -> None:
        async for change in self._reader.changes(METRICS_TOPIC):
            self._metrics.take(change.epoch, change.body)

    @property
    def known(self) -> bool:
        """Whether a cell has said how it is."""
        return self._checks.any

    def checks(self) -> list[HealthCheck]:
        """All checks; one that failed where a cell is away or has not said how it is."""
        return [*self._of_cells(), *(check() for check in self.own)]

    def _of_cells(self) -> list[HealthCheck]:
        reader = self._reader
        if isinstance(reader, Fleet):
            alive = {cell.epoch for cell in reader.alive()}
            if not alive:
                return [HealthCheck("cell", "failed", "no cell answers")]
            reports = self._checks.of(alive, HEALTH_HOLDS_S)
            if reports:
                return _checks_of(reader, reports)
            return [HealthCheck("cell", "failed", "no cell has said yet how it is")]
        if reader.away_s > AWAY_AFTER_S:
            sign = f"no sign of the cell for {reader.away_s:.0f} s"
            return [HealthCheck("cell", "failed", sign)]
        for checks in self._checks.of({reader.epoch}, HEALTH_HOLDS_S).values():
            return checks
        waits_for = reader.state.waits_for
        return [
            HealthCheck(
                "cell",
                "failed",
                f"the cell waits for {waits_for}"
                if waits_for
                else f"the cell has not said how it is for {HEALTH_HOLDS_S:g} s",
            )
        ]

    def metrics(self) -> bytes:
        """The metrics of the cell, or of all; empty where there is none that is alive."""
        reader = self._reader
        if isinstance(reader, Fleet):
            alive = {cell.epoch for cell in reader.alive()}
            return _metrics_of(reader, self._metrics.of(alive))
        if reader.away_s > AWAY_AFTER_S:
            return b""
        return b"".join(self._metrics.of({reader.epoch}).values())


class _Latest(Generic[What]):
    """The latest report of each cell, with the time at which it came."""

    def __init__(self) -> None:
        self._reports: dict[str, tuple[float, What]] = {}

    def take(self, cell: str, report: What) -> None:
        now_s = time.monotonic()
        self._reports[cell] = now_s, report
        for one, (came_s, _) in list(self._reports.items()):
            if now_s - came_s > _FORGET_AFTER_S:
                del self._reports[one]

    @property
    def any(self) -> bool:
        return bool(self._reports)

    def of(self, cells: set[str], holds_s: float = 0.0) -> Mapping[str, What]:
        now_s = time.monotonic()
        return {
            cell: report
            for cell, (came_s, report) in self._reports.items()
            if cell in cells and (not holds_s or now_s - came_s <= holds_s)
        }


_RANK: Final[Mapping[str, int]] = {"ok": 0, "degraded": 1, "failed": 2}


def _checks_of(fleet: Fleet, reports: Mapping[str, Sequence[HealthCheck]]) -> list[HealthCheck]:
    """What every cell says of itself, said once: the worst of it; and who owns the partitions."""
    missing = len(fleet.missing())
    shares = f"{len(fleet.alive())} cells own all {fleet.partitions} partitions"
    checks = [
        HealthCheck("partitions", "degraded", f"{missing} partitions have no owner")
        if missing
        else HealthCheck("partitions", "ok", shares)
    ]
    worst: dict[str, HealthCheck] = {}
    for check in (check for one in reports.values() for check in one):
        known = worst.get(check.name)
        if known is None or _RANK[check.status] > _RANK[known.status]:
            worst[check.name] = check
    return checks + list(worst.values())


def _metrics_of(fleet: Fleet, texts: Mapping[str, bytes]) -> bytes:
    """What cells expose, and the owners of the partitions."""
    owners = fleet.owners()
    name = "bearing_twin_partition_owner"
    lines = [
        f"# HELP {name} 1 while a living cell owns the partition.",
        f"# TYPE {name} gauge",
        *(
            f'{name}{{partition="{one}"}} {1.0 if one in owners else 0.0}'
            for one in range(fleet.partitions)
        ),
    ]
    of_cells = merged({f"cell-{token}": text for token, text in texts.items()})
    return of_cells + ("\n".join(lines) + "\n").encode()
