"""A twin, its questions and jobs in memory, where the boundary of the web side is."""

import asyncio
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from site_files import asset_section

from adapters.samples import is_good
from service.bus.questions import how_answered
from service.clock import ProcessClock, rfc3339
from service.documents.assets import (
    AssetDocument,
    ChannelDocument,
    GreaseRenewed,
    NodeState,
    State,
)
from service.documents.envelope import EnvelopeDocument
from service.documents.fleet import FleetAsset
from service.documents.forecasts import LiveForecast, WhatIf
from service.documents.identification import JobDocument, WindowDocument, job_document
from service.documents.limits import Limits
from service.documents.machine import AssetFacts, Estimate, PointOfEstimate, PresentMachine
from service.documents.models import ModelDocument, model_document
from service.documents.profiles import StepLevel
from service.documents.tags import Snapshot, Tag
from service.documents.verdicts import VerdictDocument
from service.domain.channels import NODES, RING_SENSORS
from service.domain.errors import (
    ActivationRefusedError,
    JobConflictError,
    NotIdentifiedError,
    NotReadyError,
)
from service.domain.requests import IdentificationRequest, ProfileStep
from service.features.advice.documents import AdviceDocument
from service.features.runs.report.files import ReportFormat, report_file
from service.features.runs.runs import Run
from service.store import ActiveJobError, AuditEntry, Store
from service.store.forecast_records import IssuedContent, IssuedForecast
from service.web import api

QUANTILES = ("q025", "q25", "q50", "q75", "q975")
MINUTE_US = 60_000_000
EXAMPLES: dict[str, Any] = json.loads(Path(api.__file__).with_name("examples.json").read_text())
#: A machine of which nothing is known yet.
FLEET_ASSET = EXAMPLES["GET /api/v1/fleet"]["items"][0] | {
    "state": "unknown",
    "attention": "unknown",
    "now": "unknown",
    "reason": "the twin does not run",
    "missing": ["twin"],
    "unacknowledged": 0,
    **dict.fromkeys(("limit", "channel", "value_c", "value_at", "alarm", "group")),
}
LIMITS = {"t_inner_ring_c": Limits(warning=90, alarm=105)}


def example(part: str) -> dict[str, Any]:
    """What the description of a route of an asset shows as its answer."""
    answer: dict[str, Any] = EXAMPLES[f"GET /api/v1/assets/{{asset_id}}{part}"]
    return answer


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
        point = PointOfEstimate(speed_rpm=1000.0, load_n=2000.0, ambient_c=23.0, inputs=())
        estimate = Estimate(machine={}, point=point, time_us=self.time_us)
        return PresentMachine(
            version=1,
            estimate=estimate if self.ready else None,
            planned=[],
            missing=self.blind,
            measured_c={},
        )

    def summary(self) -> AssetDocument:
        channels = [
            ChannelDocument(name=name, source=source, unit="°C", reason=None, max_age_s=60.0)
            for name, source in self.channels.items()
        ]
        changes = {"id": self.id, "limits": LIMITS, "channels": channels, "controller": None}
        return AssetDocument.model_validate(example("") | changes)

    def snapshot(self) -> Snapshot:
        return {"tags": self.tags}

    def channels_without_good_data(self) -> list[str]:
        return sorted(name for name, tag in self.tags.items() if not is_good(tag["quality"]))

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
        unknown = {"word": "unknown", "reasons": ["the twin does not run"]} | dict.fromkeys(
            ("limit", "probability", "seconds_to_limit", "alarm_probability")
        )
        return VerdictDocument.model_validate(
            {
                "time": rfc3339(self.time_us),
                "now": unknown,
                "present_step": unknown | {"ends_at": None},
                "next_step": unknown,
                "time_to_limit": None,
                "missing": ["twin"],
            }
        )

    def forecast(self) -> LiveForecast | None:
        return self.live_forecast

    def asset_summary(self) -> FleetAsset:
        return FleetAsset.model_validate(FLEET_ASSET | {"id": self.id}).model_copy(
            update=self.at_a_glance
        )

    def what_if(
        self, profile: Sequence[ProfileStep], step_s: float | None, nodes: Collection[str] | None
    ) -> WhatIf:
        total_s = sum(step.duration_s for step in profile)
        step_s = step_s or 60.0
        time_s = [step_s * row for row in range(int(total_s // step_s) + 1)]
        names = nodes or RING_SENSORS + NODES
        answer: dict[str, Any] = EXAMPLES["POST /api/v1/assets/{asset_id}/forecasts"] | {
            "time_s": time_s,
            "nodes": {name: dict.fromkeys(QUANTILES, [60.0] * len(time_s)) for name in names},
            "whole_run": {"level": 0.9, "factors": {}},
            "limits": LIMITS,
            "model_version": 1,
            "profile": [{"ambient_c": 23.0} | one.model_dump(exclude_none=True) for one in profile],
        }
        del answer["kept_at"]
        return WhatIf.model_validate(answer)

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

    async def answer(
        self,
        question: Callable[..., Any],
        asset: str,
        machine: PresentMachine | None,
        *arguments: Any,
    ) -> Any:
        about = (asset,) if how_answered(question).of_store else (asset, machine)
        return await getattr(self, question.__name__)(*about, *arguments)

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
        answer = example("/envelope")
        changes = {
            "made_at": rfc3339(self.twins[asset].time_us),
            "model_version": 1,
            "runaway": answer["runaway"] | {"probability": [[float("inf")]]},
        }
        return EnvelopeDocument.model_validate(answer | changes)

    async def advice(
        self,
        asset: str,
        machine: PresentMachine,
        speed_rpm: float,
        load_n: float,
        duration_s: float,
        half_width_k: float | None,
    ) -> AdviceDocument:
        if not self.twins[asset].identified:
            raise NotIdentifiedError("no identified model yet")
        answer = example("/advice")
        target = {"speed_rpm": speed_rpm, "load_n": load_n, "duration_s": duration_s}
        asked = answer["next_step"] | {"asked_half_width_k": half_width_k}
        changes = {"target": answer["target"] | target, "next_step": asked}
        return AdviceDocument.model_validate(answer | changes)

    async def report(
        self, asset: str, run: Run, format: ReportFormat, now_us: int, time_zone: str
    ) -> bytes:
        section = asset_section(asset, ["speed_rpm"])
        store = self.twins[asset].store
        return await asyncio.to_thread(report_file, store, section, run, format, now_us, time_zone)

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
