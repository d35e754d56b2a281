"""How the cell is: made once a second and reported, so that no one who wants to know costs work."""

import asyncio
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Final, Literal

from anyio import CapacityLimiter, to_thread
from prometheus_client import CollectorRegistry, Gauge
from prometheus_client.exposition import generate_latest

from adapters.protocol import SourceHealth
from service.bus.commands import HealthCheck, Present
from service.bus.interface import HEALTH_TOPIC, METRICS_TOPIC, CellBus
from service.bus.messages import encode
from service.bus.presence import resident_bytes
from service.ingest import Ingest
from service.live.asset import AssetRuntime
from service.pauses import Steps
from service.store import Store, StoreUnavailableError
from service.tasks import Part

#: Wall seconds between two reports.
REPORT_EVERY_S: Final = 1.0
#: The metrics of many assets take long to write: they take this share of a processor at most.
_METRICS_SHARE: Final = 0.05
#: Wall seconds in which the store must answer.
STORE_ANSWERS_S: Final = 1.5
#: Wall seconds without a word of a process after which it counts as gone.
PRESENT_S: Final = 10.0


@dataclass(slots=True)
class _Process:
    """What a process last said of itself, and when."""

    seen_s: float
    said: Present

    @property
    def is_there(self) -> bool:
        return time.monotonic() - self.seen_s < PRESENT_S


@dataclass
class Health(Part):
    """Reports once a second how the parts of the cell and the other processes are.

    Parameters
    ----------
    bus : CellBus
        Takes the reports.
    store, ingest, assets, registry
        What is looked at.
    sources : callable
        Gives the health of every source.
    find_problems : callable
        Gives what is wrong with other parts, by the name of the check.
    compiling : callable
        Gives one line about what is being compiled; empty when all is loaded.
    follows_nothing : callable
        Whether no asset is followed though there are some.
    """

    name = "health"

    bus: CellBus
    store: Store
    ingest: Ingest
    assets: Mapping[str, AssetRuntime]
    registry: CollectorRegistry
    sources: Callable[[], Sequence[SourceHealth]]
    find_problems: Callable[[], Mapping[str, str | None]] = dict
    compiling: Callable[[], str] = str
    follows_nothing: Callable[[], bool] = bool
    _processes: dict[str, _Process] = field(default_factory=dict)
    _reports: int = 0

    def __post_init__(self) -> None:
        self._up = Gauge(
            "bearing_twin_process_up",
            "1 while a process of the service reports to the cell.",
            ["process"],
            registry=self.registry,
        )
        self._memory = Gauge(
            "bearing_twin_process_resident_bytes",
            "Memory of a process of the service, workers not included, as it last reported.",
            ["process"],
            registry=self.registry,
        )
        self._up.labels("cell").set(1.0)
        self._memory.labels("cell").set_function(resident_bytes)
        # Not among the threads of callers, who may have them all.
        self._thread = CapacityLimiter(1)

    async def run(self) -> None:
        """Report until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._report_metrics())
            while True:
                await self.report()
                await asyncio.sleep(REPORT_EVERY_S)

    async def report(self) -> None:
        """Report all checks as they are now."""
        checks = await self.checks()
        self._reports += 1
        write = partial(_write, self.bus, HEALTH_TOPIC, self._reports, checks)
        await to_thread.run_sync(write, limiter=self._thread)

    async def report_metrics(self) -> float:
        """Report the metrics as they are now; gives the processor seconds that it took."""
        self._reports += 1
        return await to_thread.run_sync(self._write_metrics, self._reports)

    async def _report_metrics(self) -> None:
        while True:
            took_s = await self.report_metrics()
            await asyncio.sleep(max(REPORT_EVERY_S, took_s / _METRICS_SHARE))

    def _write_metrics(self, number: int) -> float:
        begun_s = time.thread_time()
        there = [one.said.metrics for one in list(self._processes.values()) if one.is_there]
        text = generate_latest(self.registry) + b"".join(there)
        self.bus.publish(METRICS_TOPIC, number, text)
        return time.thread_time() - begun_s

    async def present(self, process: Present) -> bool:
        """Note that a process is there, and how."""
        name = process.process
        known = name in self._processes
        self._processes[name] = _Process(time.monotonic(), process)
        if not known:
            latest = partial(self._processes.__getitem__, name)
            self._up.labels(name).set_function(lambda: float(latest().is_there))
            self._memory.labels(name).set_function(lambda: float(latest().said.resident_bytes))
        return True

    async def checks(self) -> list[HealthCheck]:
        """Give all checks."""
        return [
            await self._store(),
            *self._problems(),
            *await self._twins(),
            *self._sources(),
            *self._others(),
        ]

    async def _store(self) -> HealthCheck:
        ingest = self.ingest
        problem = ingest.problem
        if problem is None:  # else it was asked a moment ago
            try:
                async with asyncio.timeout(STORE_ANSWERS_S):
                    check = self.store.identity.check
                    await to_thread.run_sync(check, abandon_on_cancel=True)
            except TimeoutError:
                problem = f"no answer within {STORE_ANSWERS_S:g} s"
            except StoreUnavailableError as error:
                problem = str(error)
        if problem is None:
            return HealthCheck("store", "ok", "reads and writes")
        if ingest.spool_problem is not None:
            return HealthCheck("store", "failed", f"{problem}; spool: {ingest.spool_problem}")
        waiting = f"{ingest.spooled} samples wait on the spool"
        return HealthCheck("store", "degraded", f"{problem}; {waiting}")

    def _problems(self) -> Iterator[HealthCheck]:
        for name, problem in self.find_problems().items():
            yield _check(name, problem, "as it should be")
        if self.follows_nothing():
            yield HealthCheck("followed", "failed", "no asset is followed; see assets")

    async def _twins(self) -> list[HealthCheck]:
        steps, checks, compiling = Steps(), [], self.compiling()
        for asset in list(self.assets.values()):
            name = f"twin:{asset.id}"
            if not asset.documents.running:
                checks.append(HealthCheck(name, "failed", "the live twin is not running"))
            elif compiling:
                checks.append(HealthCheck(name, "degraded", compiling))
            else:
                bad = asset.documents.channels_without_good_data()
                problem = f"no good data: {', '.join(bad)}" if bad else None
                checks.append(_check(name, problem, "follows the machine"))
            await steps.pause()
        return checks

    def _sources(self) -> Iterator[HealthCheck]:
        for source in self.sources():
            status: Literal["ok", "degraded"] = "ok" if source.is_well else "degraded"
            yield HealthCheck(f"source:{source.name}", status, source.detail)

    def _others(self) -> Iterator[HealthCheck]:
        for name, process in self._processes.items():
            if not process.is_there:
                yield _check(f"process:{name}", "does not report to the cell")
            else:
                for publisher, problem in process.said.publishers.items():
                    yield _check(f"publisher:{publisher}", problem or None, "hands everything on")


def _check(name: str, problem: str | None, fine: str = "") -> HealthCheck:
    return HealthCheck(name, "degraded" if problem else "ok", problem or fine)


def _write(bus: CellBus, topic: str, number: int, message: object) -> None:
    bus.publish(topic, number, encode(message))
