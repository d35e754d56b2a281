"""An application on a real store, bus, alarm book and ingest, and the cell's answers to it.

The twin and the job manager are the boundary of the web side: small in-memory ones stand there.
"""

import asyncio
import shutil
from collections.abc import AsyncIterator, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2
import pytest
from fastapi import FastAPI
from prometheus_client import CollectorRegistry

from adapters.protocol import SourceHealth
from adapters.samples import Batch, Sample
from service.alarms import AlarmBook, AlarmCondition
from service.bus.memory import MemoryBus
from service.bus.replica import Replicas
from service.bus.stream import Bus
from service.cell.answers import Answers, Parts
from service.clock import ProcessClock, rfc3339
from service.documents.alarms import alarm_document
from service.domain.channels import NODES, RING_SENSORS
from service.domain.errors import (
    ActivationRefusedError,
    JobConflictError,
    NotIdentifiedError,
    NotReadyError,
)
from service.domain.requests import IdentificationRequest, ProfileStep
from service.ingest import Ingest, Spool
from service.security import create_key
from service.site.settings import Settings
from service.store import ActiveJobError, Job, ModelVersion, Outbox, Store
from service.web.api import create_app
from service.web.api.context import ServiceContext
from service.web.cell import CellAlarms, CellHealth, CellIngest, CellJobs, Shared

ROLES = ("viewer", "operator", "engineer", "admin", "gateway")
REMOTE = ("203.0.113.9", 50_000)
QUANTILES = ("q025", "q25", "q50", "q75", "q975")
MINUTE_US = 60_000_000


def tag(value: float | None, unit: str, time_us: int, quality: int = 192) -> dict[str, Any]:
    return {"value": value, "unit": unit, "quality": quality, "time": rfc3339(time_us)}


