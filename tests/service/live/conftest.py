"""A live asset on a real store, alarm book and bus; the test plays the drivers."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import site_files
from jumping import LoopClock, pytest_asyncio_loop_factories, seen_threads
from patience import within
from site_files import CHANNELS

from adapters.samples import PlannedProfile, PlanStep, Quality, Sample
from service.alarms import AlarmBook
from service.bus.stream import LiveMessages
from service.bus.subscription import Subscription
from service.documents.alarms import alarm_document
from service.documents.envelope import EnvelopeDocument
from service.documents.forecasts import WhatIf
from service.documents.machine import PresentMachine
from service.domain.requests import ProfileStep
from service.features.advice.advising import give_advice
from service.features.advice.documents import AdviceDocument
from service.live.asset import AssetRuntime
from service.live.asset_documents import AssetDocuments
from service.live.envelope_keeper import EnvelopeKeeper
from service.live.estimate import EstimatedState, RunningModel
from service.live.forecasting import what_if_document
from service.live.twins import Twins
from service.site.asset_section import AssetSection
from service.site.wiring import ChannelFacts
from service.store import AuditEntry, Outbox, Store
from twin_core.bearings import bearing
from twin_core.identification.posterior import prior_posterior
from twin_core.models import build_model
from twin_core.profiles import Step

__all__ = ["pytest_asyncio_loop_factories", "seen_threads"]

RATE = 600.0
REST = {
    "speed_rpm": 0.0,
    "load_n": 2650.0,
    "ambient_c": 23.0,
    "t_inner_ring_c": 23.1,
    "t_outer_ring_c": 22.9,
}


def make_version(number: int = 1, designation: str = "6311", z: float = 0.0) -> RunningModel:
    """A version of the model of 6311, its parameters z standard deviations off the priors."""
    prior = prior_posterior(build_model("default", bearing=bearing(designation)))
    document = prior.to_dict() | {"z": (prior.z + z).tolist()}
    model = build_model("default", bearing=bearing("6311"))
    return RunningModel(number, model, type(prior).from_dict(document), None)


def asset_section(channels: Sequence[str] = CHANNELS, **changes: Any) -> AssetSection:
    limits = {"t_inner_ring_c": {"warning": 70, "alarm": 95}}
    return site_files.asset_section(channels=channels, **{"limits": limits} | changes)


@dataclass
class Live:
    """A runtime, and what it handed on."""

    runtime: AssetRuntime
    clock: LoopClock
    store: Store
    bus: LiveMessages
    alarms: AlarmBook
    saved: list[Mapping[str, Any]] = field(default_factory=list)
    audit: list[AuditEntry] = field(default_factory=list)
    stored: list[Sample] = field(default_factory=list)
    store_is_away: bool = False
    refused: int = 0
    task: asyncio.Task[None] | None = None
    ready: asyncio.Event | None = None

    def __post_init__(self) -> None:
        self.envelopes = EnvelopeKeeper(self.runtime.settings)

    def start(self, kept: Mapping[str, Any] | None = None) -> None:
        self.task = asyncio.create_task(self._run(kept))

    async def _run(self, kept: Mapping[str, Any] | None) -> None:
        twins = Twins(self.clock)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(twins.run())
            with twins.stepping(self.runtime):
                await self.runtime.run(kept, self.ready)

    async def stop(self) -> None:
        assert self.task is not None
        self.task.cancel()
        await asyncio.gather(self.task, return_exceptions=True)

    def feed(self, values: Mapping[str, float], quality: int = Quality.GOOD) -> None:
        now_us = self.clock.now_us()
        self.runtime.take(
            [Sample("bench-1", name, now_us, value, quality, now_us) for name, value in
             values.items()], [],
        )  # fmt: skip

    def plan(self, *steps: tuple[float, float, float], before_s: float = 0.0) -> None:
        time_us = self.clock.now_us() - round(before_s * 1e6)
        plan = PlannedProfile("bench-1", time_us, tuple(PlanStep(*step) for step in steps))
        self.runtime.take([], [plan])

    async def until(
        self,
        look: Callable[[], Any],
        what: str,
        feeding: Mapping[str, float] | None = None,
        timeout_s: float = 60.0,
    ) -> Any:
        """Wait until something is there; the machine goes on sending meanwhile."""
        async with within(timeout_s):
            while not (found := look()):
                assert self.task is None or not self.task.done(), f"the twin ended before {what}"
                if feeding is not None:
                    self.feed(feeding)
                await asyncio.sleep(0.02)
        return found

    def tag(self, name: str) -> dict[str, Any]:
        tag: dict[str, Any] = self.documents.snapshot()["tags"][name]
        return tag

    @property
    def documents(self) -> AssetDocuments:
        return self.runtime.documents

    def what_if(
        self,
        profile: Sequence[ProfileStep],
        step_s: float | None = None,
        nodes: Sequence[str] | None = None,
    ) -> WhatIf:
        machine, state = self._shown()
        limits = self.runtime.settings.limits
        return what_if_document(state, limits, profile, step_s, nodes, machine.missing)

    def envelope(self) -> EnvelopeDocument:
        machine, state = self._shown()
        return self.envelopes.document(state, machine.planned, machine.measured_c)

    def advice(
        self, speed_rpm: float, load_n: float, duration_s: float, half_width_k: float | None = None
    ) -> AdviceDocument:
        settings = self.runtime.settings
        _, state = self._shown()
        target = Step(speed_rpm, load_n, duration_s)
        return give_advice(settings, state, list(settings.channels), target, half_width_k)

    def _shown(self) -> tuple[PresentMachine, EstimatedState]:
        """What a worker of the web side reads of what the cell sends."""
        machine = PresentMachine.model_validate_json(self.documents.machine().to_bytes())
        assert machine.estimate is not None
        return machine, EstimatedState.read(self.runtime.active, machine.estimate)

    def subscribe(self) -> Subscription:
        return self.bus.subscribe()


@pytest.fixture
def machine_at_rest() -> dict[str, float]:
    return dict(REST)


@pytest.fixture
def executor() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as executor:
        yield executor


@pytest.fixture
async def make_live(
    tmp_path: Path, executor: ThreadPoolExecutor
) -> AsyncIterator[Callable[..., Live]]:
    """Make a live asset of given settings and model; all are stopped at the end."""
    made: list[Live] = []
    clock = LoopClock(RATE, time.time_ns() // 1000)
    store = Store.open("", tmp_path)
    outbox = Outbox.open(tmp_path, store)
    bus = LiveMessages(clock)

    def make(
        settings: AssetSection | None = None,
        active: RunningModel | None = None,
        max_age_s: float = 10.0,
    ) -> Live:
        section = settings or asset_section()
        book = AlarmBook(
            outbox, clock, lambda alarm: bus.publish("alarm", alarm.asset, alarm_document(alarm))
        )

        async def save_state(document: Mapping[str, Any], audit: Sequence[AuditEntry]) -> None:
            if live.store_is_away:
                live.refused += 1
                raise OSError("no space left on device")
            live.saved.append(document)
            live.audit.extend(audit)

        runtime = AssetRuntime(
            section,
            {name: ChannelFacts("push", max_age_s) for name in section.channels},
            active or make_version(),
            clock=clock,
            bus=bus,
            alarms=book,
            executor=executor,
            store_samples=lambda samples: live.stored.extend(samples),
            save_state=save_state,
        )
        live = Live(runtime, clock, store, bus, book)
        made.append(live)
        return live

    yield make
    for live in made:
        if live.task is not None:
            await live.stop()
    outbox.close()
    store.close()
