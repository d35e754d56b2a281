"""Puts the service together and runs it until it is told to stop."""

import asyncio
import contextlib
import gc
import socket
import ssl
import sys
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import anyio.to_thread
import structlog
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

from adapters.drivers import Driver, SourceHealth
from adapters.samples import Batch
from service.alarms import AlarmBook, AlarmCondition, alarm_document
from service.api import create_app
from service.api.context import ServiceContext
from service.clock import ClockWatch, ProcessClock
from service.configuration import SettingsError
from service.ingest import Ingest, QualityChecks, Spool
from service.ingest.metrics import watch_late
from service.jobs.automatic import identify_by_itself
from service.jobs.executor import make_executor
from service.jobs.history import AssetHistory
from service.jobs.manager import IdentificationJobs
from service.jobs.models import active_model, first_model, why_not_of_this_asset
from service.kernels import compile_kernels
from service.live.asset import AssetRuntime
from service.live.bus import Bus
from service.outlets import Outlet, check_outlets, open_outlets
from service.security.tls import tls_context
from service.settings import AssetSection, Settings
from service.store import (
    Alarm,
    ModelVersion,
    Outbox,
    Retention,
    Store,
    StoreError,
    lock_data_directory,
    lock_database,
)
from service.upkeep import Upkeep
from service.web_server import serve_web
from service.wiring import Wiring, is_loopback, wire

HEALTH_EVERY_WALL_S = 1.0
CANCEL_AGAIN_WALL_S = 1.0
INGEST = "ingest"

_log = structlog.get_logger(__name__)


