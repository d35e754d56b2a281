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
from service.bus.replicas import Replicas
from service.bus.stream import Bus
from service.cell.answers import Answers, Parts
from service.clock import ProcessClock, rfc3339
from service.documents.advice import AdviceDocument, Steady, StopRule, Target
from service.documents.alarms import alarm_document, alarm_summary
from service.documents.assets import (
    ActiveModel,
    AssetDocument,
    ChannelDocument,
    GreaseRenewed,
    HealthOfAsset,
    IdentificationSettings,
    NodeState,
    State,
    VerdictSettings,
)
from service.documents.envelope import EnvelopeDocument, PresentPoint, RunawayMap
from service.documents.fleet import FleetAsset
from service.documents.forecasts import LiveForecast, Quantiles, WhatIf, WholeRun
from service.documents.identification import JobDocument, WindowDocument, job_document
from service.documents.limits import Crossing, Limits, LowRisk
from service.documents.machine import AssetFacts, Estimate, Point, PresentMachine
from service.documents.models import ModelDocument, model_document
from service.documents.profiles import ForecastStep, StepLevel
from service.documents.tags import Snapshot, Tag
from service.documents.verdicts import VerdictDocument, VerdictOf
from service.domain.channels import NODES, RING_SENSORS
from service.domain.errors import (
    ActivationRefusedError,
    JobConflictError,
    NotIdentifiedError,
    NotReadyError,
)
from service.domain.requests import IdentificationRequest, ProfileStep
from service.ingest import Ingest, Spool
from service.notifications.notifier import Notifier
from service.reports.files import ReportFormat, report_file
from service.security.keys import create_key
from service.site.asset_section import AssetSection
from service.site.settings import Settings
from service.store import ActiveJobError, AuditEntry, Outbox, Run, Store
from service.store.forecast_records import IssuedContent, IssuedForecast
from service.web.api import create_app
from service.web.api.context import ServiceContext
from service.web.cell import CellAlarms, CellHealth, CellIngest, CellJobs, CellNotifications, Shared
from service.web.overview import Overview

ROLES = ("viewer", "operator", "engineer", "admin", "gateway")
REMOTE = ("203.0.113.9", 50_000)
QUANTILES = ("q025", "q25", "q50", "q75", "q975")
MINUTE_US = 60_000_000
LIMITS = {"t_inner_ring_c": Limits(warning=90, alarm=105)}


def tag(value: float | None, unit: str, time_us: int, quality: int = 192) -> Tag:
    return {"value": value, "unit": unit, "quality": quality, "time": rfc3339(time_us)}


