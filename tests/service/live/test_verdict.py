"""Safe or not: never without the inputs that the word needs."""

import asyncio
import json
import random
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import httpx2
import numpy as np
import pytest
from prometheus_client import CollectorRegistry
from structlog.testing import capture_logs

from adapters.samples import Quality, Sample
from service.bus.memory import MemoryBus
from service.bus.replicas import Replicas
from service.cell.answers import Answers, Parts
from service.documents.limits import Limit
from service.documents.verdicts import VerdictDocument
from service.ingest import Ingest, Spool
from service.jobs.manager import IdentificationJobs
from service.live.outlook import ChannelOutlook, Outlook, StepOutlook, share_over
from service.live.presentation import LimitCrossing
from service.live.readings import Readings
from service.live.verdict import Evidence, judge
from service.notifications.notifier import Notifier
from service.security.keys import create_key
from service.site.asset_section import AssetSection, Limits
from service.site.machines.networks import read_network
from service.site.required_channels import required_channels
from service.site.settings import Settings
from service.web.api import create_app
from service.web.api.context import ServiceContext
from service.web.cell import CellAlarms, CellHealth, CellIngest, CellJobs, CellNotifications, Shared
from service.web.overview import Overview

WARM = {
    "speed_rpm": 1500.0,
    "load_n": 2650.0,
    "ambient_c": 23.0,
    "t_inner_ring_c": 36.0,
    "t_outer_ring_c": 30.0,
}
INPUTS = tuple(WARM)
RING = "t_inner_ring_c"
NOW_US = 1_763_700_000_000_000
HOUR_US = 3_600_000_000
WAYS = ("good", "bad", "uncertain", "stale", "never")
STATOR = Path(__file__).parents[3] / "deploy" / "networks" / "stator.toml"
CALM = LimitCrossing(0.0, None, None)


def channel(probability: float = 0.0, *, cools: bool = False, upper_c: float = 50.0) -> Any:
    earliest_s = 900.0 if probability >= 0.025 else None
    crossing = LimitCrossing(probability, None, earliest_s)
    return ChannelOutlook(crossing, CALM, upper_c, cools)


def outlook(present: Any = None, following: Any = None) -> Outlook:
    """A forecast of two hours, at first as it is and then as planned."""
    present = present or channel()
    steps = [StepOutlook(0.0, 3600.0, 1500.0, 2650.0, {RING: present})]
    if following is not None:
        steps.append(StepOutlook(3600.0, 7200.0, 4200.0, 5500.0, {RING: following}))
    crossings = {RING: {"warning": steps[-1].channels[RING].warning, "alarm": CALM}}
    return Outlook(NOW_US, 2, tuple(steps), crossings)


@pytest.fixture
def evidence(make_section: Callable[..., Any]) -> Evidence:
    """All is there and calm."""
    readings = Readings("bench-1", dict.fromkeys(INPUTS, 10.0), NOW_US - HOUR_US)
    for name in INPUTS:
        put(readings, name, "good")
    return Evidence(make_section(), readings, NOW_US, True, True, outlook(channel(), channel()))


def put(readings: Readings, name: str, way: str, value: float | None = None) -> None:
    """Let a channel be good, or missing in one of the ways."""
    readings.latest.pop(name, None)
    quality = {"bad": Quality.SENSOR_FAILURE, "uncertain": Quality.FROZEN}.get(way, Quality.GOOD)
    time_us = NOW_US - (HOUR_US if way == "stale" else 0)
    if way != "never":
        figure = WARM[name] if value is None else value
        readings.add([Sample("bench-1", name, time_us, figure, quality, time_us)])


def words(evidence: Evidence) -> tuple[str, str]:
    verdict = judge(evidence)
    return verdict.now.word, verdict.next_step.word


# ------------------------------------------------------------------------------------- the rule
def test_with_all_inputs_it_is_safe(evidence: Evidence) -> None:
    verdict = judge(evidence)
    assert (verdict.now.word, verdict.next_step.word) == ("safe", "safe")
    assert verdict.missing == []
    assert verdict.next_step.limit == Limit(channel=RING, level="warning", value_c=70.0)
    assert verdict.time_to_limit.expected is False


