"""Follows the demo over REST like any other client: reports what happens, keeps what is scored."""

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import TypeVar, cast

import httpx2
import numpy as np
from pydantic import TypeAdapter

from adapters.virtual_bench import Scenario
from service.alarms import SET_ASIDE_STATES
from service.clock import from_rfc3339, rfc3339
from service.demo.asking import ask
from service.demo.configuration import ASSET
from service.demo.processes import DemoError
from service.demo.score import (
    SENSORS,
    Account,
    MeasuredMinutes,
    Performance,
    ScoredForecast,
    Stage,
    VersionAccount,
    WarningAccount,
    ended,
    kept_account,
    made_before,
    stage_account,
)
from service.documents.alarms import AlarmJournalLine, AlarmJournalList, AlarmList
from service.documents.assets import AssetDocument
from service.documents.forecasts import LiveForecast
from service.documents.identification import JobList
from service.documents.limits import Limits
from service.documents.measurements import BucketItem, Measurements, SampleItem
from service.documents.models import ModelDocument, ModelList
from service.documents.tags import Snapshot, Tag
from service.domain.channels import AMBIENT, CONTROLLER_CHANNELS, LOAD, RING_SENSORS, SPEED

LOOK_EVERY_WALL_S = 0.4
READY_WALL_S = 600.0
#: A low-risk stage that brings nothing new begins no job within so many wall seconds: the service
#: looks for new windows once a second, and a busy machine takes its time.
NO_JOB_WALL_S = 6.0
#: The longest wait before a high-risk stage: a service that never identifies must not end the demo.
HOLD_WALL_S = 600.0
MODBUS_CHANNELS = (*RING_SENSORS, AMBIENT, *CONTROLLER_CHANNELS)
CAN_CHANNELS = (SPEED, LOAD)
MINUTE_US = 60_000_000
# A load cell that reads a little less has seen the load, too.
_SEEN = 0.95

Answer = TypeVar("Answer")