class MemoryTwin:
    """A twin that stands at one temperature and forecasts it to stay."""

    make_number = 1

    def __init__(
        self, asset_id: str, channels: Mapping[str, str], time_us: int, store: Store
    ) -> None:
        self.id = asset_id
        self.store = store
        self.running = True
        self.temperature_names = RING_SENSORS + NODES
        self.channels = channels
        self.time_us = time_us
        self.ready = True
        self.blind: list[str] = []
        self.identified = True
        self.live_forecast: LiveForecast | None = None
        self.looks = 0
        self.at_a_glance: dict[str, object] = {}
        self.tags = {
            name: tag(60.0, "°C", time_us) for name in channels if not name.endswith(".twin")
        }
        self.asked: list[tuple[float, str]] = []
        self.documents = self

    def description(self) -> AssetFacts:
        return AssetFacts(
            running=self.running,
            channels=dict(self.channels),
            temperature_names=list(self.temperature_names),
        )

    def look(self) -> None:
        self.looks += 1

    def machine(self) -> PresentMachine:
        point = Point(speed_rpm=1000.0, load_n=2000.0, ambient_c=23.0, inputs=())
        estimate = Estimate(machine={}, point=point, time_us=self.time_us)
        return PresentMachine(
            version=1,
            estimate=estimate if self.ready else None,
            planned=[],
            missing=self.blind,
            measured_c={},
        )

    def summary(self) -> AssetDocument:
        return AssetDocument(
            id=self.id,
            name=self.id,
            group=None,
            family=None,
            bearing="6311",
            network="bearing-14",
            clock_rate=1.0,
            low_risk=LowRisk(speed_rpm_max=4300, load_n_max=3000),
            limits=LIMITS,
            channels=[
                ChannelDocument(name=name, source=source, unit="°C", reason=None, max_age_s=60.0)
                for name, source in self.channels.items()
            ],
            alarms=alarm_summary([]),
            ambient_assumed_c=None,
            verdict=VerdictSettings(safe_below_probability=0.05),
            health=HealthOfAsset(status="good", twin_running=True, channels_without_good_data=[]),
            active_model=ActiveModel(
                version=1, model="bearing-14", trusted=True, identified=False, identified_at=None
            ),
            identification=IdentificationSettings(ladder="apply"),
            controller=None,
        )

    def snapshot(self) -> Snapshot:
        return {"tags": self.tags}

    def state(self) -> State:
        node = NodeState(mean_c=60.0, std_c=float("nan"), known=False, reason="no estimate yet")
        return State(
            time=rfc3339(self.time_us),
            model_version=1,
            revolutions=0,
            nodes=dict.fromkeys(NODES, node),
            missing=[],
        )

    def verdict(self) -> VerdictDocument:
        unknown = VerdictOf(
            word="unknown",
            reasons=["the twin does not run"],
            limit=None,
            probability=None,
            seconds_to_limit=None,
            alarm_probability=None,
        )
        return VerdictDocument(
            time=rfc3339(self.time_us),
            now=unknown,
            next_step=unknown,
            time_to_limit=None,
            missing=["twin"],
        )

    def forecast(self) -> LiveForecast | None:
        return self.live_forecast

    def glance(self) -> FleetAsset:
        return FleetAsset(
            id=self.id,
            name=self.id,
            group=None,
            family=None,
            bearing="6311",
            network="bearing-14",
            state="unknown",
            attention="unknown",
            now="unknown",
            next_step="unknown",
            reason="the twin does not run",
            missing=["twin"],
            limit=None,
            seconds_to_limit=None,
            probability=None,
            channel=None,
            value_c=None,
            value_at=None,
            unacknowledged=0,
            alarm=None,
            model_version=1,
            trusted=True,
            identified=False,
            drifted=False,
        ).model_copy(update=self.at_a_glance)

    def what_if(
        self, profile: Sequence[ProfileStep], step_s: float | None, nodes: Collection[str] | None
    ) -> WhatIf:
        total_s = sum(step.duration_s for step in profile)
        step_s = step_s or 60.0
        time_s = [step_s * row for row in range(int(total_s // step_s) + 1)]
        crossing = Crossing(probability=0.0, median_s=None, earliest_s=None)
        return WhatIf(
            time_s=time_s,
            nodes={
                name: Quantiles(**dict.fromkeys(QUANTILES, [60.0] * len(time_s)))
                for name in nodes or RING_SENSORS + NODES
            },
            whole_run=WholeRun(level=0.9, factors={}),
            limits=LIMITS,
            not_known={},
            time_to_limit={"t_inner_ring_c": {"warning": crossing, "alarm": crossing}},
            labels=[],
            runaway_probability=0.0,
            model_version=1,
            profile=[
                ForecastStep(
                    duration_s=step.duration_s,
                    speed_rpm=step.speed_rpm,
                    load_n=step.load_n,
                    ambient_c=23.0,
                )
                for step in profile
            ],
            missing=[],
        )

    async def renew_grease(
        self, who: str, comment: str, audit: AuditEntry | None = None
    ) -> GreaseRenewed:
        if not self.ready:
            raise NotReadyError("the twin waits for its first data")
        self.store.states.save(self.id, {}, [audit] if audit else [])
        return GreaseRenewed(time=rfc3339(self.time_us), revolutions_before=1000, revolutions=0)


class MemoryQuestions:
    """Answers that need no computing."""

    def __init__(self, twins: Mapping[str, MemoryTwin]) -> None:
        self.twins = twins

    async def what_if(
        self,
        asset: str,
        machine: PresentMachine,
        profile: Sequence[ProfileStep],
        step_s: float | None,
        nodes: Collection[str] | None,
    ) -> WhatIf:
        return self.twins[asset].what_if(profile, step_s, nodes)

    async def what_if_to_keep(
        self,
        asset: str,
        machine: PresentMachine,
        profile: Sequence[ProfileStep],
        step_s: float | None,
        nodes: Collection[str] | None,
    ) -> tuple[WhatIf, IssuedForecast | None]:
        content = IssuedContent(
            steps=[(one.duration_s, one.speed_rpm, one.load_n, 23.0) for one in profile],
            planned=False,
            labels=[],
            channels=list(RING_SENSORS),
            lead_times_s=[300],
            high_risk=[False],
            quantiles=[[[6000] * 5] * 2],
            naive={},
        )
        time_us = self.twins[asset].time_us
        issued = IssuedForecast(asset, time_us, machine.version, "asked", content)
        return self.twins[asset].what_if(profile, step_s, nodes), issued

    async def envelope(self, asset: str, machine: PresentMachine) -> EnvelopeDocument:
        return EnvelopeDocument(
            made_at=rfc3339(self.twins[asset].time_us),
            model_version=1,
            ambient_c=23.0,
            horizon_s=28_800.0,
            members=80,
            speed_rpm=[1000.0],
            load_n=[2000.0],
            sensors={},
            runaway=RunawayMap(
                probability=[[float("inf")]],
                not_excluded=[[False]],
                loop_gain=[[0.1]],
                loop_gain_upper=[[None]],
                margin_k=[[60.0]],
                margin_n=[[None]],
            ),
            low_risk=LowRisk(speed_rpm_max=4300, load_n_max=3000),
            labels=[],
            present=PresentPoint(speed_rpm=1000.0, load_n=2000.0, measured_c={}, over_limit={}),
        )

    async def advice(
        self, asset: str, machine: PresentMachine, target: tuple[float, float, float]
    ) -> AdviceDocument:
        if not self.twins[asset].identified:
            raise NotIdentifiedError("no identified model yet")
        speed_rpm, load_n, duration_s = target
        return AdviceDocument(
            made_at=rfc3339(self.twins[asset].time_us),
            model_version=1,
            target=Target(
                speed_rpm=speed_rpm,
                load_n=load_n,
                duration_s=duration_s,
                inside_low_risk=False,
                sensor="t_inner_ring_c",
                sensors={},
                labels=[],
            ),
            worth_while=False,
            steps=[],
            excluded=[],
            stop_rule=StopRule(
                rules=[],
                largest_ratio=1.25,
                hold_at_least_s=1800,
                steady=Steady(change_k=0.2, within_s=600),
                levels=[],
            ),
        )

    async def report(self, asset: str, run: Run, format: ReportFormat, now_us: int) -> bytes:
        section = AssetSection.model_validate(
            {
                "id": asset,
                "bearing": "6311",
                "low_risk": {"speed_rpm_max": 4300, "load_n_max": 3000},
                "channels": {"speed_rpm": {"source": "push"}},
            }
        )
        store = self.twins[asset].store
        return await asyncio.to_thread(report_file, store, section, run, format, now_us)

    async def windows(self, asset: str) -> Sequence[WindowDocument]:
        time_us = self.twins[asset].time_us
        return [
            WindowDocument(
                start=rfc3339(time_us - 60 * MINUTE_US),
                end=rfc3339(time_us),
                speed_rpm_max=1500.0,
                load_n_max=2650.0,
                operating_points=[StepLevel(speed_rpm=1500.0, load_n=2650.0, duration_s=3600.0)],
                score=1.5,
            )
        ]


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
        audit: AuditEntry | None = None,
    ) -> tuple[JobDocument, bool]:
        try:
            job, created = self._store.jobs.add(
                asset_id,
                request.model_dump(mode="json")
                | {"who": who}
                | ({"windows": []} if request.windows == "auto" else {}),
                self._clock.now_us(),
                idempotency_key,
                audit,
            )
        except ActiveJobError as error:
            in_the_way = self._store.jobs.get(error.job_id)
            assert in_the_way is not None
            raise JobConflictError("a job is under way", job_document(in_the_way)) from error
        return job_document(job), created

    async def job(self, asset_id: str, job_id: str) -> JobDocument | None:
        job = self._store.jobs.get(job_id)
        return job_document(job) if job and job.asset == asset_id else None

    async def jobs(self, asset_id: str) -> Sequence[JobDocument]:
        return [job_document(job) for job in self._store.jobs.of_asset(asset_id)]

    async def cancel(
        self, asset_id: str, job_id: str, audit: AuditEntry | None = None
    ) -> JobDocument | None:
        self._store.jobs.update(job_id, status="cancelled", line=audit)
        return await self.job(asset_id, job_id)

    async def activate(
        self,
        asset_id: str,
        version: int,
        who: str,
        comment: str | None,
        force: bool,
        audit: AuditEntry | None = None,
    ) -> ModelDocument:
        wanted = self._store.models.version(asset_id, version)
        if wanted is None:
            raise KeyError(version)
        if wanted.status == "rejected" and not (force and comment):
            raise ActivationRefusedError(f"version {version} was rejected: {wanted.reason}")
        active = self._store.models.activate(
            asset_id, version, who, comment or "", self._clock.now_us(), audit
        )
        return model_document(active)


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
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for a cell in the same process: a slow machine delays it as long as who asks."""
    monkeypatch.setattr("service.bus.replica.PATIENCE_S", 60.0)
    monkeypatch.setattr("service.bus.replicas.PATIENCE_S", 60.0)


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
    bus = Bus(clock)
    taken: list[Sample] = []

    def take(batch: Batch) -> None:
        taken.extend(batch.samples)

    with Store.open("", tmp_path) as store, Outbox.open(tmp_path, store) as outbox:
        alarms = AlarmBook(
            outbox, clock, lambda alarm: bus.publish("alarm", alarm.asset, alarm_document(alarm))
        )
        notifier = Notifier(settings, store, outbox, clock, lambda asset: (asset, ""), registry)
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
        answers = Answers(
            Parts(
                clock=clock,
                store=store,
                outbox=outbox,
                stream=bus,
                ingest=ingest,
                alarms=alarms,
                notifier=notifier,
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
        fleet = Overview(replicas, bus)
        context = ServiceContext(
            settings=settings,
            clock=clock,
            store=store,
            outbox=outbox,
            bus=bus,
            ingest=CellIngest(joint),
            alarms=CellAlarms(joint, shared),
            notifications=CellNotifications(joint, shared),
            assets=replicas.assets,
            jobs=CellJobs(joint, shared),
            health=CellHealth(shared),
            fleet=fleet,
            refresh_summaries=lambda assets: replicas.refresh("summary", assets=assets),
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
        watching = asyncio.create_task(fleet.run())
        try:
            yield world
        finally:
            for client in world.clients.values():
                await client.aclose()
            running = ingesting, serving, watching
            for task in running:
                task.cancel()
            await asyncio.gather(*running, return_exceptions=True)
