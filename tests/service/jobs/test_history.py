"""Minute averages and low-risk windows out of a real store."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from site_files import CHANNELS

from adapters.samples import Quality
from service.jobs.history import AssetHistory
from service.site.machines.networks import read_network
from service.store import Store
from twin_core.minute_rows import rows_of_samples
from twin_core.windows import MinuteData

from .conftest import START_US, asset_section, good

MINUTE_US = 60_000_000
SECOND_US = 1_000_000
LOW = "t_inner_ring_c"


async def minutes_of(history: AssetHistory, start_us: int, end_us: int) -> MinuteData:
    data = await history.identification_data([(start_us, end_us)])
    return data.windows[0].minutes


def make_history(store: Store, clock: Any, **changes: Any) -> AssetHistory:
    return AssetHistory(asset_section(**changes), store, clock)


def write(
    store: Store,
    seconds: int,
    values: Callable[[str, float], float | None],
    channels: tuple[str, ...] = CHANNELS,
) -> None:
    """Store a sample of every channel every second; None leaves one out."""
    samples = []
    for second in range(seconds):
        for channel in channels:
            value = values(channel, float(second))
            if value is not None:
                quality = Quality.SENSOR_FAILURE if math.isnan(value) else Quality.GOOD
                at_us = START_US + second * SECOND_US
                samples.append(good(channel, at_us, value, quality))
    store.samples.write(samples)


def ramping(channel: str, second: float) -> float:
    """Everything rises by one per minute, from 1000 for speed, 20 for the others."""
    return (1000.0 if channel == "speed_rpm" else 20.0) + second / 60.0


async def test_a_row_holds_the_point_over_its_minute_and_the_temperature_at_its_beginning(
    store: Store, clock: Any
) -> None:
    write(store, 10 * 60, ramping)
    minutes = await minutes_of(make_history(store, clock), START_US, START_US + 10 * MINUTE_US)
    row = 4
    assert minutes.time_s[row] == (START_US + row * MINUTE_US) / 1e6
    # Over the minute that begins at the row's time: on average half a minute later.
    assert minutes.speed_rpm[row] == pytest.approx(1000.0 + row + 59 / 120)
    assert minutes.ambient_c[row] == pytest.approx(20.0 + row + 59 / 120)
    # From half a minute before to half a minute after it: at its very time.
    assert minutes.temperatures_c[LOW][row] == pytest.approx(20.0 + row, abs=0.01)
    assert minutes.good[row]


async def test_rows_are_those_that_the_studies_make_of_the_same_samples(
    store: Store, clock: Any
) -> None:
    """What is studied is what runs: means out of SQL and means of arrays are the same rows."""
    time_s = np.arange(600.0)
    noise = np.random.default_rng(5).normal(size=(5, time_s.size))
    names = ("speed_rpm", "load_n", "ambient_c", "t_inner_ring_c", "t_outer_ring_c")
    columns = {name: 50.0 + values for name, values in zip(names, noise, strict=True)}

    def values(name: str, second: float) -> float:
        return float(columns[name][int(second)])

    write(store, time_s.size, values)
    stored = await minutes_of(make_history(store, clock), START_US, START_US + 10 * MINUTE_US)
    studied = rows_of_samples(
        time_s,
        {name: columns[name] for name in names[:3]},
        {name: columns[name] for name in names[3:]},
    )
    # The end of the run lies before its last mark: half a minute of temperatures, no more.
    rows = slice(0, 10)
    assert stored.good[rows].all()
    assert stored.time_s[rows] - START_US / 1e6 == pytest.approx(studied.time_s[rows], abs=1e-6)
    for name in names[:3]:
        expected = getattr(studied, name)[rows]
        assert getattr(stored, name)[rows] == pytest.approx(expected, rel=1e-12)
    for name in names[3:]:
        expected = studied.temperatures_c[name][rows]
        assert stored.temperatures_c[name][rows] == pytest.approx(expected, rel=1e-12)


async def test_a_few_doubtful_samples_are_left_out_and_many_make_their_minute_bad(
    store: Store, clock: Any
) -> None:
    """From the load, and around a full minute from the inner ring, so many of 60 are not good."""
    doubtful = {2: 1, 3: 15, 4: 16, 5: 60}

    def values(channel: str, second: float) -> float:
        shift = {"load_n": 0, LOW: 30}.get(channel)
        if shift is not None:
            minute, inside = divmod(second + shift, 60)
            # Spread over the minute, so that its mean stays what it was.
            if (inside * 7) % 60 < doubtful.get(minute, 0):
                return math.nan
        return ramping(channel, second)

    write(store, 10 * 60, values)
    minutes = await minutes_of(make_history(store, clock), START_US, START_US + 10 * MINUTE_US)
    assert np.flatnonzero(~minutes.good).tolist() == [4, 5]
    assert minutes.load_n[3] == pytest.approx(20.0 + 3 + 59 / 120, abs=0.1)


async def test_uncertain_values_are_in_no_mean(store: Store, clock: Any) -> None:
    write(store, 10 * 60, ramping)
    spikes = [
        good(channel, START_US + 2 * MINUTE_US + 1, 9e9, Quality.UNCERTAIN)
        for channel in ("speed_rpm", LOW)
    ]
    store.samples.write(spikes)
    minutes = await minutes_of(make_history(store, clock), START_US, START_US + 10 * MINUTE_US)
    assert minutes.good.all()
    assert minutes.speed_rpm[2] == pytest.approx(1000.0 + 2 + 59 / 120)
    assert minutes.temperatures_c[LOW][2] == pytest.approx(20.0 + 2, abs=0.01)


async def test_a_minute_in_which_a_channel_broke_off_is_bad(store: Store, clock: Any) -> None:
    """A driver marks a gap with one bad sample; what is left is a part of the minute."""

    def values(channel: str, second: float) -> float | None:
        if channel == "speed_rpm" and 4 * 60 + 40 <= second < 7 * 60:
            return math.nan if second == 4 * 60 + 40 else None
        return ramping(channel, second)

    write(store, 10 * 60, values)
    minutes = await minutes_of(make_history(store, clock), START_US, START_US + 10 * MINUTE_US)
    assert np.flatnonzero(~minutes.good).tolist() == [4, 5, 6]


async def test_a_sensor_that_spikes_every_minute_does_not_starve_identification(
    run_store: Store, clock: Any
) -> None:
    """The run of the other tests, six samples a minute, with a spike in each."""
    history = make_history(run_store, clock)
    (calm,) = await history.windows()
    before = await minutes_of(history, *history.span_us(calm))
    # Between two samples; of the first minute only half is there, too little beside a spike.
    spikes = [
        good(LOW, START_US + minute * MINUTE_US + 11_500_000, 180.0, Quality.UNCERTAIN)
        for minute in range(1, 140)
    ]
    run_store.samples.write(spikes)
    assert await history.windows() == [calm]
    after = await minutes_of(history, *history.span_us(calm))
    assert np.array_equal(after.temperatures_c[LOW], before.temperatures_c[LOW])
    assert after.good.all()


@pytest.mark.parametrize("channel", ["speed_rpm", "t_outer_ring_c"])
async def test_a_silent_channel_makes_its_minutes_bad(
    store: Store, clock: Any, channel: str
) -> None:
    def values(name: str, second: float) -> float | None:
        silent = name == channel and 240 <= second < 420
        return None if silent else ramping(name, second)

    write(store, 10 * 60, values)
    minutes = await minutes_of(make_history(store, clock), START_US, START_US + 10 * MINUTE_US)
    bad = np.flatnonzero(~minutes.good).tolist()
    # A temperature is that of the full minute: half a minute more on either side is enough for it.
    assert bad == ([4, 5, 6] if channel == "speed_rpm" else [5, 6])
    assert np.isnan(minutes.speed_rpm[5]) == (channel == "speed_rpm")


async def test_without_an_ambient_sensor_the_coldest_reading_stands_for_it(
    store: Store, clock: Any
) -> None:
    channels = ("speed_rpm", "load_n", "t_inner_ring_c", "t_outer_ring_c")
    write(store, 10 * 60, ramping, channels)
    history = make_history(store, clock, channels={name: {"source": "push"} for name in channels})
    minutes = await minutes_of(history, START_US, START_US + 10 * MINUTE_US)
    assert minutes.good.all()
    assert minutes.ambient_c == pytest.approx(np.full(minutes.size, 20.0), abs=0.5)


@pytest.mark.parametrize("channels", [("speed_rpm", "load_n", "ambient_c"), ("t_node_7_c",)])
async def test_an_asset_without_what_is_needed_has_no_windows(
    store: Store, clock: Any,
    channels: tuple[str, ...],
) -> None:  # fmt: skip
    write(store, 90 * 60, ramping, channels)
    history = make_history(store, clock, channels={name: {"source": "push"} for name in channels})
    assert await history.windows() == []
    problem = await history.problem_with(START_US, START_US + 90 * MINUTE_US)
    assert problem is not None
    assert "no good data" in problem


async def test_an_asset_without_an_ambient_sensor_and_any_data_has_no_windows(
    store: Store, clock: Any
) -> None:
    channels = ("speed_rpm", "load_n", "t_inner_ring_c")
    history = make_history(store, clock, channels={name: {"source": "push"} for name in channels})
    assert await history.windows() == []
    write(store, 90 * 60, lambda *_: math.nan, channels)
    assert await history.windows() == []


async def test_what_has_not_settled_yet_is_left_for_later(run_store: Store, clock: Any) -> None:
    """The newest minute is not over, and the writer may still hold a second of wall time."""
    clock.us = START_US + 60 * MINUTE_US + 59 * SECOND_US
    (window,) = await make_history(run_store, clock).windows()
    # 60 s per wall second: the minute that ended 59 s ago may not be whole in the store.
    assert window.end_s == (START_US + 57 * MINUTE_US) / 1e6


# ---------------------------------------------------------------------- windows
async def test_the_run_is_one_window_that_begins_at_rest(run_store: Store, clock: Any) -> None:
    history = make_history(run_store, clock)
    (window,) = await history.windows()
    assert window.at_rest
    assert [round(point.speed_rpm, -2) for point in window.operating_points] == [1500, 2400, 4200]
    assert window.start_s == START_US / 1e6
    (shown,) = await history.window_documents()
    assert shown.start < shown.end
    assert shown.speed_rpm_max == pytest.approx(4200.0, abs=1)
    assert shown.load_n_max == pytest.approx(2650.0, abs=1)
    assert [point.duration_s for point in shown.operating_points] == [2700.0] * 3
    assert 0.0 < shown.score <= 1.0


async def test_a_found_window_may_be_asked_for(run_store: Store, clock: Any) -> None:
    history = make_history(run_store, clock)
    (window,) = await history.windows()
    assert await history.problem_with(*history.span_us(window)) is None
    minutes = await minutes_of(history, *history.span_us(window))
    assert minutes.time_s[0] == window.start_s
    assert minutes.time_s[-1] == window.end_s


async def test_the_low_risk_region_bounds_the_window(run_store: Store, clock: Any) -> None:
    low = {"speed_rpm_max": 3000, "load_n_max": 3400}
    (window,) = await make_history(run_store, clock, low_risk=low).windows()
    assert window.speed_rpm_max == pytest.approx(2400, abs=1)
    assert window.end_s == (START_US + 94 * MINUTE_US) / 1e6


async def test_noise_at_the_edge_of_the_region_is_no_reason_to_refuse(
    run_store: Store, clock: Any
) -> None:
    """What `find_windows` takes by itself may be asked for as well."""
    history = make_history(run_store, clock, low_risk={"speed_rpm_max": 4150, "load_n_max": 2650})
    (window,) = await history.windows()
    assert window.speed_rpm_max == pytest.approx(4200, abs=1)
    assert await history.problem_with(*history.span_us(window)) is None


@pytest.mark.parametrize(
    ("from_min", "to_min", "problem"),
    [
        (-300, -100, "no good data from"),
        (5, 30, "less than 30 min of good data on the running machine (25 min)"),
        (0, 20, "less than 30 min of good data on the running machine (15 min)"),
        (5, 200, None),
        (5, 95, None),
    ],
)
async def test_the_problem_with_a_span_is_told(
    run_store: Store, clock: Any,
    from_min: int, to_min: int, problem: str | None,
) -> None:  # fmt: skip
    history = make_history(run_store, clock)
    found = await history.problem_with(
        START_US + from_min * MINUTE_US, START_US + to_min * MINUTE_US
    )
    assert found == problem or (problem is not None and problem in (found or ""))


async def test_a_span_outside_the_low_risk_region_is_refused_with_how_much(
    run_store: Store, clock: Any
) -> None:
    low = {"speed_rpm_max": 3000, "load_n_max": 3400}
    history = make_history(run_store, clock, low_risk=low)
    found = await history.problem_with(START_US, START_US + 120 * MINUTE_US)
    assert found == "25 min are outside the low-risk region (3000 rpm, 3400 N)"


async def test_standing_data_teach_nothing(store: Store, clock: Any) -> None:
    def standing(channel: str, _: float) -> float:
        return 0.0 if channel == "speed_rpm" else 23.0

    write(store, 40 * 60, standing)
    found = await make_history(store, clock).problem_with(START_US, START_US + 40 * MINUTE_US)
    assert found == "less than 30 min of good data on the running machine (0 min)"


# ---------------------------------------------------------------------- data sets
async def test_revolutions_before_a_window_are_counted(run_store: Store, clock: Any) -> None:
    spans = [
        (START_US, START_US + 50 * MINUTE_US),
        (START_US + 50 * MINUTE_US, START_US + 95 * MINUTE_US),
    ]
    data = await make_history(run_store, clock).identification_data(spans)
    first, second = data.windows
    assert (first.at_rest, second.at_rest) == (True, False)
    assert first.revolutions == 0.0
    assert second.revolutions == pytest.approx(45 * 1500.0, rel=1e-6)


async def test_a_span_without_data_is_an_error_that_names_it(run_store: Store, clock: Any) -> None:
    with pytest.raises(ValueError, match=r"no data from 1970.* to 2025"):
        await make_history(run_store, clock).identification_data([(0, START_US)])


# ---------------------------------------------------------------------- worth it
async def test_two_new_points_are_worth_a_first_identification(
    run_store: Store, clock: Any
) -> None:
    history = make_history(run_store, clock)
    assert not await history.are_worth_identifying([], [])
    clock.us = START_US + 55 * MINUTE_US
    one = await history.windows()
    assert not await history.are_worth_identifying(one, [])
    clock.us = START_US + 90 * MINUTE_US
    two = await history.windows()
    assert await history.are_worth_identifying(two, [])
    assert not await history.are_worth_identifying(two, two), "tried before, to no avail"
    clock.us = START_US + 135 * MINUTE_US
    three = await history.windows()
    assert await history.are_worth_identifying(three, two), "something new has come"


async def test_what_a_version_was_identified_from_is_not_new(run_store: Store, clock: Any) -> None:
    history = make_history(run_store, clock)
    found = await history.windows()
    document = {"window_records": [window.to_dict() for window in found]}
    run_store.models.add("bench-1", "rejected", "", document, START_US)
    assert not await history.are_worth_identifying(found, [])


STATOR = Path(__file__).parents[3] / "deploy" / "networks" / "stator.toml"


async def test_rows_of_a_fast_network_are_as_fine_as_it_needs_and_carry_its_inputs(
    store: Store, clock: Any
) -> None:
    channels = ("speed_rpm", "load_n", "ambient_c", "power_w", "t_winding_c", "t_body_c")
    history = make_history(
        store,
        clock,
        bearing=None,
        network=read_network(STATOR).model_dump(mode="json"),
        limits={},
        channels={name: {"source": "push"} for name in channels},
    )
    write(store, 600, ramping, channels)
    minutes = await minutes_of(history, START_US, START_US + 10 * MINUTE_US)
    step_s = float(np.median(np.diff(minutes.time_s)))
    assert 1.0 <= step_s <= 5.0
    assert minutes.size >= 590 / step_s
    power = minutes.inputs["power_w"]
    # Over each step, as the operating point.
    expected = 20.0 + (minutes.time_s - START_US / 1e6 + (step_s - 1.0) / 2.0) / 60.0
    np.testing.assert_allclose(power[:-1], expected[:-1], atol=1e-6)
