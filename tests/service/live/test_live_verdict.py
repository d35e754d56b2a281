"""What a running service says of a machine, and shows of it."""

import asyncio
import json
import random
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import pytest
from patience import within
from prometheus_client import CollectorRegistry
from structlog.testing import capture_logs

from adapters.samples import Quality, Sample
from service.bus.health_reports import HealthReports
from service.bus.memory import MemoryBus
from service.bus.replicas import Replicas
from service.cell.answers import AlarmAnswers, AssetAnswers, PushAnswers, StreamAnswers, handlers_of
from service.documents.verdicts import VerdictDocument
from service.ingest import Ingest, Spool
from service.security.keys import create_key
from service.site.settings import Settings
from service.web.api import create_app
from service.web.api.context import ServiceContext
from service.web.cell import AskedCell, CellIngest
from service.web.overview import Overview

from .conftest import asset_section, make_version
from .verdict_inputs import HOUR_US, INPUTS, RING, WARM, WAYS


def identified(number: int = 2) -> Any:
    return replace(make_version(number), identified_at_us=1)


@pytest.fixture
def make_safe(make_live: Callable[..., Any]) -> Callable[[], Any]:
    """A live asset whose limits are far from anything that its model can forecast."""

    def make() -> Any:
        section = asset_section(limits={RING: {"warning": 300, "alarm": 350}})
        return make_live(section, identified())

    return make


@pytest.fixture
async def open_web(tmp_path: Path) -> AsyncIterator[Callable[[Any], Awaitable[httpx2.AsyncClient]]]:
    """The web side over a live asset, for a viewer."""
    clients: list[httpx2.AsyncClient] = []
    serving: list[asyncio.Task[None]] = []

    async def open_for(live: Any) -> httpx2.AsyncClient:
        registry = CollectorRegistry()
        (tmp_path / "web").mkdir()
        spool = Spool.open(tmp_path / "web", 16)
        ingest = Ingest(live.store, spool, live.clock, lambda batch: None, registry=registry)
        outbox = live.alarms._outbox
        joint = MemoryBus()
        assets = {"bench-1": live.runtime}
        handlers = handlers_of(
            AssetAnswers(assets),
            StreamAnswers(live.bus),
            PushAnswers(ingest, live.store, assets),
            AlarmAnswers(live.alarms, outbox),
        )
        serving.append(asyncio.create_task(joint.serve(handlers)))
        await asyncio.sleep(0)
        replicas = Replicas(joint, fresh_s=0.0)
        await replicas.load()
        context = ServiceContext(
            settings=Settings(),
            clock=live.clock,
            store=live.store,
            outbox=outbox,
            bus=live.bus,
            ingest=CellIngest(joint),
            cell=AskedCell(joint, fresh_s=0.0),
            assets=replicas.assets,
            health=HealthReports(joint),
            fleet=Overview(replicas, live.bus),
        )
        client = httpx2.AsyncClient(
            transport=httpx2.ASGITransport(create_app(context)),
            base_url="http://bench.example",
            headers={"X-API-Key": create_key(live.store, "viewer").text},
        )
        clients.append(client)
        return client

    yield open_for
    for client in clients:
        await client.aclose()
    for task in serving:
        task.cancel()
    await asyncio.gather(*serving, return_exceptions=True)