class Story:
    """One run of the demo, seen through the service's REST interface.

    - ``hold``: sets whether the bench waits before a high-risk stage; without it the bench never
      waits.
    - ``sisters``: from how many sisters that have run all stages the bench is to have learned
      before its first high-risk stage begins.
    """

    def __init__(
        self,
        client: httpx2.AsyncClient,
        scenario: Scenario,
        report: Callable[[str], None],
        hold: Callable[[bool], Awaitable[None]] | None = None,
        asset: str = ASSET,
        sisters: int = 0,
    ) -> None:
        self._asset, self._path = asset, f"/api/v1/assets/{asset}"
        self._sisters = sisters
        self._client = client
        self._scenario = scenario
        self._report = report
        self._hold = hold
        self._held: bool | None = None
        self._waits_since_wall_s: float | None = None
        self._forecasts: list[ScoredForecast] = []
        # The last one that the bench made without its sisters, while it waited for them.
        self._alone: ScoredForecast | None = None
        self._stages: list[Stage] = []
        # Models, jobs and alarms that were reported: what they are, and which.
        self._reported: set[tuple[str, str | int]] = set()
        self.complete = False

    async def ready(self) -> None:
        """Wait until the service follows the machine.

        Raises `DemoError` if it does not within ten minutes.
        """
        deadline = time.monotonic() + READY_WALL_S
        while time.monotonic() < deadline:
            asset = await self._get(self._path, AssetDocument)
            if asset.health.twin_running:
                return
            await asyncio.sleep(0.1)
        raise DemoError(f"the twin did not start within {READY_WALL_S:g} s")

    async def follow(self) -> None:
        """Watch until the scenario is over."""
        last_phase = len(self._scenario.steps)
        while True:
            phase = await self._look()
            if phase is not None and phase > last_phase:
                self.complete = True
                return
            await asyncio.sleep(LOOK_EVERY_WALL_S)

    async def _look(self) -> int | None:
        tags = (await self._get(f"{self._path}/snapshot", Snapshot))["tags"]
        await self._keep_forecast()
        await self._report_models_and_jobs()
        await self._report_alarms()
        await self._hold_bench(tags)
        if tags["phase"]["value"] is None:
            return None
        phase = int(tags["phase"]["value"])
        if phase != self._phase():
            await self._enter(phase, tags)
        return phase

    async def _hold_bench(self, tags: Mapping[str, Tag]) -> None:
        """Let no high-risk stage begin before the twin has learned from the stages before it.

        The bench is released only while it waits with such a stage, one stage at a time: a clock
        that runs fast leaves no time to stop it after a look.
        """
        if self._hold is None:
            return
        holds = True
        if not self._waits(tags):
            self._waits_since_wall_s = None
        elif self._waits_since_wall_s is None:
            self._waits_since_wall_s = time.monotonic()
            self._report("The bench waits with the next stage until its forecast is there.")
        else:
            waited_s = time.monotonic() - self._waits_since_wall_s
            holds = not await self._is_forecast(tags, waited_s) and waited_s <= HOLD_WALL_S
        if holds != self._held:
            await self._hold(holds)
            self._held = holds

    async def _is_forecast(self, tags: Mapping[str, Tag], waited_s: float) -> bool:
        """Whether the next stage is forecast by a version that has learned from the one before."""
        jobs = (await self._get(f"{self._path}/identifications", JobList)).items
        models = (await self._get(f"{self._path}/models", ModelList)).items
        active = [model for model in models if model.status == "active"]
        forecast = self._forecasts[-1] if self._forecasts else None
        if forecast is None or not any(forecast.model_version == one.version for one in active):
            return False
        step = self._scenario.steps[self._phase()]
        if forecast.time_us[-1] < from_rfc3339(tags["phase"]["time"] or "") + 1e6 * step.duration_s:
            return False
        if self._sisters and not any(self._has_learned(model) for model in active):
            return False
        if self._stages[-1].risk != "low":
            return bool(jobs)
        # While the bench waits it goes on at its point, and each new window begins another job:
        # one that began after the stage has seen all of it.
        before = self._scenario.steps[self._phase() - 1]
        over_us = self._stages[-1].start_us + 1e6 * before.duration_s
        later = [job for job in jobs if from_rfc3339(job.created_at) >= over_us]
        is_idle = bool(jobs) and all(job.ended_at for job in jobs)
        return any(job.ended_at for job in later) or (is_idle and waited_s > NO_JOB_WALL_S)

    def _has_learned(self, model: ModelDocument) -> bool:
        """Whether the sisters of a version have seen the heaviest stage; keeps the last without."""
        sisters = model.sisters
        heaviest_n = max(step.load_n for step in self._scenario.steps)
        if sisters is None or not sisters.accepted:
            self._alone = self._forecasts[-1]
        return (
            sisters is not None
            and len(sisters.names) >= self._sisters
            and min(sisters.loads_n) > _SEEN * heaviest_n
        )

    def _waits(self, tags: Mapping[str, Tag]) -> bool:
        """Whether a high-risk stage is next and its time has come."""
        phase = self._phase()
        following = self._scenario.steps[phase : phase + 1]
        if not phase or not following or following[0].risk == "low" or not tags["phase"]["time"]:
            return False
        lasted_s = (from_rfc3339(tags["phase"]["time"]) - self._stages[-1].start_us) / 1e6
        return lasted_s > self._scenario.steps[phase - 1].duration_s

    def _phase(self) -> int:
        return len(self._stages)

    async def _enter(self, phase: int, tags: Mapping[str, Tag]) -> None:
        """Note the stages between the last look and this one with the times they began."""
        for number in range(self._phase() + 1, phase + 1):
            start_us = await self._phase_start_us(number, tags["phase"]["time"])
            if self._stages:
                planned_s = self._scenario.steps[self._phase() - 1].duration_s
                self._stages[-1] = ended(self._stages[-1], start_us, planned_s)
            if number > len(self._scenario.steps):
                self._report("The profile is over; the machine is at standstill.")
                self._stages.append(Stage("standstill", "low", 0.0, 0.0, start_us, None))
                return
            step = self._scenario.steps[number - 1]
            self._stages.append(
                Stage(step.name, step.risk, step.speed_rpm, step.load_n, start_us, None)
            )
            forecast = tags["t_inner_ring_c.forecast_max"]["value"]
            ahead = f"; forecast peak of the inner ring {forecast:.1f} °C" if forecast else ""
            self._report(
                f"Stage {number} of {len(self._scenario.steps)}: {step.name}, "
                f"{step.speed_rpm:g} rpm, {step.load_n:g} N, {step.duration_s / 60:g} min, "
                f"{step.risk} risk{ahead}"
            )

    async def _phase_start_us(self, phase: int, seen_at: str) -> int:
        """Time of the first sample that carries the phase."""
        begin_us = self._stages[-1].start_us if self._stages else 0
        end_us = from_rfc3339(seen_at) + 1000
        cursor: str | None = None
        while True:
            page = await self._measurements("phase", "raw", begin_us, end_us, cursor)
            for item in cast(list[SampleItem], page.items):
                if item["value"] is not None and item["value"] >= phase:
                    return from_rfc3339(item["time"])
            cursor = page.next
            if cursor is None:
                return from_rfc3339(seen_at)

    async def _keep_forecast(self) -> None:
        answer = await ask(self._client, f"{self._path}/forecast", self._report)
        if answer.status_code != httpx2.codes.OK:
            return
        forecast = ScoredForecast.of(LiveForecast.model_validate_json(answer.content))
        if not self._forecasts or forecast.made_at_us > self._forecasts[-1].made_at_us:
            self._forecasts.append(forecast)

    async def _report_models_and_jobs(self) -> None:
        for job in (await self._get(f"{self._path}/identifications", JobList)).items:
            if self._is_new("job", job.id):
                self._report("Re-identification started automatically from low-risk windows.")
        for model in (await self._get(f"{self._path}/models", ModelList)).items:
            if model.status == "candidate" or not self._is_new("model", model.version):
                continue
            if model.windows:
                learned = model.sisters
                sisters = (
                    f"; learned from {', '.join(learned.names)}"
                    if (learned is not None and learned.accepted)
                    else ""
                )
                self._report(
                    f"Model version {model.version}: {model.status}, {model.reason}{sisters}"
                )

    async def _report_alarms(self) -> None:
        for alarm in (await self._get("/api/v1/alarms", AlarmList)).items:
            if alarm.asset != self._asset:
                continue
            if alarm.state in SET_ASIDE_STATES or not self._is_new("alarm", alarm.id):
                continue
            foresight = ""
            if alarm.predicted:
                lead_min = (alarm.lead_time_s or 0) / 60
                foresight = f", predicted in {lead_min:.0f} min, P {alarm.probability:.0%}"
            self._report(f"Alarm: {alarm.message} ({alarm.kind}{foresight})")

    def _is_new(self, kind: str, id: str | int) -> bool:
        """Whether something was not reported before; from now on it was."""
        is_new = (kind, id) not in self._reported
        self._reported.add((kind, id))
        return is_new

    # ------------------------------------------------------------------ the account at the end
    async def account(self) -> Account:
        """The demo's JSON document."""
        stages = [stage for stage in self._stages if stage.risk == "high"]
        journal = await self._get("/api/v1/alarms/journal", AlarmJournalList, limit="1000")
        limits = (await self._get(self._path, AssetDocument)).limits
        lines = [line for line in journal.items if line.asset == self._asset]
        ends_us = {after: stage.end_us for stage, after in pairwise(self._stages)}
        before = [
            made_before(self._forecasts, stage, ends_us.get(stage) or math.inf) for stage in stages
        ]
        alone = self._alone
        if alone is not None and stages:  # it took the stages to begin at once
            alone = alone.moved_to(stages[0].start_us)
        return {
            "model_versions": await self._model_versions(),
            "stages": [
                stage_account(
                    stage,
                    forecast,
                    await self._measured(stage),
                    _warning(stage, forecast, lines, limits),
                    alone,
                )
                for stage, forecast in zip(stages, before, strict=True)
            ],
            "samples": {
                "modbus": await self._sample_count(MODBUS_CHANNELS),
                "can": await self._sample_count(CAN_CHANNELS),
            },
            "complete": self.complete,
            "forecasts_kept": kept_account(
                await self._get(f"{self._path}/forecast-performance", Performance)
            ),
        }

    async def _model_versions(self) -> list[VersionAccount]:
        models = (await self._get(f"{self._path}/models", ModelList)).items
        return [
            {
                "version": model.version,
                "identified_at": model.created_at,
                "activated": model.status in ("active", "retired"),
                "windows": [
                    {
                        "start": window.start,
                        "end": window.end,
                        "speed_rpm_max": window.speed_rpm_max,
                        "load_n_max": window.load_n_max,
                    }
                    for window in model.windows
                ],
            }
            for model in sorted(models, key=lambda model: model.version)
            if model.windows
        ]

    async def _measured(self, stage: Stage) -> dict[str, MeasuredMinutes]:
        end_us = stage.end_us or (self._forecasts[-1].made_at_us if self._forecasts else 0)
        measured = {}
        for sensor in SENSORS:
            items = await self._rollups(sensor, "1min", stage.start_us, end_us)
            # Whole minutes only: the one in which the stage began belongs to two stages.
            minutes = [
                (from_rfc3339(item["time"]), item["mean"]) for item in items if item["count"]
            ]
            minutes = [
                (start_us, mean)
                for start_us, mean in minutes
                if start_us >= stage.start_us and start_us + MINUTE_US <= end_us
            ]
            measured[sensor] = MeasuredMinutes(
                np.array([start_us + MINUTE_US / 2 for start_us, _ in minutes], dtype=np.float64),
                np.array([mean for _, mean in minutes], dtype=np.float64),
            )
        return measured

    async def _sample_count(self, channels: Sequence[str]) -> int:
        if not self._stages:
            return 0
        begin_us = self._stages[0].start_us - 6 * 3600 * 1_000_000
        end_us = begin_us + 7 * 24 * 3600 * 1_000_000
        counts = [await self._rollups(channel, "1h", begin_us, end_us) for channel in channels]
        return sum(int(item["count"]) for items in counts for item in items)

    async def _rollups(
        self, channel: str, resolution: str, start_us: int, end_us: int
    ) -> list[BucketItem]:
        items: list[BucketItem] = []
        cursor: str | None = None
        while start_us < end_us:  # not in a stage that has just begun when the demo is cut short
            page = await self._measurements(channel, resolution, start_us, end_us, cursor)
            items += cast(list[BucketItem], page.items)
            cursor = page.next
            if cursor is None:
                break
        return items

    async def _measurements(
        self, channel: str, resolution: str, start_us: int, end_us: int, cursor: str | None
    ) -> Measurements:
        return await self._get(
            f"{self._path}/measurements",
            Measurements,
            channel=channel,
            start=rfc3339(start_us),
            end=rfc3339(end_us),
            resolution=resolution,
            **({"cursor": cursor} if cursor else {}),
        )

    async def _get(self, path: str, kind: type[Answer], **parameters: str) -> Answer:
        answer = await ask(self._client, path, self._report, parameters)
        if answer.status_code != httpx2.codes.OK:
            raise DemoError(f"{path}: HTTP {answer.status_code} {answer.text[:200]}")
        return TypeAdapter(kind).validate_json(answer.content)