class Service:
    """A running service: drivers, store, live twins, jobs, alarms and the web side.

    Parameters
    ----------
    settings : Settings
        The checked configuration.
    wiring : Wiring
        The configuration's sources and channels, from `service.wiring.wire`.
    store : Store
        Open store.
    clock : ProcessClock
        Process time.
    """

    def __init__(
        self, settings: Settings, wiring: Wiring, store: Store, clock: ProcessClock
    ) -> None:
        self.settings = settings
        self.store = store
        self.clock = clock
        self.registry = CollectorRegistry()
        self.bus = Bus(clock)
        self.outbox = Outbox.open(settings.data_dir, store)
        Gauge(
            "bearing_twin_outbox_changes",
            "Alarm changes and audit lines that wait for the store, in memory or on the disk.",
            registry=self.registry,
        ).set_function(lambda: self.outbox.waiting)
        self.alarms = AlarmBook(self.outbox, clock, self._alarm_changed)
        self.spool = Spool.open(settings.data_dir, settings.service.spool_mib)
        self._clock_steps = Counter(
            "bearing_twin_clock_steps",
            "Times that the process clock was set.",
            registry=self.registry,
        )
        watch_late(
            lambda: {asset.id: asset.readings.late for asset in self.assets.values()}, self.registry
        )
        self.checks = QualityChecks(wiring.check_limits, self.registry)
        self.ingest = Ingest(
            store, self.spool, clock, self._take, registry=self.registry, checks=self.checks
        )
        self.drivers: list[Driver] = [source.create(clock) for source in wiring.sources]
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="forecast")
        self.histories = {asset.id: AssetHistory(asset, store, clock) for asset in settings.assets}
        self.assets = {asset.id: self._runtime(asset, wiring) for asset in settings.assets}
        for alarm in self.alarms.active():
            if alarm.asset not in self.assets:
                self.alarms.withdraw(alarm.asset, ())
        job_seconds = Histogram(
            "bearing_twin_job_seconds",
            "Wall seconds of an identification job.",
            registry=self.registry,
            buckets=(1, 2, 5, 10, 20, 60, 120, 300, 600, 1800, 3600),
        )
        self.jobs = IdentificationJobs(
            store,
            self.outbox,
            clock,
            self.bus,
            self.assets,
            self.histories,
            make_executor,
            settings.data_dir / "jobs",
            job_seconds.observe,
        )
        self.upkeep = Upkeep(store, clock, Retention(**settings.retention.model_dump()))
        self.app = create_app(
            ServiceContext(
                settings=settings,
                clock=clock,
                store=store,
                outbox=self.outbox,
                bus=self.bus,
                ingest=self.ingest,
                alarms=self.alarms,
                assets=self.assets,
                jobs=self.jobs,
                registry=self.registry,
                sources=self.source_health,
                history_problem=self._history_problem,
            )
        )

    def _runtime(self, asset: AssetSection, wiring: Wiring) -> AssetRuntime:
        active = self.store.active_model(asset.id)
        if active is None:
            active = self._default_version(asset, "before the first identification")
        elif foreign := why_not_of_this_asset(asset, active):
            _log.warning("active_model_replaced", asset=asset.id, reason=foreign)
            active = self._default_version(asset, f"version {active.version}: {foreign}")

        async def save_state(document: Mapping[str, Any]) -> None:
            await anyio.to_thread.run_sync(
                self.store.save_asset_state, asset.id, dict(document), abandon_on_cancel=True
            )

        return AssetRuntime(
            asset,
            wiring.channels[asset.id],
            active_model(asset, active),
            clock=self.clock,
            bus=self.bus,
            alarms=self.alarms,
            executor=self._executor,
            store_samples=self._store_derived,
            save_state=save_state,
            windows=self.histories[asset.id].windows_json,
            doubt=partial(self._doubt, asset.id),
        )

    def _default_version(self, asset: AssetSection, why: str) -> ModelVersion:
        now_us = self.clock.now_us()
        version = self.store.add_model_version(
            asset.id, "candidate", "", first_model(asset), now_us
        )
        return self.store.activate(
            asset.id, version, "service", f"default parameters; {why}", now_us
        )

    # ------------------------------------------------------------------ what flows
    def _take(self, batch: Batch) -> None:
        for asset in self.assets.values():
            asset.take(batch.samples, batch.plans)

    def _store_derived(self, samples: Any) -> None:
        self.ingest.submit(samples)

    def _alarm_changed(self, alarm: Alarm) -> None:
        if alarm.asset in self.assets:
            self.assets[alarm.asset].alarms_changed()
        self.bus.publish("alarm", alarm.asset, alarm_document(alarm))

    def source_health(self) -> list[SourceHealth]:
        """Health of every source, from memory."""
        return [driver.health() for driver in self.drivers]

    def _doubt(self, asset: str, channel: str) -> str:
        """Why a channel's latest sample is not good, as a check found or its source says."""
        found = self.checks.reason(asset, channel)
        if found:
            return found
        problems = (health.problems.get(f"{asset}/{channel}") for health in self.source_health())
        return next(filter(None, problems), "")

    def _history_problem(self) -> str | None:
        """Why history is not kept as configured; None while it is."""
        return self.ingest.too_old_problem or self.upkeep.problem

    def _report_too_old(self) -> None:
        """Raise an alarm for the assets whose samples are not stored because they are too old."""
        for asset in self.assets:
            problem = self.ingest.too_old(asset)
            if problem is not None:
                self.alarms.evaluate(
                    AlarmCondition(
                        asset=asset,
                        kind="history not kept",
                        channel="",
                        level="",
                        active=bool(problem),
                        value=None,
                        message=problem or "Samples are stored again",
                        priority=2,
                    )
                )

    async def _tell_health(self) -> None:
        watch = ClockWatch(self.clock)
        while True:
            await asyncio.sleep(HEALTH_EVERY_WALL_S)
            step_s = watch.step_s()
            if step_s:
                self._clock_steps.inc()
                _log.warning("clock_set", by_s=round(step_s, 3))
            self._report_too_old()
            now_us = self.clock.now_us()
            sources = [
                {
                    "name": health.name,
                    "driver": health.driver,
                    "up": health.up,
                    "detail": health.detail,
                    "age_s": (now_us - health.last_good_us) / 1e6 if health.last_good_us else None,
                }
                for health in self.source_health()
            ]
            degraded = not all(source["up"] for source in sources)
            self.bus.publish(
                "health",
                None,
                {"sources": sources, "degraded": degraded, "clock_rate": self.clock.rate},
            )

    # ------------------------------------------------------------------ life
    async def run(
        self,
        listener: socket.socket,
        stop: asyncio.Event,
        outlets: Sequence[Outlet] = (),
        tls: ssl.SSLContext | None = None,
    ) -> None:
        """Serve until ``stop`` is set, then stop cleanly: nothing accepted is lost.

        Parameters
        ----------
        listener : socket.socket
            Bound socket for the web side.
        stop : asyncio.Event
            Set it to end the service.
        outlets : sequence of Outlet
            What else is to be done beside it.
        tls : ssl.SSLContext, optional
            With it the web side talks HTTPS.
        """
        try:
            async with (
                self._background(self.ingest.run(self.drivers), INGEST, stop),
                contextlib.AsyncExitStack() as stack,
            ):
                for asset in self.assets.values():
                    kept = await anyio.to_thread.run_sync(self.store.load_asset_state, asset.id)
                    await stack.enter_async_context(
                        self._background(asset.run(kept), f"twin of {asset.id}", stop)
                    )
                await self.jobs.start()
                stack.push_async_callback(self.jobs.stop)
                for name, task in (
                    ("health", self._tell_health()),
                    ("upkeep", self.upkeep.run()),
                    (
                        "automatic identification",
                        identify_by_itself(self.jobs, self.histories, self.clock),
                    ),
                    *((name, work()) for name, work in outlets),
                    ("web", self._web(listener, tls)),
                ):
                    await stack.enter_async_context(self._background(task, name, stop))
                await stop.wait()
        finally:
            await anyio.to_thread.run_sync(self.outbox.close)
            self._executor.shutdown(wait=False, cancel_futures=True)
            self.spool.close()

    async def _web(self, listener: socket.socket, tls: ssl.SSLContext | None) -> None:
        server, doorway = serve_web(self.app, listener, tls)
        serving = asyncio.create_task(server.serve(sockets=[doorway]))
        try:
            await asyncio.shield(serving)
        finally:
            server.should_exit = True
            self.bus.close("the service stops")
            await serving

    @contextlib.asynccontextmanager
    async def _background(self, work: Any, name: str, stop: asyncio.Event) -> AsyncIterator[None]:
        """Run a task beside the rest; should it ever end by itself, the service stops."""
        task = asyncio.create_task(work, name=name)

        def ended(done: "asyncio.Task[None]") -> None:
            if not done.cancelled():
                error = done.exception()
                _log.error("task_ended", task=name, exc_info=error)
                stop.set()

        task.add_done_callback(ended)
        try:
            yield
        finally:
            task.remove_done_callback(ended)
            task.cancel()
            while not task.done():
                await asyncio.wait({task}, timeout=CANCEL_AGAIN_WALL_S)
                if name == INGEST and not task.done():
                    _cancel_sources_again()
            with contextlib.suppress(asyncio.CancelledError):
                await task