async def test_a_running_machine_is_safe_and_no_combination_without_an_input_is(
    make_safe: Callable[[], Any], open_web: Callable[[Any], Awaitable[httpx2.AsyncClient]]
) -> None:
    live = make_safe()
    web = await open_web(live)
    rng = random.Random(14)
    live.start()

    async def ask() -> Any:
        answer = await web.get("/api/v1/assets/bench-1/verdict")
        assert answer.status_code == 200, answer.text
        return VerdictDocument.model_validate(answer.json())

    def spoil(name: str, way: str) -> None:
        now_us = live.clock.now_us()
        if way == "never":
            live.runtime.readings.latest.pop(name, None)
            return
        quality = {"bad": Quality.BAD, "uncertain": Quality.FROZEN}.get(way, Quality.GOOD)
        time_us = now_us - (HOUR_US if way == "stale" else 0)
        live.runtime.take([Sample("bench-1", name, time_us, WARM[name], quality, time_us)], [])

    def both_safe() -> bool:
        tags = live.documents.snapshot()["tags"]
        names = ("now", "present_step", "next_step")
        return [tags[f"verdict.{name}"]["value"] for name in names] == [1, 1, 1]

    await live.until(both_safe, "a safe machine", WARM)
    for _ in range(100):
        live.feed(WARM)
        absent = rng.sample(INPUTS, rng.randint(1, len(INPUTS)))
        for name in absent:
            spoil(name, rng.choice(WAYS[1:]))
        verdict = await ask()
        assert {one.word for one in verdict.by_name.values()} == {"unknown"}, verdict
        assert set(absent) <= set(verdict.missing)
        await asyncio.sleep(0.01)
    await live.until(both_safe, "a machine that is safe again", WARM)


async def test_after_speed_is_lost_nothing_presents_itself_as_valid(
    make_safe: Callable[[], Any],
) -> None:
    live = make_safe()
    live.start()
    await live.until(lambda: live.tag("verdict.next_step")["value"] == 1, "safe", WARM)
    assert live.tag("t_node_1_c.twin")["quality"] == Quality.GOOD
    assert live.tag("t_inner_ring_c.forecast_max")["quality"] == Quality.GOOD
    without_speed = {name: value for name, value in WARM.items() if name != "speed_rpm"}
    await live.until(lambda: live.tag("verdict.now")["value"] == 0, "unknown", without_speed)
    live.feed(without_speed)
    live.documents.changed()
    assert live.tag("verdict.next_step")["value"] == 0
    assert live.tag("t_node_7_c.twin")["quality"] == Quality.LAST_USABLE
    for name in ("forecast_max", "time_to_warning_s", "time_to_alarm_s"):
        tag = live.tag(f"t_inner_ring_c.{name}")
        assert tag["value"] is None
        assert tag["quality"] < Quality.UNCERTAIN
    assert live.documents.state().missing == ["speed_rpm"]
    forecast = await live.until(live.documents.forecast, "a forecast", without_speed)
    assert forecast.missing == ["speed_rpm"]
    live.stored.clear()
    await live.until(lambda: live.stored, "a kept estimate", without_speed)
    assert all(sample.quality == Quality.LAST_USABLE for sample in live.stored)


async def test_the_stream_carries_the_verdict_and_its_changes(make_safe: Callable[[], Any]) -> None:
    live = make_safe()
    subscription = live.bus.subscribe(types={"verdict"})
    live.start()
    seen: list[str] = []

    async def until_word(word: str, feeding: dict[str, float]) -> None:
        async with within(60):
            while not seen or seen[-1] != word:
                live.feed(feeding)
                try:
                    async with within(0.05):
                        message = await subscription.get()
                except TimeoutError:
                    continue
                seen.append(json.loads(message.text)["data"]["now"]["word"])

    await until_word("unknown", {})
    await until_word("safe", WARM)
    await until_word("unknown", {"t_inner_ring_c": 36.0})


async def test_a_twin_that_has_ended_is_missing(make_safe: Callable[[], Any]) -> None:
    live = make_safe()
    live.start()
    await live.until(lambda: live.tag("verdict.now")["value"] == 1, "safe", WARM)
    await live.stop()
    live.feed(WARM)
    verdict = live.documents.verdict()
    assert verdict.now.word == "unknown"
    assert verdict.missing[0] == "twin"


async def test_a_start_without_an_ambient_channel_warns_and_says_what_is_assumed(
    make_live: Callable[..., Any],
) -> None:
    without = {name: value for name, value in WARM.items() if name != "ambient_c"}
    live = make_live(asset_section(list(without)))
    with capture_logs() as lines:
        live.start()
        await live.until(lambda: live.runtime.estimate.started, "a start", without)
    assert [line["asset"] for line in lines if line["event"] == "ambient_assumed"] == ["bench-1"]
    assert live.documents.summary().ambient_assumed_c == pytest.approx(30.0)
