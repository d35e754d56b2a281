"""A step that was called not safe stays so, on the screen as well, until it is over."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from adapters.samples import PlanStep
from service.clock import from_rfc3339
from service.documents.verdicts import VerdictDocument
from service.live.called_steps import called_steps_of, called_steps_to_rows
from service.live.outlook import Outlook, StepOutlook
from service.live.verdict import Evidence, called_steps, judge

from .conftest import asset_section, make_version
from .test_verdict import CALM, HOUR_US, INPUTS, NOW_US, RING, channel, evidence, put

__all__ = ["evidence"]

HEAVY, COOL, LIGHT = (6200.0, 5500.0), (1500.0, 2650.0), (4200.0, 2650.0)
MINUTE_US = 60_000_000


def ahead(*steps: tuple[tuple[float, float], float, Any], made_us: int = NOW_US) -> Outlook:
    """A forecast along a plan: point, minutes left and the forecast of the ring for each step."""
    outlooks, end_s = [], 0.0
    for point, minutes, said in steps:
        start_s, end_s = end_s, end_s + 60.0 * minutes
        row = PlanStep(60.0 * minutes, *point)
        outlooks.append(StepOutlook(start_s, end_s, *point, {RING: said}, row))
    crossings = {RING: {"warning": outlooks[-1].channels[RING].warning, "alarm": CALM}}
    return Outlook(made_us, 2, tuple(outlooks), crossings)


def at(evidence: Evidence, minute: float, outlook: Outlook | None) -> Evidence:
    """The same machine some minutes later, with fresh readings and another forecast."""
    now_us = NOW_US + round(minute * MINUTE_US)
    for name in INPUTS:
        sample = evidence.readings.latest[name]
        evidence.readings.add([sample._replace(time_us=now_us, received_us=now_us)])
    outlook = outlook and replace(outlook, made_us=now_us)
    later = replace(evidence, now_us=now_us, outlook=outlook)
    return replace(later, called=called_steps(later))


def words(evidence: Evidence) -> tuple[str, str, str]:
    said = judge(evidence)
    return said.now.word, said.present_step.word, said.next_step.word


# ------------------------------------------------------------------------------------- the words
def test_the_present_step_is_judged_to_its_end_and_names_it(evidence: Evidence) -> None:
    heavy = ahead((HEAVY, 60, channel(0.99)), (COOL, 60, channel()))
    said = judge(replace(evidence, outlook=heavy))
    assert (said.now.word, said.present_step.word) == ("safe", "not safe")
    assert said.present_step.probability == 0.99
    assert said.present_step.seconds_to_limit == 900
    assert said.present_step.ends_at is not None
    assert from_rfc3339(said.present_step.ends_at) == NOW_US + HOUR_US


def test_a_step_that_goes_on_beyond_the_forecast_ends_by_the_plan(evidence: Evidence) -> None:
    cut = ahead((LIGHT, 240, channel()))
    (step,) = cut.steps
    longer = replace(cut, steps=(replace(step, plan=PlanStep(6 * 3600.0, *LIGHT)),))
    ends_at = judge(replace(evidence, outlook=longer)).present_step.ends_at
    assert ends_at is not None
    assert from_rfc3339(ends_at) == NOW_US + 6 * HOUR_US


def test_a_point_that_is_held_is_judged_and_has_no_end(evidence: Evidence) -> None:
    step = StepOutlook(0.0, 14_400.0, *HEAVY, {RING: channel(0.3)})
    crossings = {RING: {"warning": step.channels[RING].warning, "alarm": CALM}}
    said = judge(replace(evidence, outlook=Outlook(NOW_US, 2, (step,), crossings)))
    assert (said.present_step.word, said.next_step.word) == ("not safe", "not safe")
    assert said.present_step.ends_at is None


def test_what_the_next_step_lacks_the_present_one_lacks(evidence: Evidence) -> None:
    for change in ({"identified": False}, {"outlook": None}, {"twin_runs": False}):
        said = judge(replace(evidence, **change)).present_step
        assert (said.word, said.ends_at) == ("unknown", None)


def test_below_its_limit_nothing_recovers(evidence: Evidence) -> None:
    """A step that begins over a limit only by the forecast is not called recovering."""
    overrun = ahead((HEAVY, 60, channel(0.99)), (COOL, 60, channel(0.99, cools=True)))
    said = judge(replace(evidence, outlook=overrun))
    assert said.next_step.word == "not safe"
    assert "the step begins over the warning and cools below it" in said.next_step.reasons
    put(evidence.readings, RING, "good", 74.0)
    assert words(replace(evidence, outlook=overrun)) == ("not safe", "not safe", "recovering")


def test_the_present_step_is_never_better_than_now(evidence: Evidence) -> None:
    cooling = ahead((COOL, 60, channel(0.99, cools=True)), (LIGHT, 60, channel()))
    put(evidence.readings, RING, "good", 74.0)
    assert words(replace(evidence, outlook=cooling)) == ("recovering", "recovering", "safe")
    put(evidence.readings, RING, "good", 96.0)
    assert words(replace(evidence, outlook=cooling)) == ("not safe", "not safe", "safe")


def test_what_a_step_has_left_behind_is_not_ahead_any_more(evidence: Evidence) -> None:
    """A forecast is some minutes old before the next one is there."""
    over = channel(0.97, cools=True)
    left = tuple(
        (60.0 * at, replace(over.warning, probability=p))
        for at, p in enumerate((0.97, 0.4, 0.02, 0.0))
    )
    cooling = ahead((COOL, 60, replace(over, left=left)))
    assert words(replace(evidence, outlook=cooling)) == ("safe", "not safe", "not safe")
    put(evidence.readings, RING, "good", 74.0)
    assert words(replace(evidence, outlook=cooling))[1:] == ("recovering", "recovering")
    put(evidence.readings, RING, "good", 66.0)
    later = replace(evidence, now_us=NOW_US + 150_000_000, outlook=cooling)
    for name in INPUTS:
        sample = evidence.readings.latest[name]
        evidence.readings.add([sample._replace(time_us=later.now_us, received_us=later.now_us)])
    assert words(later) == ("safe", "safe", "safe")
    assert judge(later).present_step.probability == 0.02


# ------------------------------------------------------------------------------------- what stands
def test_a_step_once_called_not_safe_stays_so_until_it_ends(evidence: Evidence) -> None:
    before = at(evidence, 0, ahead((LIGHT, 10, channel()), (HEAVY, 60, channel(0.06))))
    assert words(before) == ("safe", "safe", "not safe")
    # The forecast is made again, with slightly other numbers.
    before = at(before, 1, ahead((LIGHT, 9, channel()), (HEAVY, 60, channel(0.045))))
    assert words(before) == ("safe", "safe", "not safe")
    assert "was called not safe before (6 %)" in " ".join(judge(before).next_step.reasons)
    # It waits a minute longer than planned, and begins.
    here = at(before, 11, ahead((HEAVY, 60, channel(0.03)), (COOL, 60, channel())))
    assert words(here) == ("safe", "not safe", "safe")
    # Its forecast is lost, and comes back.
    here = at(here, 12, None)
    assert words(here) == ("safe", "unknown", "unknown")
    here = at(here, 70, ahead((HEAVY, 1, channel()), (COOL, 60, channel())))
    assert words(here) == ("safe", "not safe", "safe")
    over = at(here, 71, ahead((COOL, 60, channel()), (HEAVY, 60, channel())))
    assert words(over) == ("safe", "safe", "safe"), "and the next such step is another one"


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ((HEAVY, 60), "not safe"),
        ((HEAVY, 90), "not safe"),
        ((HEAVY, 30), "safe"),
        ((LIGHT, 60), "safe"),
    ],
)
def test_a_step_that_is_changed_is_judged_again(
    evidence: Evidence, changed: tuple[tuple[float, float], float], word: str
) -> None:
    before = at(evidence, 0, ahead((COOL, 10, channel()), (HEAVY, 60, channel(0.4))))
    after = at(before, 1, ahead((COOL, 9, channel()), (*changed, channel())))
    assert judge(after).next_step.word == word


def test_a_step_that_only_leaves_a_limit_behind_is_judged_by_what_comes(evidence: Evidence) -> None:
    before = at(evidence, 0, ahead((HEAVY, 10, channel(0.9)), (COOL, 60, channel(0.9, cools=True))))
    assert words(before) == ("safe", "not safe", "not safe")
    after = at(before, 10, ahead((COOL, 60, channel())))
    assert words(after) == ("safe", "safe", "safe"), "the limit was not exceeded after all"


def test_what_was_called_is_kept_for_the_next_start(evidence: Evidence) -> None:
    before = at(evidence, 0, ahead((LIGHT, 10, channel()), (HEAVY, 60, channel(0.4))))
    rows = called_steps_to_rows(before.called)
    assert called_steps_of(rows) == before.called != ()
    for spoilt in ([[1.0]], [["x"] * 6], [None]):
        with pytest.raises(ValueError, match=r"called_steps|unpack|could not convert"):
            called_steps_of(spoilt)  # type: ignore[arg-type]


# ------------------------------------------------------------------------------------- the story
LOW_S, HEAVY_S, COOL_S = 1800.0, 4000.0, 5400.0
START = {
    "speed_rpm": LIGHT[0],
    "load_n": LIGHT[1],
    "ambient_c": 23.0,
    "t_inner_ring_c": 48.0,
    "t_outer_ring_c": 40.0,
}


class Moment(NamedTuple):
    """What was said at a moment, and what was true then."""

    since_s: float
    said: VerdictDocument
    over_k: float
    alarm_stands: bool


class Bench:
    """Runs the plan as a forecast said that it would, and sends what it measures."""

    def __init__(self, live: Any) -> None:
        self.live = live
        self.began_us = live.clock.now_us()
        self.plan = [(LOW_S, *LIGHT), (HEAVY_S, *HEAVY), (COOL_S, *COOL)]
        self.time_s = np.array([0.0])
        self.path_c = {name: np.array([START[name]]) for name in (RING, "t_outer_ring_c")}

    def send(self) -> None:
        since_s = (self.live.clock.now_us() - self.began_us) / 1e6
        left, elapsed_s = [], since_s
        for duration_s, speed_rpm, load_n in self.plan:
            if elapsed_s < duration_s:
                left.append((duration_s - elapsed_s, speed_rpm, load_n))
            elapsed_s = max(elapsed_s - duration_s, 0.0)
        self.live.plan(*left)
        readings = {
            name: float(np.interp(since_s, self.time_s, path)) for name, path in self.path_c.items()
        }
        point = dict(zip(("speed_rpm", "load_n"), left[0][1:], strict=True))
        self.live.feed(START | point | readings)

    def moment(self) -> Moment:
        runtime = self.live.runtime
        return Moment(
            (self.live.clock.now_us() - self.began_us) / 1e6,
            self.live.documents.verdict(),
            runtime.readings.latest[RING].value - runtime.settings.limits[RING].warning,
            any(kind == "measured limit" for kind, *_ in self.live.alarms.present("bench-1")),
        )

    async def learn(self) -> None:
        """Take the way of the temperatures from the live forecast along the plan."""
        while (said := self.live.documents.forecast()) is None or not said.planned:
            self.send()
            await asyncio.sleep(0.02)
        offset_s = (from_rfc3339(said.made_at) - self.began_us) / 1e6
        self.time_s = np.array(said.time_s) + offset_s
        self.path_c = {name: np.array(said.nodes[name].q50) for name in self.path_c}


@pytest.fixture
async def bench(make_live: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> Bench:
    """A bench before a step that brings the inner ring well over its warning."""
    monkeypatch.setattr("service.live.forecast_loop.FORECAST_LEAST_WALL_S", 0.1)
    version = make_version(2)
    known = replace(version.posterior, covariance=0.1**2 * np.eye(version.posterior.z.size))
    live = make_live(asset_section(), replace(version, posterior=known, identified_at_us=1), 60.0)
    bench = Bench(live)
    live.start()
    await bench.learn()
    rise = bench.path_c[RING]
    warning_c = float(round(rise[0] + 0.8 * (rise.max() - rise[0])))
    limits = {RING: {"warning": warning_c, "alarm": warning_c + 60.0}}
    live.runtime.change_alarms(asset_section(limits=limits), {})
    return bench


async def test_from_the_first_word_to_the_end_some_word_says_so(bench: Bench) -> None:
    """The story of a demonstration: an overrun that is announced, comes and cools."""
    seen: list[Moment] = []
    while not seen or seen[-1].since_s < LOW_S + HEAVY_S + COOL_S - 600.0:
        bench.send()
        await asyncio.sleep(0.05)
        seen.append(bench.moment())

    def part(begin_s: float, end_s: float) -> list[Moment]:
        return [
            one
            for one in seen
            if begin_s <= one.since_s < end_s and "forecast" not in one.said.missing
        ]

    def said(name: str, moments: list[Moment]) -> set[str]:
        return {getattr(one.said, name).word for one in moments}

    first_s = next(one.since_s for one in seen if one.said.next_step.word == "not safe")
    assert first_s < LOW_S - 600.0
    assert said("next_step", part(first_s, LOW_S - 60.0)) == {"not safe"}
    heavy = part(LOW_S + 120.0, LOW_S + HEAVY_S - 60.0)
    assert said("present_step", heavy) == {"not safe"}
    before = [one for one in heavy if one.over_k < -0.5]
    assert said("now", before) == {"safe"}
    assert len(before) > 5
    after = [one for one in heavy if one.over_k > 0.5]
    assert said("now", after) == {"not safe"}
    assert said("next_step", after) == {"recovering"}
    for one in seen:
        if "recovering" in {verdict.word for verdict in one.said.by_name.values()}:
            assert one.over_k > -0.1 or one.alarm_stands, one
    assert said("present_step", part(LOW_S + HEAVY_S + 2400.0, np.inf)) == {"safe"}


async def test_a_restart_in_the_middle_of_the_step_does_not_forget_it(
    bench: Bench, make_live: Callable[..., Any]
) -> None:
    live = bench.live

    def word() -> str:
        bench.send()
        return str(live.documents.verdict().next_step.word)

    await live.until(lambda: word() == "not safe", "a step that is called not safe")
    await live.stop()
    assert len(live.saved[-1]["called_steps"]) == 1
    again = make_live(live.runtime.settings, live.runtime.active, 60.0)
    again.start(live.saved[-1])
    bench.live = again
    bench.send()
    await asyncio.sleep(0)
    assert again.runtime.saving._state()["called_steps"] == live.saved[-1]["called_steps"]