def _cancel_sources_again() -> None:
    """Cancel the tasks of drivers that have missed their cancellation.

    `asyncio.wait_for` of Python 3.11, which pymodbus uses, swallows a cancellation that comes
    together with the answer it waits for; the driver would then poll on for ever.
    """
    for task in asyncio.all_tasks():
        if task.get_name().startswith("source "):
            _log.warning("source_cancelled_again", task=task.get_name())
            task.cancel()


def bind(host: str, port: int) -> socket.socket:
    """Bind the address of the web side before anything else starts.

    Raises
    ------
    SettingsError
        If the address cannot be used; names it.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # The protocol is named so that asyncio switches Nagle's algorithm off: without it every
    # request on a kept connection waits some 40 ms.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        # From now on a client waits for the service to come up instead of being refused.
        listener.listen(256)
    except (OSError, OverflowError) as error:
        listener.close()
        raise SettingsError(
            f"service.host = {host!r}, service.port = {port}: cannot listen there "
            f"({getattr(error, 'strerror', None) or error}); expected a free port"
        ) from error
    return listener


def _be_prompt() -> None:
    """Keep the interpreter from holding up the event loop, and so the polls of the field buses.

    A collection of garbage that looks at all that the libraries brought along takes a tenth of a
    second; what is there now stays, and need not be looked at. A thread that reads or judges
    lets go of the interpreter after a millisecond instead of five.
    """
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(0.001)


def _has_key(store: Store) -> bool:
    now_us = time.time_ns() // 1000
    return any(key.is_valid(now_us) for key in store.api_keys())


async def serve(
    settings: Settings, *, announce: Callable[[str], None], stop: asyncio.Event
) -> None:
    """Run the service of a configuration until ``stop`` is set.

    Parameters
    ----------
    settings : Settings
        The configuration.
    announce : callable
        Called with the address of the web side once it listens.
    stop : asyncio.Event
        Set it to end the service cleanly.

    Raises
    ------
    SettingsError, StoreError
        If the configuration or the data directory cannot be used.
    """
    wiring = wire(settings)
    host = settings.service.host
    data_dir: Path = settings.data_dir
    check_outlets(settings)
    tls = None
    if settings.tls is not None:
        tls = tls_context(settings.path(settings.tls.certificate), settings.path(settings.tls.key))
    with contextlib.ExitStack() as stack:
        stack.enter_context(lock_data_directory(data_dir))
        listener = stack.enter_context(contextlib.closing(bind(host, settings.service.port)))
        store = stack.enter_context(Store.open(settings.service.database_url, data_dir))
        loop = asyncio.get_running_loop()
        lock = lock_database(
            settings.service.database_url, data_dir, lambda: loop.call_soon_threadsafe(stop.set)
        )
        if lock is not None:
            stack.enter_context(lock)
        if not is_loopback(host) and not _has_key(store):
            raise SettingsError(
                f"service.host = {host!r}: reachable from other machines, so at least one API key "
                "is needed; make one with 'bearing-twin keys create --role admin -c FILE'"
            )
        await anyio.to_thread.run_sync(compile_kernels)
        clock = ProcessClock.resume(settings.clock.rate, data_dir)
        service = Service(settings, wiring, store, clock)
        port = listener.getsockname()[1]
        scheme = "http" if tls is None else "https"
        web = service.app.state
        async with open_outlets(
            settings, service.assets, service.bus, web.authenticator, web.trail
        ) as outlets:
            _be_prompt()
            announce(f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}/")
            await service.run(listener, stop, outlets, tls)
        if lock is not None and lock.lost:
            raise StoreError(lock.lost)
