"""An application on a real store, bus, alarm book and ingest, and the cell's answers to it.

The twin and the job manager are the boundary of the web side: small in-memory ones stand there.
"""

import asyncio
import shutil
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import httpx2
import pytest
from fastapi import FastAPI
from prometheus_client import CollectorRegistry

from adapters.protocol import SourceHealth
from adapters.samples import Batch, Sample
from service.alarms import AlarmBook, AlarmCondition
from service.alarms.silencing import Silencing
from service.bus import commands
from service.bus.calls import answering
from service.bus.health_reports import HealthReports
from service.bus.memory import MemoryBus
from service.bus.replicas import Replicas
from service.bus.stream import LiveMessages
from service.cell.answers import AlarmAnswers, AssetAnswers, PushAnswers, StreamAnswers, handlers_of
from service.cell.health import Health
from service.clock import ProcessClock
from service.documents.alarms import alarm_document
from service.features.commissioning import routes as commissioning
from service.features.notifications.part import Notifier
from service.ingest import Ingest, Spool
from service.security.keys import create_key
from service.security.limits import RateLimit
from service.site.settings import Settings
from service.store import Outbox, Store
from service.web.api import create_app
from service.web.api.context import ServiceContext
from service.web.cell import AskedCell, CellIngest
from service.web.overview import Overview

from .memory_site import MemoryJobs, MemoryQuestions, MemoryTwin

ROLES = ("viewer", "operator", "engineer", "admin", "gateway")
REMOTE = ("203.0.113.9", 50_000)


@dataclass
class World:
    """The application with everything around it, and a client for each role."""

    app: FastAPI
    context: ServiceContext
    alarm_answers: AlarmAnswers
    health: Health
    joint: MemoryBus
    ingest: Ingest
    clock: ProcessClock
    store: Store
    bus: LiveMessages
    alarms: AlarmBook
    bench: MemoryTwin
    rig: MemoryTwin
    sources: list[SourceHealth]
    data_dir: Path
    keys: dict[str, str] = field(default_factory=dict)
    clients: dict[str, httpx2.AsyncClient] = field(default_factory=dict)
    taken: list[Sample] = field(default_factory=list)

    def client(self, role: str | None = None, **options: Any) -> httpx2.AsyncClient:
        """A client from another machine, with the key of a role or with none."""
        name = f"{role} {options}"
        if name not in self.clients:
            options.setdefault("headers", {})
            if role is not None:
                options["headers"] |= {"X-API-Key": self.keys[role]}
            address = options.pop("address", REMOTE)
            base_url = options.pop("base_url", "http://bench.example:8080")
            transport = httpx2.ASGITransport(self.app, client=address, raise_app_exceptions=False)
            self.clients[name] = httpx2.AsyncClient(
                transport=transport, base_url=base_url, **options
            )
        return self.clients[name]

    def have(self, **changes: Any) -> None:
        """Go on with an application that leans on something else."""
        self.close_app()
        self.context = replace(self.context, **changes)
        self.app = create_app(self.context)
        self.stop_the_minute()

    def stop_the_minute(self) -> None:
        """Let no part of a caller's minute pass, however slow the machine is at its calls."""
        authenticator = self.app.state.authenticator
        for limit in ("failures", "logins", "strangers", "requests"):
            self.limit(limit, getattr(authenticator, limit).per_minute)

    def limit(self, name: str, per_minute: float) -> None:
        """Allow so many calls of a kind, in a minute that does not pass."""
        setattr(self.app.state.authenticator, name, RateLimit(per_minute, lambda: 0.0))

    async def report(self) -> None:
        """Have the cell report how it is now, which it otherwise does once a second."""
        await self.health.report()
        await self.health.report_metrics()
        for _ in range(5):
            await asyncio.sleep(0)

    def close_app(self) -> None:
        """Let the threads and processes of the application end."""
        self.app.state.turns.close()
        commissioning.close(self.app)

    def write(self, asset: str, channel: str, start_us: int, values: Sequence[float]) -> None:
        """Store one sample per second."""
        self.store.samples.write(
            [
                Sample(asset, channel, start_us + 1_000_000 * number, value, 192, start_us)
                for number, value in enumerate(values)
            ]
        )

    def raise_alarm(
        self, channel: str = "t_inner_ring_c", active: bool = True, latched: bool = False
    ) -> str:
        """Raise an alarm (or let it return) and give its id."""
        self.alarms.evaluate(
            AlarmCondition(
                asset="bench-1",
                kind="measured limit",
                channel=channel,
                level="warning",
                active=active,
                value=91.0 if active else 70.0,
                message=f"{channel} over its warning limit",
                priority=2,
                latched=latched,
            )
        )
        return next((a.id for a in self.alarms.active() if a.channel == channel), "")