def _warning(
    stage: Stage,
    forecast: ScoredForecast | None,
    journal: Iterable[AlarmJournalLine],
    limits: Mapping[str, Limits],
) -> WarningAccount:
    """When the limits of a stage were first announced, and when first reached by measurement.

    A prediction belongs to a stage if it stood at the stage's start or was raised during it, and
    if the forecast made before the stage has the limit inside its band within the stage: one alarm
    may stand over several stages and mean only the last of them.
    """
    standing: dict[str, str] = {}
    measured_at: str | None = None
    end_us = stage.end_us or stage.start_us
    for entry in sorted(journal, key=lambda entry: entry.time):
        time_us = from_rfc3339(entry.time)
        raised = entry.to_state == "UNACK"
        if time_us >= end_us:
            break
        alarm_id, channel = entry.alarm_id or "", entry.channel or ""
        if entry.kind == "forecast limit":
            limit_c = dict(limits[channel])[entry.limit_level or ""]
            if raised and forecast and forecast.may_pass(channel, limit_c, stage):
                standing.setdefault(alarm_id, entry.time)
            elif entry.to_state in ("RTNUN", "NORM") and time_us < stage.start_us:
                standing.pop(alarm_id, None)
        if entry.kind == "measured limit" and raised and time_us >= stage.start_us:
            measured_at = measured_at or entry.time
    return {
        "forecast_limit_at": min(standing.values(), default=None),
        "measured_limit_at": measured_at,
    }
