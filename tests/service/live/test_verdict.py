"""Safe or not: never without the inputs that the word needs."""

import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.samples import Quality, Sample
from service.documents.limits import Limit
from service.live.outlook import ChannelOutlook, Outlook, StepOutlook, share_over
from service.live.presentation import LimitCrossing
from service.live.readings import Readings
from service.live.verdict import Evidence, judge
from service.site.asset_section import AssetSection, LimitsSection
from service.site.machines.networks import read_network
from service.site.required_channels import required_channels

from .conftest import asset_section
from .verdict_inputs import HOUR_US, INPUTS, RING, WARM, WAYS

NOW_US = 1_763_700_000_000_000
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
def evidence() -> Evidence:
    """All is there and calm."""
    readings = Readings("bench-1", dict.fromkeys(INPUTS, 10.0), NOW_US - HOUR_US)
    for name in INPUTS:
        put(readings, name, "good")
    return Evidence(asset_section(), readings, NOW_US, True, True, outlook(channel(), channel()))


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
    assert {one.word for one in verdict.by_name.values()} == {"safe"}
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
    assert {one.word for one in verdict.by_name.values()} == {"unknown"}
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
        assert {one.word for one in verdict.by_name.values()} == {"unknown"}
        absent = {name for name, way in ways.items() if way != "good"}
        assert set(verdict.missing) == absent | (set() if twin else {"twin"}) | (
            set() if identified else {"identified model"}
        )


def test_a_machine_without_an_ambient_channel_says_what_is_assumed(evidence: Evidence) -> None:
    settings = asset_section([name for name in INPUTS if name != "ambient_c"])
    verdict = judge(replace(evidence, settings=settings, assumed_ambient_c=21.6))
    assert verdict.missing == []
    for one in verdict.by_name.values():
        assert one.word == "safe"
        assert "ambient assumed 22 °C" in one.reasons


def test_a_doubt_about_a_unit_stands_beside_the_verdict(evidence: Evidence) -> None:
    doubt = "load below 45 N at this speed: kN?"
    for one in judge(replace(evidence, doubts=(doubt,))).by_name.values():
        assert one.word == "safe"
        assert doubt in one.reasons


def test_without_a_measured_temperature_nothing_is_safe(evidence: Evidence) -> None:
    settings = asset_section(["speed_rpm", "load_n"])
    readings = Readings("bench-1", {"speed_rpm": 10.0, "load_n": 10.0}, NOW_US)
    for name in ("speed_rpm", "load_n"):
        put(readings, name, "good")
    verdict = judge(replace(evidence, settings=settings, readings=readings))
    assert verdict.now.word == "unknown"
    assert RING in verdict.missing


def test_without_limits_nothing_is_safe(evidence: Evidence) -> None:
    verdict = judge(replace(evidence, settings=asset_section(limits={})))
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
    later = replace(evidence, now_us=NOW_US + 5_000_000, outlook=outlook(channel(), channel(0.4)))
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
    put(evidence.readings, RING, "good", 74.0)
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


def test_every_channel_that_a_verdict_needs_is_listed() -> None:
    assert set(required_channels(asset_section())) == set(INPUTS)
    nodes = asset_section(
        [*INPUTS, "t_node_5_c", "t_node_9_c"],
        limits={"t_node_5_c": LimitsSection(warning=60, alarm=80).model_dump()},
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
