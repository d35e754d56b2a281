"""A first start beside a warm machine, or one after a restart that kept no estimate.

How warm a body without a sensor is can only be guessed then, and where the machine is going is not
known from seconds: the forecast must be as wide as that, and say so.
"""

import asyncio
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from own_networks import MOTOR
from patience import within
from site_files import COLUMNS, asset_section

from service.clock import ProcessClock
from service.live.envelope_keeper import EnvelopeKeeper
from service.live.estimate import LiveEstimate, RunningModel
from service.live.forecasting import Forecasting
from service.live.readings import Readings
from service.site.asset_section import AssetSection
from service.site.machines.machine import Machine
from service.site.machines.networks import read_network
from twin_core.identification import FitSettings, identify
from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.machine_state import FOLLOWED_S, course_known
from twin_core.models import ThermalModel
from twin_core.operating_points import usual_levels
from twin_core.simulation import OperatingProfile, simulate
from twin_core.windows import MinuteData

TRUE = (1.15, 0.85, 1.2, 0.9)
AMBIENT_C = 22.0
START_US = 1_763_700_000_000_000
STEP_S = 5
BEFORE_S, HOUR_S = 120, 3600
USUAL = (2500.0, 1500.0)
MOMENTS = {"full load": (5000.0, 6000.0), "a light moment": (300.0, 100.0)}
LABEL = "initial state of t_body_c known to ±"


def motor_section(folder: Path) -> AssetSection:
    file = folder / "motor.toml"
    file.write_text(MOTOR)
    return asset_section(
        channels=(*COLUMNS, "t_winding_c"),
        bearing=None,
        network=read_network(file).model_dump(mode="json"),
        low_risk={"speed_rpm_max": 6000, "load_n_max": 8000},
        limits={"t_winding_c": {"warning": 150, "alarm": 170}},
    )


def run_of(
    model: ThermalModel, time_s: np.ndarray, speed: np.ndarray, load: np.ndarray, start_c: Any
) -> np.ndarray:
    """True temperatures (n, 2) of a motor that differs from the centre of the priors."""
    profile = OperatingProfile(time_s, speed, load, np.full(time_s.size, AMBIENT_C))
    values = model.parameters.centre * TRUE
    return simulate(model, values, profile, np.asarray(start_c, float)).temperatures_c