@pytest.mark.parametrize("way", WAYS[1:])
@pytest.mark.parametrize("name", INPUTS)
def test_a_missing_input_is_named_and_nothing_is_safe(
    evidence: Evidence, name: str, way: str
) -> None:
    put(evidence.readings, name, way)
    verdict = judge(evidence)
    assert (verdict.now.word, verdict.next_step.word) == ("unknown", "unknown")
    assert verdict.missing == [name]
    assert verdict.time_to_limit is None
    assert len(verdict.now.reasons) == 1


@pytest.mark.parametrize(
    ("change", "missing", "now"),
    [
        ({"twin_runs": False}, "twin", "unknown"),
        ({"identified": False}, "identified model", "safe"),
        ({"outlook": None}, "forecast", "safe"),
    ],
)
def test_what_the_twin_lacks_is_named(
    evidence: Evidence, change: dict[str, Any], missing: str, now: str
) -> None:
    verdict = judge(replace(evidence, **change))
    assert (verdict.now.word, verdict.next_step.word) == (now, "unknown")
    assert verdict.missing == [missing]


def test_no_random_combination_of_missing_inputs_is_safe(evidence: Evidence) -> None:
    rng = random.Random(13)
    for _ in range(100):
        ways = {name: rng.choice(WAYS) for name in INPUTS}
        ways[rng.choice(INPUTS)] = rng.choice(WAYS[1:])
        twin, identified = rng.random() < 0.5, rng.random() < 0.5
        for name, way in ways.items():
            put(evidence.readings, name, way)
        verdict = judge(replace(evidence, twin_runs=twin, identified=identified))
        assert (verdict.now.word, verdict.next_step.word) == ("unknown", "unknown")
        absent = {name for name, way in ways.items() if way != "good"}
        assert set(verdict.missing) == absent | (set() if twin else {"twin"}) | (
            set() if identified else {"identified model"}
        )


def test_a_machine_without_an_ambient_channel_says_what_is_assumed(
    evidence: Evidence, make_section: Callable[..., Any]
) -> None:
    settings = make_section([name for name in INPUTS if name != "ambient_c"])
    verdict = judge(replace(evidence, settings=settings, assumed_ambient_c=21.6))
    assert verdict.missing == []
    for name in ("now", "next_step"):
        assert getattr(verdict, name).word == "safe"
        assert "ambient assumed 22 °C" in getattr(verdict, name).reasons


def test_without_a_measured_temperature_nothing_is_safe(
    evidence: Evidence, make_section: Callable[..., Any]
) -> None:
    settings = make_section(["speed_rpm", "load_n"])
    readings = Readings("bench-1", {"speed_rpm": 10.0, "load_n": 10.0}, NOW_US)
    for name in ("speed_rpm", "load_n"):
        put(readings, name, "good")
    verdict = judge(replace(evidence, settings=settings, readings=readings))
    assert verdict.now.word == "unknown"
    assert RING in verdict.missing


def test_without_limits_nothing_is_safe(
    evidence: Evidence, make_section: Callable[..., Any]
) -> None:
    verdict = judge(replace(evidence, settings=make_section(limits={})))
    assert verdict.now.word == verdict.next_step.word == "unknown"
    assert "limits" in verdict.missing


@pytest.mark.parametrize(("probability", "word"), [(0.049, "safe"), (0.05, "not safe")])
def test_the_threshold_decides_about_the_next_step(
    evidence: Evidence, probability: float, word: str
) -> None:
    ahead = replace(evidence, outlook=outlook(channel(), channel(probability)))
    verdict = judge(ahead).next_step
    assert verdict.word == word
    assert verdict.probability == probability
    assert verdict.seconds_to_limit == 900


def test_seconds_count_from_now_not_from_the_forecast(evidence: Evidence) -> None:
    later = replace(
        evidence,
        now_us=NOW_US + 5_000_000,
        outlook=outlook(channel(), channel(0.4)),
    )
    verdict = judge(later)
    assert verdict.next_step.seconds_to_limit == 895
    assert verdict.time_to_limit.earliest_s == 895