@pytest.fixture(scope="session")
def empty_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a new store: making one costs more than most tests."""
    folder = tmp_path_factory.mktemp("empty")
    Store.open("", folder).close()
    return folder / "bearing-twin.db"


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for a cell and a store in the same process: a slow machine delays them as who asks."""
    monkeypatch.setattr("service.bus.replica.PATIENCE_S", 60.0)
    monkeypatch.setattr("service.bus.replicas.PATIENCE_S", 60.0)
    monkeypatch.setattr("service.security.authenticator.KNOWN_PATIENCE_S", 60.0)
    monkeypatch.setattr("service.security.authenticator.UNKNOWN_PATIENCE_S", 60.0)


@pytest.fixture
def settings() -> Settings:
    """The configuration of the world; a module that needs another one has its own."""
    return Settings()


@pytest.fixture
async def world(
    tmp_path: Path, empty_store: Path, settings: Settings, patient: None
) -> AsyncIterator[World]:
    shutil.copy(empty_store, tmp_path)
    clock = ProcessClock()
    joint, registry = MemoryBus(), CollectorRegistry()
    bus = LiveMessages(clock)
    taken: list[Sample] = []

    def take(batch: Batch) -> None:
        taken.extend(batch.samples)

    with Store.open("", tmp_path) as store, Outbox.open(tmp_path, store) as outbox:
        alarms = AlarmBook(
            outbox, clock, lambda alarm: bus.publish("alarm", alarm.asset, alarm_document(alarm))
        )
        notifier = Notifier(
            settings, store, outbox, clock, lambda asset: (asset, ""), alarms, Silencing, registry
        )
        ingest = Ingest(store, Spool.open(tmp_path, 16), clock, take, registry=registry)
        now_us = clock.now_us()
        wired = {
            "speed_rpm": "drive",
            "t_inner_ring_c": "pt100",
            "t_outer_ring_c": "pt100",
            "t_inner_ring_c.twin": "twin",
        }
        bench = MemoryTwin("bench-1", wired, now_us, store)
        rig = MemoryTwin("rig-2", {"t_inner_ring_c": "push", "ambient_c": "push"}, now_us, store)
        sources = [SourceHealth("pt100", "modbus-tcp", up=True, detail="answers at 10.1.2.3:5020")]
        twins = {"bench-1": bench, "rig-2": rig}
        jobs = MemoryJobs(store, clock)
        health = Health(joint, store, ingest, twins, registry, lambda: sources)
        alarm_answers = AlarmAnswers(alarms, outbox)
        pushes = PushAnswers(ingest, store, twins)
        handlers = {
            **handlers_of(AssetAnswers(twins), StreamAnswers(bus), pushes, alarm_answers),
            **notifier.handlers(),
            **answering(commands.Identifications)(jobs),
            **answering(commands.Presence)(health),
        }
        serving = asyncio.create_task(joint.serve(handlers))
        await asyncio.sleep(0)
        # Every call asks the cell: a test sees at once what it has changed.
        replicas = Replicas(joint, MemoryQuestions(twins), fresh_s=0.0)
        await replicas.load()
        reports = HealthReports(joint)
        fleet = Overview(replicas, bus)
        context = ServiceContext(
            settings=settings,
            clock=clock,
            store=store,
            outbox=outbox,
            bus=bus,
            ingest=CellIngest(joint),
            cell=AskedCell(joint, fresh_s=0.0),
            assets=replicas.assets,
            health=reports,
            fleet=fleet,
            refresh_summaries=lambda assets: replicas.refresh("summary", assets=assets),
        )
        world = World(
            app=create_app(context),
            context=context,
            alarm_answers=alarm_answers,
            health=health,
            joint=joint,
            ingest=ingest,
            clock=clock,
            store=store,
            bus=bus,
            alarms=alarms,
            bench=bench,
            rig=rig,
            sources=sources,
            data_dir=tmp_path,
            keys={role: create_key(store, role).text for role in ROLES},
            taken=taken,
        )
        world.stop_the_minute()
        ingesting = asyncio.create_task(ingest.run([]))
        watching = asyncio.create_task(fleet.run())
        hearing = asyncio.create_task(reports.run())
        await asyncio.sleep(0)
        await world.report()
        try:
            yield world
        finally:
            for client in world.clients.values():
                await client.aclose()
            world.close_app()
            running = ingesting, serving, watching, hearing
            for task in running:
                task.cancel()
            await asyncio.gather(*running, return_exceptions=True)
