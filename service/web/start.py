"""Starts the web side: it answers from the first moment on, also while the cell is not there."""

import asyncio
import contextlib
import multiprocessing
import socket
import ssl
from collections.abc import Callable, Collection
from functools import partial
from typing import Final

import structlog
from anyio import to_thread
from prometheus_client import CollectorRegistry, Gauge

from service.bus.commands import Assets
from service.bus.directory import Directory
from service.bus.fleet_cells import Fleet
from service.bus.fleet_connection import fleet_of
from service.bus.fleet_following import FleetFollowing
from service.bus.following import Following
from service.bus.health_reports import HealthReports
from service.bus.interface import AWAY_AFTER_S, ReaderBus
from service.bus.local import LocalReaderBus
from service.bus.presence import report_presence
from service.bus.pushed_samples import PackedSamples
from service.bus.replicas import Replicas
from service.bus.stream import LiveMessages, heartbeats
from service.clock import ProcessClock
from service.documents.messages import ServiceHealth, SourceDocument
from service.domain.errors import CellUnavailableError
from service.domain.requests import PUSH_SOURCE
from service.security.keys import check_key
from service.service_manager import ServiceManager
from service.site.settings import Settings
from service.store import Outbox, Store, StoreUnavailableError
from service.tasks import background
from service.waiting import StoppedError, Waiting
from service.web.api import create_app
from service.web.api.context import ServiceContext
from service.web.cell import AskedCell, CellIngest
from service.web.overview import Overview
from service.web.questions import WorkerQuestions
from service.web.side import WebSide
from service.web.waiting_pushes import WaitingPushes

#: Lines of the audit trail wait for the store in a file of this process.
OUTBOX_FILE: Final = "outbox-web.db"
_LOOK_EVERY_S: Final = 0.1
_CLOSE_S: Final = 1.0

_log = structlog.get_logger(__name__)


async def run_web(
    settings: Settings,
    *,
    listener: socket.socket,
    tls: ssl.SSLContext | None,
    stop: asyncio.Event,
    ready: Callable[[], None],
) -> None:
    """Run the web side of a configuration until ``stop`` is set: REST, stream and pages.

    It waits for the cell, and goes on when the cell ends and comes back. Raises `SettingsError` if
    no client could log in: other machines may reach the service and there is no key;
    `StoreError` if the store cannot be used.
    """
    with contextlib.suppress(StoppedError):
        await _Start(settings, stop).run(listener, tls, ready)