@pytest.fixture(scope="module")
def motor(tmp_path_factory: pytest.TempPathFactory) -> RunningModel:
    """Identified from two hours of driving, minute by minute, the body without a sensor."""
    file = tmp_path_factory.mktemp("motor") / "motor.toml"
    file.write_text(MOTOR)
    model = Machine("default", None, read_network(file)).build()
    rng = np.random.default_rng(12)
    time_s = np.arange(0.0, 7200.0, 1.0)
    blocks = (time_s // 20.0).astype(int)
    load = (USUAL[1] * np.exp(0.8 * rng.standard_normal(blocks[-1] + 1)))[blocks].clip(0.0, 6000.0)
    speed = (USUAL[0] * np.exp(0.4 * rng.standard_normal(blocks[-1] + 1)))[blocks].clip(0.0, 5000.0)
    winding_c = run_of(model, time_s, speed, load, (AMBIENT_C, AMBIENT_C))[::60, 0]
    minutes = MinuteData(
        time_s[::60],
        speed.reshape(-1, 60).mean(axis=1),
        load.reshape(-1, 60).mean(axis=1),
        np.full(winding_c.size, AMBIENT_C),
        {"t_winding_c": winding_c + 0.05 * rng.standard_normal(winding_c.size)},
        np.ones(winding_c.size, dtype=bool),
    )
    data = IdentificationData((IdentificationWindow(minutes, at_rest=True),))
    found = identify(model, data, FitSettings(method="refine", samples=0))
    assert found.posterior.trained.duty
    return RunningModel(1, model, found.posterior, START_US)


def course(
    motor: RunningModel,
    moment: tuple[float, float],
    body_c: float,
    then: tuple[float, float] = USUAL,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Speed, load and true temperatures every second: two minutes at a moment, then another."""
    time_s = np.arange(0.0, BEFORE_S + 2 * HOUR_S, 1.0)
    before = time_s < BEFORE_S
    speed, load = (np.where(before, moment[k], then[k]) for k in range(2))
    truth = run_of(motor.model, time_s, speed, load, (body_c + 25.0, body_c))
    return speed, load, truth


def means(speed: np.ndarray, load: np.ndarray, truth: np.ndarray, second: int) -> dict[str, float]:
    """What a step of the twin is given: means over the last five seconds."""
    span = slice(second - STEP_S, second)
    return {
        "speed_rpm": float(speed[span].mean()),
        "load_n": float(load[span].mean()),
        "ambient_c": AMBIENT_C,
        "t_winding_c": float(truth[second - STEP_S + 1 : second + 1, 0].mean()),
    }


@pytest.mark.parametrize("body_c", [75.0, 90.0, 105.0])
@pytest.mark.parametrize("moment", MOMENTS)
async def test_what_comes_lies_in_the_band_of_a_forecast_seconds_after_the_start(
    moment: str, body_c: float, motor: RunningModel, tmp_path: Path, executor: ThreadPoolExecutor
) -> None:
    """The twin starts ten seconds before the moment ends."""
    speed, load, truth = course(motor, MOMENTS[moment], body_c)
    clock = ProcessClock(1.0)
    estimate = LiveEstimate(motor)
    readings = Readings("bench-1", {}, clock.now_us())
    section = motor_section(tmp_path)
    forecasting = Forecasting(section, estimate, readings, clock, executor)
    now = BEFORE_S - 10
    while now <= BEFORE_S + 10:
        estimate.step(START_US + now * 1_000_000, means(speed, load, truth, now))
        now += STEP_S
    now -= STEP_S
    assert await forecasting.make()
    forecast = forecasting.latest
    assert forecast is not None
    hour = [row for row, time_s in enumerate(forecast.time_s) if time_s <= HOUR_S]
    came_s = now + np.array(forecast.time_s)[hour].astype(int)
    for column, name in enumerate(("t_winding_c", "t_body_c")):
        quantiles = forecast.nodes[name]
        low, high = (np.array(getattr(quantiles, level))[hour] for level in ("q025", "q975"))
        came_c = truth[came_s, column]
        assert np.mean((low <= came_c) & (came_c <= high)) > 0.9, (name, low, came_c, high)
    body = forecast.nodes["t_body_c"]
    half_k = (body.q975[0] - body.q025[0]) / 2.0
    said = [label for label in forecast.labels if label.startswith("initial state")]
    doubtful = half_k > 5.0 * motor.model.errors.scale
    assert said == ([f"{LABEL}{half_k:.0f} K only"] if doubtful else [])
    assert doubtful or moment != "full load"


def test_no_limit_is_reached_before_the_earliest_time_of_the_envelope(
    motor: RunningModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its members are on no course that was seen for seconds only, either."""
    monkeypatch.setattr("service.live.envelope_keeper.SPEEDS", 4)
    monkeypatch.setattr("service.live.envelope_keeper.LOADS", 4)
    speed, load, truth = course(motor, MOMENTS["a light moment"], 90.0)
    estimate = LiveEstimate(motor)
    now = BEFORE_S + 10
    for second in range(BEFORE_S - 10, now + 1, STEP_S):
        estimate.step(START_US + second * 1_000_000, means(speed, load, truth, second))
    settings = motor_section(tmp_path)
    state = estimate.state()
    assert state is not None
    document = EnvelopeKeeper(settings).document(state, [], {})
    maps = document.sensors["t_winding_c"].limits
    time_s = np.arange(0.0, 4.0 * HOUR_S)
    reached = 0
    for row, load_n in enumerate(document.load_n):
        for column, speed_rpm in enumerate(document.speed_rpm):
            held = np.full(time_s.size, speed_rpm), np.full(time_s.size, load_n)
            winding_c = run_of(motor.model, time_s, *held, truth[now])[:, 0]
            for level in ("warning", "alarm"):
                over = np.flatnonzero(winding_c >= maps[level].limit_c)
                if over.size:
                    reached += 1
                    earliest_s = maps[level].earliest_s[row][column]
                    assert earliest_s is not None
                    assert earliest_s <= over[0] + 1, (level, speed_rpm, load_n)
    assert reached > 10


@pytest.mark.parametrize("body_c", [75.0, 90.0, 105.0])
def test_a_motor_that_has_just_stopped_is_not_taken_for_one_that_stands(
    body_c: float, motor: RunningModel
) -> None:
    """Its winding is still as warm above the body as the heavier third of its duty makes it."""
    heavier = usual_levels(motor.posterior.trained.points)[-1]
    speed, load, truth = course(motor, heavier, body_c, then=(0.0, 0.0))
    estimate = LiveEstimate(motor)
    now = BEFORE_S + STEP_S
    estimate.step(START_US, means(speed, load, truth, now))
    mean_c, std_k = estimate.observer.sensor("t_body_c")
    assert abs(mean_c - truth[now, 1]) < 1.96 * std_k


async def test_the_label_stays_over_a_restart_and_goes_when_the_filter_has_learned(
    motor: RunningModel, tmp_path: Path, make_live: Callable[..., Any]
) -> None:
    speed, load, truth = course(motor, MOMENTS["full load"], 90.0)

    def machine(live: Any, begun_us: int) -> dict[str, float]:
        second = BEFORE_S - 10 + (live.clock.now_us() - begun_us) // 1_000_000
        return means(speed, load, truth, min(max(second, STEP_S), speed.size - 1))

    def labels(live: Any) -> list[str]:
        forecast = live.documents.forecast()
        return [] if forecast is None else [one for one in forecast.labels if LABEL in one]

    async def until(live: Any, look: Callable[[], Any], what: str) -> None:
        async with within(60.0):
            while not look():
                assert not live.task.done(), f"the twin ended before {what}"
                live.feed(machine(live, begun_us))
                await asyncio.sleep(0.02)

    section = motor_section(tmp_path)
    first = make_live(section, motor)
    begun_us = first.clock.now_us()
    first.start()
    await until(first, first.runtime.documents.forecast, "a forecast")
    assert labels(first), first.runtime.documents.forecast().labels
    await first.stop()
    kept = json.loads(json.dumps(first.saved[-1]))
    assert 0.0 <= kept["followed_s"] < FOLLOWED_S
    second = make_live(section, motor)
    second.start(kept)
    await until(second, second.runtime.documents.forecast, "a forecast after the restart")
    assert labels(second), "what was kept is known no better for it"
    await until(second, lambda: not labels(second), "the end of the label")
    assert course_known(second.runtime.estimate.followed_s) == 1.0
    now = BEFORE_S - 10 + (second.runtime.estimate.time_us - begun_us) // 1_000_000
    mean_c, std_k = second.runtime.estimate.observer.sensor("t_body_c")
    assert abs(mean_c - truth[now, 1]) < 1.96 * std_k


def test_only_what_was_seen_counts_as_followed(motor: RunningModel) -> None:
    """Neither time without temperatures nor a stop of the service teaches anything."""
    speed, load, truth = course(motor, USUAL, 90.0)
    estimate = LiveEstimate(motor)
    for second in range(60, 660, STEP_S):
        estimate.step(START_US + second * 1_000_000, means(speed, load, truth, second))
    assert estimate.followed_s == pytest.approx(595.0)
    blind = means(speed, load, truth, 700)
    del blind["t_winding_c"]
    for second in range(660, 1260, STEP_S):
        estimate.step(START_US + second * 1_000_000, blind)
    assert estimate.followed_s == pytest.approx(595.0)
    again = LiveEstimate(motor)
    again.restore(json.loads(json.dumps(estimate.to_dict())))
    assert again.followed_s == pytest.approx(595.0)
    again.step(START_US + 2500 * 1_000_000, means(speed, load, truth, 2500))
    assert again.started, "a short stop"
    assert again.followed_s < 595.0 + 600.0
    much_later = 2500 + 2 * HOUR_S
    again.step(START_US + much_later * 1_000_000, means(speed, load, truth, 3000))
    assert again.followed_s == 0.0, "a new start"


def test_a_cold_machine_at_rest_is_known(motor: RunningModel) -> None:
    estimate = LiveEstimate(motor)
    cold = {"speed_rpm": 0.0, "load_n": 0.0, "ambient_c": AMBIENT_C, "t_winding_c": AMBIENT_C}
    estimate.step(START_US, cold)
    assert course_known(estimate.followed_s) == 1.0


def test_an_estimate_kept_by_an_older_version_counts_from_now(motor: RunningModel) -> None:
    speed, load, truth = course(motor, USUAL, 90.0)
    estimate = LiveEstimate(motor)
    estimate.step(START_US, means(speed, load, truth, 60))
    kept = {
        name: value for name, value in (estimate.to_dict() or {}).items() if name != "followed_s"
    }
    again = LiveEstimate(motor)
    again.restore(kept)
    assert again.followed_s == 0.0
    for wrong in (-1.0, float("nan"), "long"):
        with pytest.raises(ValueError, match=r"kept estimate|could not convert"):
            LiveEstimate(motor).restore(kept | {"followed_s": wrong})