def test_over_a_limit_the_reason_and_the_limit_stand_whatever_is_missing(
    evidence: Evidence,
) -> None:
    put(evidence.readings, RING, "good", 97.0)
    assert words(evidence)[0] == "not safe"
    put(evidence.readings, "speed_rpm", "stale")
    put(evidence.readings, "t_outer_ring_c", "bad")
    verdict = judge(evidence)
    assert verdict.now.word == "unknown"
    assert verdict.now.reasons[0] == "Inner ring 97.0 °C, over alarm 95 °C"
    assert verdict.now.limit == Limit(channel=RING, level="alarm", value_c=95.0)
    assert verdict.next_step.word == "unknown"
    assert set(verdict.missing) == {"speed_rpm", "t_outer_ring_c"}


def test_over_the_warning_is_recovering_only_while_the_present_step_cools(
    evidence: Evidence,
) -> None:
    put(evidence.readings, RING, "good", 74.0)
    cooling = outlook(channel(1.0, cools=True), channel())
    assert words(evidence)[0] == "not safe"
    assert words(replace(evidence, outlook=cooling))[0] == "recovering"
    assert words(replace(evidence, outlook=cooling, identified=False))[0] == "not safe"
    put(evidence.readings, RING, "good", 96.0)
    assert words(replace(evidence, outlook=cooling))[0] == "not safe", "over the alarm"


def test_a_limit_alarm_that_is_still_there_is_not_safe_yet(evidence: Evidence) -> None:
    returning = replace(evidence, returning=frozenset({RING}))
    assert words(returning)[0] == "recovering"
    assert words(replace(returning, outlook=outlook(channel(0.5))))[0] == "not safe"


def test_a_next_step_that_only_leaves_the_limit_behind_recovers(evidence: Evidence) -> None:
    cooling = channel(1.0, cools=True, upper_c=79.0)
    assert words(replace(evidence, outlook=outlook(channel(), cooling)))[1] == "recovering"
    heating = channel(1.0, upper_c=79.0)
    assert words(replace(evidence, outlook=outlook(channel(), heating)))[1] == "not safe"


def test_a_forecast_that_has_run_out_is_none(evidence: Evidence) -> None:
    late = replace(evidence, now_us=NOW_US + 2 * HOUR_US)
    for name in INPUTS:
        sample = evidence.readings.latest[name]
        evidence.readings.add([sample._replace(time_us=late.now_us, received_us=late.now_us)])
    verdict = judge(late)
    assert verdict.now.word == "safe"
    assert verdict.missing == ["forecast"]


def test_a_share_is_read_from_the_quantiles() -> None:
    normal = 50.0 + 2.0 * np.array([-1.959964, -0.67449, 0.0, 0.67449, 1.959964])
    assert share_over(normal, 50.0) == pytest.approx(0.5)
    assert share_over(normal, 50.0 + 2.0 * 1.6449) == pytest.approx(0.05, abs=1e-3)
    assert share_over(normal, 90.0) < 1e-6
    assert share_over(normal, 10.0) > 1.0 - 1e-6
    assert share_over(np.array([1.0, 2.0, np.nan, 3.0, 4.0]), 10.0) == 1.0


# ------------------------------------------------------------------------------------- the service
def identified(make_version: Callable[..., Any], number: int = 2) -> Any:
    return replace(make_version(number), identified_at_us=1)


@pytest.fixture
def make_safe(
    make_live: Callable[..., Any],
    make_section: Callable[..., Any],
    make_version: Callable[..., Any],
) -> Callable[[], Any]:
    """A live asset whose limits are far from anything that its model can forecast."""

    def make() -> Any:
        section = make_section(limits={RING: {"warning": 300, "alarm": 350}})
        return make_live(section, identified(make_version))

    return make