class MemoryTwin:
    """A twin that stands at one temperature and forecasts it to stay."""

    def __init__(self, asset_id: str, channels: Mapping[str, str], time_us: int) -> None:
        self.id = asset_id
        self.running = True
        self.temperature_names = RING_SENSORS + NODES
        self.channels = channels
        self.time_us = time_us
        self.ready = True
        self.identified = True
        self.live_forecast: dict[str, Any] | None = None
        self.tags = {
            name: tag(60.0, "°C", time_us) for name in channels if not name.endswith(".twin")
        }
        self.asked: list[tuple[float, str]] = []

    def description(self) -> Mapping[str, Any]:
        return {
            "running": self.running,
            "channels": dict(self.channels),
            "temperature_names": self.temperature_names,
        }

    def machine(self) -> Mapping[str, Any]:
        return {"version": 1, "estimate": {} if self.ready else None, "missing": []}

    def summary(self) -> Mapping[str, Any]:
        return {
            "id": self.id,
            "name": self.id,
            "group": None,
            "bearing": "6311",
            "network": "bearing-14",
            "low_risk": {"speed_rpm_max": 4300, "load_n_max": 3000},
            "limits": {"t_inner_ring_c": {"warning": 90, "alarm": 105}},
            "channels": [{"name": n, "source": s} for n, s in self.channels.items()],
            "health": {"status": "good"},
            "active_model": {"version": 1, "trusted": True, "identified_at": None},
            "controller": None,
        }

    def snapshot(self) -> Mapping[str, Any]:
        return {"tags": self.tags}

    def state(self) -> Mapping[str, Any]:
        nodes = {name: {"mean_c": 60.0, "std_c": float("nan")} for name in NODES}
        return {"time": rfc3339(self.time_us), "model_version": 1, "nodes": nodes}

    def verdict(self) -> Mapping[str, Any]:
        unknown = {"word": "unknown", "reasons": ["the twin does not run"], "limit": None}
        unknown |= {"probability": None, "seconds_to_limit": None, "alarm_probability": None}
        return {
            "time": rfc3339(self.time_us),
            "now": unknown,
            "next_step": unknown,
            "time_to_limit": None,
            "missing": ["twin"],
        }

    def forecast(self) -> Mapping[str, Any] | None:
        return self.live_forecast

    def what_if(
        self, profile: Sequence[ProfileStep], step_s: float | None, nodes: Collection[str] | None
    ) -> Mapping[str, Any]:
        total_s = sum(step.duration_s for step in profile)
        step_s = step_s or 60.0
        time_s = [step_s * row for row in range(int(total_s // step_s) + 1)]
        crossing = {"probability": 0.0, "median_s": None, "earliest_s": None}
        return {
            "time_s": time_s,
            "nodes": {
                name: {quantile: [60.0] * len(time_s) for quantile in QUANTILES}
                for name in nodes or RING_SENSORS + NODES
            },
            "limits": {"t_inner_ring_c": {"warning": 90, "alarm": 105}},
            "time_to_limit": {"t_inner_ring_c": {"warning": crossing, "alarm": crossing}},
        }

    async def renew_grease(self, who: str, comment: str) -> Mapping[str, Any]:
        if not self.ready:
            raise NotReadyError("the twin waits for its first data")
        return {"time": rfc3339(self.time_us), "revolutions_before": 1000, "revolutions": 0}


class MemoryQuestions:
    """Answers that need no computing."""

    def __init__(self, twins: Mapping[str, MemoryTwin]) -> None:
        self.twins = twins

    async def what_if(
        self,
        asset: str,
        machine: Mapping[str, Any],
        profile: Sequence[ProfileStep],
        step_s: float | None,
        nodes: Collection[str] | None,
    ) -> Mapping[str, Any]:
        return self.twins[asset].what_if(profile, step_s, nodes)

    async def envelope(self, asset: str, machine: Mapping[str, Any]) -> Mapping[str, Any]:
        made_at = rfc3339(self.twins[asset].time_us)
        return {"made_at": made_at, "labels": [], "median_s": float("inf")}

    async def advice(
        self, asset: str, machine: Mapping[str, Any], target: tuple[float, float, float]
    ) -> Mapping[str, Any]:
        if not self.twins[asset].identified:
            raise NotIdentifiedError("no identified model yet")
        names = ("speed_rpm", "load_n", "duration_s")
        return {"target": dict(zip(names, target, strict=True)), "steps": []}

    async def windows(self, asset: str) -> Sequence[Mapping[str, Any]]:
        time_us = self.twins[asset].time_us
        return [
            {
                "start": rfc3339(time_us - 60 * MINUTE_US),
                "end": rfc3339(time_us),
                "score": 1.5,
                "operating_points": [{"speed_rpm": 1500.0, "load_n": 2650.0, "duration_s": 3600.0}],
            }
        ]


def job_document(job: Job) -> dict[str, Any]:
    return {
        "id": job.id,
        "status": job.status,
        "progress": job.progress,
        "best_fitness": job.best_fitness,
        "evaluations": job.evaluations,
        "created_at": rfc3339(job.created_at_us),
        "started_at": None,
        "ended_at": None,
        "error": job.error,
        "model_version": job.model_version,
        "request": job.request,
    }


class MemoryJobs:
    """Jobs that stay queued until they are cancelled; rows in the real store."""

    def __init__(self, store: Store, clock: ProcessClock) -> None:
        self._store = store
        self._clock = clock

    async def create(
        self,
        asset_id: str,
        request: IdentificationRequest,
        idempotency_key: str | None,
        who: str,
    ) -> tuple[Mapping[str, Any], bool]:
        try:
            job, created = self._store.jobs.add(
                asset_id,
                request.model_dump(mode="json") | {"who": who},
                self._clock.now_us(),
                idempotency_key,
            )
        except ActiveJobError as error:
            in_the_way = self._store.jobs.get(error.job_id)
            assert in_the_way is not None
            raise JobConflictError(job_document(in_the_way)) from error
        return job_document(job), created

    async def job(self, asset_id: str, job_id: str) -> Mapping[str, Any] | None:
        job = self._store.jobs.get(job_id)
        return job_document(job) if job and job.asset == asset_id else None

    async def jobs(self, asset_id: str) -> Sequence[Mapping[str, Any]]:
        return [job_document(job) for job in self._store.jobs.of_asset(asset_id)]

    async def cancel(self, asset_id: str, job_id: str) -> Mapping[str, Any] | None:
        self._store.jobs.update(job_id, status="cancelled")
        return await self.job(asset_id, job_id)

    async def activate(
        self, asset_id: str, version: int, who: str, comment: str | None, force: bool
    ) -> Mapping[str, Any]:
        wanted = self._store.models.version(asset_id, version)
        if wanted is None:
            raise KeyError(version)
        if wanted.status == "rejected" and not (force and comment):
            raise ActivationRefusedError(f"version {version} was rejected: {wanted.reason}")
        active = self._store.models.activate(
            asset_id, version, who, comment or "", self._clock.now_us()
        )
        return model_document(active)


def model_document(model: ModelVersion) -> dict[str, Any]:
    named = {name: model.document[name] for name in ("parameters", "windows", "scores", "naive")}
    return {"version": model.version, "status": model.status, "reason": model.reason} | named


@dataclass
class World:
    """The application with everything around it, and a client for each role."""

    app: FastAPI
    context: ServiceContext
    answers: Answers
    ingest: Ingest
    clock: ProcessClock
    store: Store
    bus: Bus
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
async def world(tmp_path: Path, empty_store: Path) -> AsyncIterator[World]:
    shutil.copy(empty_store, tmp_path)
    clock = ProcessClock()
    settings = Settings()
    joint, registry = MemoryBus(), CollectorRegistry()
    bus = Bus(clock)
    taken: list[Sample] = []

    def take(batch: Batch) -> None:
        taken.extend(batch.samples)

    with Store.open("", tmp_path) as store, Outbox.open(tmp_path, store) as outbox:
        alarms = AlarmBook(
            outbox, clock, lambda alarm: bus.publish("alarm", alarm.asset, alarm_document(alarm))
        )
        ingest = Ingest(store, Spool.open(tmp_path, 16), clock, take, registry=registry)
        now_us = clock.now_us()
        wired = {
            "speed_rpm": "drive",
            "t_inner_ring_c": "pt100",
            "t_outer_ring_c": "pt100",
            "t_inner_ring_c.twin": "twin",
        }
        bench = MemoryTwin("bench-1", wired, now_us)
        rig = MemoryTwin("rig-2", {"t_inner_ring_c": "push", "ambient_c": "push"}, now_us)
        sources = [SourceHealth("pt100", "modbus-tcp", up=True, detail="answers at 10.1.2.3:5020")]
        twins = {"bench-1": bench, "rig-2": rig}
        jobs = MemoryJobs(store, clock)
        answers = Answers(
            Parts(
                clock=clock,
                store=store,
                outbox=outbox,
                stream=bus,
                ingest=ingest,
                alarms=alarms,
                assets=twins,
                jobs=jobs,
                registry=registry,
                sources=lambda: sources,
            )
        )
        serving = asyncio.create_task(joint.serve(answers.handlers()))
        await asyncio.sleep(0)
        # Every call asks the cell: a test sees at once what it has changed.
        replicas = Replicas(joint, MemoryQuestions(twins), fresh_s=0.0)
        await replicas.load()
        shared = Shared(joint, fresh_s=0.0)
        context = ServiceContext(
            settings=settings,
            clock=clock,
            store=store,
            outbox=outbox,
            bus=bus,
            ingest=CellIngest(joint),
            alarms=CellAlarms(joint, shared),
            assets=replicas.assets,
            jobs=CellJobs(joint, shared),
            health=CellHealth(shared),
            refresh_summaries=lambda: replicas.refresh("summary"),
        )
        world = World(
            app=create_app(context),
            context=context,
            answers=answers,
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
        ingesting = asyncio.create_task(ingest.run([]))
        try:
            yield world
        finally:
            for client in world.clients.values():
                await client.aclose()
            ingesting.cancel()
            serving.cancel()
            await asyncio.gather(ingesting, serving, return_exceptions=True)
