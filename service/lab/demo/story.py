"""Follows the demo over REST like any other client, tells what happens and keeps what is scored."""

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from typing import TypeVar, cast

import httpx2
import numpy as np
from pydantic import TypeAdapter

from adapters.virtual_bench import Scenario
from service.alarms import SET_ASIDE_STATES
from service.clock import from_rfc3339, rfc3339
from service.documents.alarms import AlarmJournalLine, AlarmJournalList, AlarmList
from service.documents.assets import AssetDocument
from service.documents.forecast_ledger import ForecastPerformance
from service.documents.forecasts import LiveForecast
from service.documents.identification import JobList
from service.documents.limits import Limits
from service.documents.measurements import BucketItem, Measurements, SampleItem
from service.documents.models import ModelDocument, ModelList
from service.documents.tags import Snapshot, Tag
from service.domain.channels import AMBIENT, CONTROLLER_CHANNELS, LOAD, RING_SENSORS, SPEED
from service.lab.demo.configuration import ASSET
from service.lab.demo.processes import DemoError
from service.lab.demo.score import (
    SENSORS,
    Account,
    KeptForecast,
    Measured,
    Stage,
    VersionAccount,
    WarningAccount,
    ended,
    kept_account,
    made_before,
    stage_account,
)

LOOK_EVERY_WALL_S = 0.4
READY_WALL_S = 60.0
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

    Parameters
    ----------
    client : httpx2.AsyncClient
        With the service's address and an API key.
    scenario : Scenario
        What the bench runs.
    tell : callable
        Takes one line for the person who watches.
    hold : callable, optional
        Sets whether the bench waits before a high-risk stage; without it the bench never waits.
    asset : str
        Name of the bench in the service.
    sisters : int
        From how many sisters that have run all stages the bench is to have learned before its
        first high-risk stage begins.
    """

    def __init__(
        self,
        client: httpx2.AsyncClient,
        scenario: Scenario,
        tell: Callable[[str], None],
        hold: Callable[[bool], Awaitable[None]] | None = None,
        asset: str = ASSET,
        sisters: int = 0,
    ) -> None:
        self._asset, self._path = asset, f"/api/v1/assets/{asset}"
        self._sisters = sisters
        self._client = client
        self._scenario = scenario
        self._tell = tell
        self._hold = hold
        self._held: bool | None = None
        self._waits_since_wall_s: float | None = None
        self._forecasts: list[KeptForecast] = []
        # The last one that the bench made without its sisters, while it waited for them.
        self._alone: KeptForecast | None = None
        self._stages: list[Stage] = []
        self._told_models: set[int] = set()
        self._told_jobs: set[str] = set()
        self._told_alarms: set[str] = set()
        self.complete = False

    async def ready(self) -> None:
        """Wait until the service follows the machine.

        Raises
        ------
        DemoError
            If it does not within a minute.
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
        await self._tell_models_and_jobs()
        await self._tell_alarms()
        await self._hold_bench(tags)
        if tags["phase"]["value"] is None:
            return None
        phase = int(tags["phase"]["value"])
        if phase != self._phase():
            await self._enter(phase, tags)
        return phase

    async def _hold_bench(self, tags: Mapping[str, Tag]) -> None:
        """Let no high-risk stage begin before the twin has learned from the stages before it."""
        if self._hold is None:
            return
        wanted = await self._identification_is_due()
        if not wanted or not self._waits(tags):
            self._waits_since_wall_s = None
        elif self._waits_since_wall_s is None:
            self._waits_since_wall_s = time.monotonic()
            self._tell("The bench waits with the next stage until the identification has ended.")
        elif time.monotonic() - self._waits_since_wall_s > HOLD_WALL_S:
            wanted = False
        if wanted != self._held:
            await self._hold(wanted)
            self._held = wanted

    async def _identification_is_due(self) -> bool:
        """Whether a job runs, none has ended yet, or the forecast is of an older version."""
        jobs = (await self._get(f"{self._path}/identifications", JobList)).items
        if not jobs or any(job.status in ("queued", "running") for job in jobs):
            return True
        models = (await self._get(f"{self._path}/models", ModelList)).items
        active = [model for model in models if model.status == "active"]
        if not self._forecasts or not any(
            self._forecasts[-1].model_version == model.version for model in active
        ):
            return True
        return self._sisters > 0 and not any(self._has_learned(model) for model in active)

    def _has_learned(self, model: ModelDocument) -> bool:
        """Whether the sisters of a version have seen the heaviest stage; keeps the last without."""
        told = model.sisters
        heaviest_n = max(step.load_n for step in self._scenario.steps)
        if told is None or not told.accepted:
            self._alone = self._forecasts[-1]
        return (
            told is not None
            and len(told.names) >= self._sisters
            and min(told.loads_n) > _SEEN * heaviest_n
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
                self._tell("The profile is over; the machine is at standstill.")
                self._stages.append(Stage("standstill", "low", 0.0, 0.0, start_us, None))
                return
            step = self._scenario.steps[number - 1]
            self._stages.append(
                Stage(step.name, step.risk, step.speed_rpm, step.load_n, start_us, None)
            )
            forecast = tags["t_inner_ring_c.forecast_max"]["value"]
            ahead = f"; forecast peak of the inner ring {forecast:.1f} °C" if forecast else ""
            self._tell(
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
        answer = await self._client.get(f"{self._path}/forecast")
        if answer.status_code != httpx2.codes.OK:
            return
        forecast = KeptForecast.of(LiveForecast.model_validate_json(answer.content))
        if not self._forecasts or forecast.made_at_us > self._forecasts[-1].made_at_us:
            self._forecasts.append(forecast)

    async def _tell_models_and_jobs(self) -> None:
        for job in (await self._get(f"{self._path}/identifications", JobList)).items:
            if job.id not in self._told_jobs:
                self._told_jobs.add(job.id)
                self._tell("Re-identification started by itself from low-risk windows.")
        for model in (await self._get(f"{self._path}/models", ModelList)).items:
            if model.version in self._told_models or model.status == "candidate":
                continue
            self._told_models.add(model.version)
            if model.windows:
                learned = model.sisters
                sisters = (
                    f"; learned from {', '.join(learned.names)}"
                    if (learned is not None and learned.accepted)
                    else ""
                )
                self._tell(
                    f"Model version {model.version}: {model.status}, {model.reason}{sisters}"
                )

    async def _tell_alarms(self) -> None:
        for alarm in (await self._get("/api/v1/alarms", AlarmList)).items:
            if alarm.asset != self._asset:
                continue
            if alarm.id in self._told_alarms or alarm.state in SET_ASIDE_STATES:
                continue
            self._told_alarms.add(alarm.id)
            foresight = ""
            if alarm.predicted:
                lead_min = (alarm.lead_time_s or 0) / 60
                foresight = f", predicted in {lead_min:.0f} min, P {alarm.probability:.0%}"
            self._tell(f"Alarm: {alarm.message} ({alarm.kind}{foresight})")

    # ------------------------------------------------------------------ the account at the end
    async def account(self) -> Account:
        """The demo's JSON document."""
        stages = [stage for stage in self._stages if stage.risk == "high"]
        journal = await self._get("/api/v1/alarms/journal", AlarmJournalList, limit="1000")
        limits = (await self._get(self._path, AssetDocument)).limits
        lines = [line for line in journal.items if line.asset == self._asset]
        before = [made_before(self._forecasts, stage) for stage in stages]
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
                await self._get(f"{self._path}/forecast-performance", ForecastPerformance)
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

    async def _measured(self, stage: Stage) -> dict[str, Measured]:
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
            measured[sensor] = Measured(
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
        while True:
            page = await self._measurements(channel, resolution, start_us, end_us, cursor)
            items += cast(list[BucketItem], page.items)
            cursor = page.next
            if cursor is None:
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
        answer = await self._client.get(path, params=parameters)
        if answer.status_code != httpx2.codes.OK:
            raise DemoError(f"{path}: HTTP {answer.status_code} {answer.text[:200]}")
        return TypeAdapter(kind).validate_json(answer.content)


def _warning(
    stage: Stage,
    forecast: KeptForecast | None,
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