@pytest.fixture
async def open_web(
    tmp_path: Path,
) -> AsyncIterator[Callable[[Any], Awaitable[httpx2.AsyncClient]]]:
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
        parts = Parts(
            clock=live.clock,
            store=live.store,
            outbox=outbox,
            stream=live.bus,
            ingest=ingest,
            alarms=live.alarms,
            notifier=cast(Notifier, None),
            assets={"bench-1": live.runtime},
            jobs=cast(IdentificationJobs, None),
            registry=registry,
            sources=lambda: [],
        )
        serving.append(asyncio.create_task(joint.serve(Answers(parts).handlers())))
        await asyncio.sleep(0)
        replicas = Replicas(joint, fresh_s=0.0)
        await replicas.load()
        shared = Shared(joint, fresh_s=0.0)
        context = ServiceContext(
            settings=Settings(),
            clock=live.clock,
            store=live.store,
            outbox=outbox,
            bus=live.bus,
            ingest=CellIngest(joint),
            alarms=CellAlarms(joint, shared),
            notifications=CellNotifications(joint, shared),
            assets=replicas.assets,
            jobs=CellJobs(joint, shared),
            health=CellHealth(shared),
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
    make_safe: Callable[[], Any],
    open_web: Callable[[Any], Awaitable[httpx2.AsyncClient]],
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
        return [tags[f"verdict.{name}"]["value"] for name in ("now", "next_step")] == [1, 1]

    await live.until(both_safe, "a safe machine", WARM)
    for _ in range(100):
        live.feed(WARM)
        absent = rng.sample(INPUTS, rng.randint(1, len(INPUTS)))
        for name in absent:
            spoil(name, rng.choice(WAYS[1:]))
        verdict = await ask()
        assert verdict.now.word == verdict.next_step.word == "unknown", verdict
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


async def test_the_stream_carries_the_verdict_and_its_changes(
    make_safe: Callable[[], Any],
) -> None:
    live = make_safe()
    subscription = live.bus.subscribe(types={"verdict"})
    live.start()
    seen: list[str] = []

    async def until_word(word: str, feeding: dict[str, float]) -> None:
        async with asyncio.timeout(60):
            while not seen or seen[-1] != word:
                live.feed(feeding)
                try:
                    async with asyncio.timeout(0.05):
                        message = await subscription.get()
                except TimeoutError:
                    continue
                seen.append(json.loads(message.text)["data"]["now"]["word"])

    await until_word("unknown", {})
    await until_word("safe", WARM)
    await until_word("unknown", {"t_inner_ring_c": 36.0})


async def test_a_twin_that_has_ended_is_missing(
    make_safe: Callable[[], Any],
) -> None:
    live = make_safe()
    live.start()
    await live.until(lambda: live.tag("verdict.now")["value"] == 1, "safe", WARM)
    await live.stop()
    live.feed(WARM)
    verdict = live.documents.verdict()
    assert verdict.now.word == "unknown"
    assert verdict.missing[0] == "twin"


async def test_a_start_without_an_ambient_channel_warns_and_says_what_is_assumed(
    make_live: Callable[..., Any], make_section: Callable[..., Any]
) -> None:
    without = {name: value for name, value in WARM.items() if name != "ambient_c"}
    live = make_live(make_section(list(without)))
    with capture_logs() as lines:
        live.start()
        await live.until(lambda: live.runtime.estimate.started, "a start", without)
    assert [line["asset"] for line in lines if line["event"] == "ambient_assumed"] == ["bench-1"]
    assert live.documents.summary().ambient_assumed_c == pytest.approx(30.0)


def test_every_channel_that_a_verdict_needs_is_listed(make_section: Callable[..., Any]) -> None:
    assert set(required_channels(make_section())) == set(INPUTS)
    nodes = make_section(
        [*INPUTS, "t_node_5_c", "t_node_9_c"],
        limits={"t_node_5_c": Limits(warning=60, alarm=80).model_dump()},
    )
    assert set(required_channels(nodes)) == {*INPUTS, "t_node_5_c"}


def test_an_input_of_a_network_of_ones_own_is_needed_too() -> None:
    document = read_network(STATOR).model_dump(mode="json")
    settings = AssetSection.model_validate(
        {
            "id": "bench-1",
            "network": document,
            "low_risk": {"speed_rpm_max": 2000, "load_n_max": 4000},
            "channels": {"speed_rpm": {"source": "push"}},
        }
    )
    assert settings.input_names
    assert set(settings.input_names) <= set(required_channels(settings))