class _Start:
    """One run of a web side."""

    def __init__(self, settings: Settings, stop: asyncio.Event) -> None:
        self._settings = settings
        self._stop = stop
        self._web = WebSide()
        self._waiting = Waiting(stop, self._waits_for)

    def _waits_for(self, what: str, why: str) -> None:
        self._web.waits_for = what

    async def run(
        self, listener: socket.socket, tls: ssl.SSLContext | None, ready: Callable[[], None]
    ) -> None:
        settings, stop = self._settings, self._stop
        async with contextlib.AsyncExitStack() as stack:
            await stack.enter_async_context(background(self._web.run(listener, tls), "web", stop))
            until = self._waiting.until
            url, data_dir = settings.service.database_url, settings.data_dir
            open_store = partial(Store.open, url, data_dir)
            reader: LocalReaderBus | Fleet
            if settings.is_fleet:
                store = await until("the store", open_store)
                stack.callback(store.close)
                directory = Directory(settings, store)
                await until("the store", directory.look)
                await stack.enter_async_context(background(directory.follow(), "directory", stop))
                reader = fleet_of(settings, store, directory, "web")
                await stack.enter_async_context(background(reader.run(), "bus", stop))
                await self._until_cell(reader)
            else:
                reader = LocalReaderBus(settings.data_dir)
                stack.callback(reader.close)
                await stack.enter_async_context(background(reader.run(), "bus", stop))
                await self._until_cell(reader)
                store = await until("the store", open_store)
                stack.callback(store.close)
            await until("the store", partial(check_key, store, settings.service.host))
            outbox = await until(
                "room on the disk", partial(Outbox.open, data_dir, store, OUTBOX_FILE)
            )
            stack.callback(outbox.close, _CLOSE_S)
            questions = WorkerQuestions(settings, store)
            clock = ProcessClock.resume(settings.clock.rate, data_dir)
            bus = LiveMessages(clock)
            answering = questions.run(lambda: bus.subscribers > 0 and reader.state.follows)
            await stack.enter_async_context(background(answering, "questions", stop))
            following: Following | FleetFollowing
            is_known: Callable[[str], bool] = frozenset[str]().__contains__
            if isinstance(reader, Fleet):
                following = FleetFollowing(reader, bus, clock)
                await stack.enter_async_context(background(heartbeats(bus), "heartbeat", stop))
                is_known = reader.is_known
            else:
                following = Following(reader, bus)
            await stack.enter_async_context(background(following.run(), "live messages", stop))
            health = HealthReports(reader)
            await stack.enter_async_context(background(health.run(), "health", stop))
            replicas = Replicas(reader, questions)
            await self._until_known(replicas, following, health)
            cell = AskedCell(reader)
            fleet = Overview(replicas, bus)

            def changed(assets: Collection[str] | None) -> None:
                replicas.changed(assets)
                cell.forget()

            kept_from_us = await until("the store", store.samples.raw_kept_from_us)
            registry = CollectorRegistry()
            waiting: WaitingPushes | None = None
            if isinstance(reader, Fleet):
                open_pushes = partial(WaitingPushes.open, data_dir, settings.service.spool_mib)
                waiting = await until("room on the disk", open_pushes)
                stack.callback(waiting.close)
                health.own.append(waiting.problem)
                Gauge(
                    "bearing_twin_pushes_waiting",
                    "Pushes that wait on the disk of a web process for the cells of their assets.",
                    registry=registry,
                ).set_function(partial(len, waiting))
            ingest = CellIngest(reader, kept_from_us, waiting)
            app = create_app(
                ServiceContext(
                    settings=settings,
                    clock=clock,
                    store=store,
                    outbox=outbox,
                    bus=bus,
                    cell=cell,
                    ingest=ingest,
                    assets=replicas.assets,
                    health=health,
                    fleet=fleet,
                    refresh_summaries=lambda assets: replicas.refresh_known(
                        "summary", assets=assets
                    ),
                    changed=changed,
                    follow=following.follow,
                    apply_assets=partial(_apply_assets, cell, replicas),
                    is_known=is_known,
                    apply_file=_apply_file(settings),
                    registry=registry,
                )
            )
            for name, work in (
                ("presence", report_presence(reader, "web")),
                ("assets", replicas.follow()),
                ("fleet", fleet.run()),
                ("absence", _report_absence(reader, replicas, bus, clock.rate)),
            ):
                await stack.enter_async_context(background(work, name, stop))
            if waiting is not None:
                handing = waiting.run(partial(_hand_over, ingest, store, is_known, clock.rate))
                await stack.enter_async_context(background(handing, "waiting pushes", stop))
            await stack.enter_async_context(app.router.lifespan_context(app))
            stack.push_async_callback(self._leave, bus)
            self._web.show(app)
            ready()
            await stop.wait()

    async def _leave(self, bus: LiveMessages) -> None:
        bus.close("the service stops")
        await self._web.stop()

    async def _until_cell(self, reader: ReaderBus) -> None:
        """Wait for a cell that takes commands."""
        while not (reader.state.ready and reader.away_s < AWAY_AFTER_S):
            there = reader.away_s < AWAY_AFTER_S
            self._web.waits_for = (reader.state.waits_for if there else "") or "the cell"
            await self._pause()

    async def _until_known(
        self, replicas: Replicas, following: Following | FleetFollowing, health: HealthReports
    ) -> None:
        """Wait until every asset, the latest live messages and the cell's health are known."""
        while True:
            try:
                await replicas.load()
                break
            except CellUnavailableError:
                self._web.waits_for = "the cell"
                await self._pause()
        while not (following.caught_up.is_set() and health.known):
            await self._pause()

    async def _pause(self) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_LOOK_EVERY_S):
                await self._stop.wait()
        if self._stop.is_set():
            raise StoppedError


def _apply_file(settings: Settings) -> Callable[[], None] | None:
    """How to have the service follow its file; only a supervisor of ours starts it again."""
    supervised = multiprocessing.parent_process() is not None
    return ServiceManager().reload if supervised and not settings.is_fleet else None


async def _apply_assets(cell: AskedCell, replicas: Replicas) -> dict[str, str]:
    """Have the cell take up what the store holds now, and know it here too."""
    wrong = await cell(Assets).apply()
    await replicas.load()
    return wrong


async def _hand_over(
    ingest: CellIngest,
    store: Store,
    is_known: Callable[[str], bool],
    clock_rate: float,
    asset: str,
    samples: PackedSamples,
    received_us: int,
) -> None:
    """Give samples that have waited to the cell of their asset, or to the store if it has none."""
    if is_known(asset):
        await ingest.hand_over(asset, samples, received_us)
        return
    from service.ingest.source_clocks import SourceClocks  # seldom

    # It was removed meanwhile: no cell will ever follow it, and its history stays.
    try:
        clocks = SourceClocks(clock_rate)  # which the cell would have asked
        rows = clocks.put_right(samples.unpack(asset, received_us), PUSH_SOURCE)
        await to_thread.run_sync(store.samples.write, rows)
    except StoreUnavailableError as error:
        raise CellUnavailableError(str(error)) from error


async def _report_absence(
    reader: ReaderBus, replicas: Replicas, bus: LiveMessages, clock_rate: float
) -> None:
    """Send clients a message when the cell is away: nothing that they see is live then."""
    reported = False
    while True:
        await asyncio.sleep(1.0)
        away = reader.away_s > 2 * AWAY_AFTER_S
        if not away:
            reported = False
            continue
        if not reported:
            _log.warning("cell_away", since_s=round(reader.away_s, 1))
        reported = True
        cell = SourceDocument(
            name="cell",
            driver="bus",
            up=False,
            detail="the process that follows the machines does not answer",
            age_s=reader.away_s,
        )
        health = ServiceHealth(sources=[cell], degraded=True, clock_rate=clock_rate)
        bus.announce("health", None, health)
        for asset in replicas.assets.values():
            with contextlib.suppress(CellUnavailableError):
                bus.announce("verdict", asset.id, asset.verdict())
