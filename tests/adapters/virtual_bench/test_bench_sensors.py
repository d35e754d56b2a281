from dataclasses import replace

import numpy as np
import pytest

from adapters.virtual_bench import (
    BenchParameters,
    SensorParameters,
    find_scenario,
    measure,
    scenario_profile,
    simulate,
)
from adapters.virtual_bench.controller import RunState
from adapters.virtual_bench.live import TRUTH_COLUMNS, LiveBench
from adapters.virtual_bench.modbus_server import transmitter_registers
from adapters.virtual_bench.scenarios import BenchPhase, Scenario
from adapters.virtual_bench.sensors import Noise, Pt100

_QUIET = SensorParameters(
    offset_sd_k=0.0, white_sd_k=0.0, drift_sd_k=0.0, resolution_k=1e-6, speed_sd_rpm=0.0
)


def test_pt100_lags_twenty_seconds() -> None:
    shown = Pt100(0, 0, 20.0, _QUIET).convert(np.full(60, 30.0))
    assert shown[19] == pytest.approx(20.0 + 10.0 * (1.0 - np.exp(-1.0)), abs=1e-3)
    assert shown[-1] == pytest.approx(30.0, abs=0.6)


def test_pt100_errors_have_their_sizes() -> None:
    parameters = SensorParameters()
    shown = np.array(
        [Pt100(seed, 0, 50.0, parameters).convert(np.full(400, 50.0)) for seed in range(200)]
    )
    assert np.abs(shown * 10.0 - np.round(shown * 10.0)).max() < 1e-6  # resolution 0.1 K
    assert np.std(shown.mean(axis=1)) == pytest.approx(np.hypot(0.1, 0.05), rel=0.25)
    within = shown - shown.mean(axis=1, keepdims=True)
    assert np.std(within) == pytest.approx(np.hypot(0.05, 0.1 / np.sqrt(12)), rel=0.3)


def test_noise_depends_on_the_tick_only() -> None:
    forward = Noise(3, 1).values(0, 5000)
    jumping = Noise(3, 1)
    assert [jumping.value(tick) for tick in (4999, 0, 1024, 17)] == [
        forward[tick] for tick in (4999, 0, 1024, 17)
    ]
    assert not np.array_equal(forward[:10], Noise(3, 2).values(0, 10))
    assert not np.array_equal(forward[:10], Noise(4, 1).values(0, 10))
    assert np.std(forward) == pytest.approx(1.0, abs=0.05)


def _look(bench: LiveBench, moments: list[float], between: float) -> list[object]:
    seen: list[object] = []
    for moment in moments:
        while bench.time_s + between < moment:
            bench.advance(bench.time_s + between)
        bench.advance(moment)
        seen.append(
            (bench.transmitters(), bench.controller_state(), bench.speed_rpm(), bench.load_n())
        )
    return seen


def test_same_seed_shows_the_same_however_often_one_looks() -> None:
    scenario = find_scenario("demo")
    moments = [1.5, 60.0, 200.25, 777.7, 1800.0]
    often, seldom = LiveBench(scenario, 7), LiveBench(scenario, 7)
    assert _look(often, moments, 0.37) == _look(seldom, moments, 1e9)
    assert often.take_truth() == seldom.take_truth()
    assert _look(LiveBench(scenario, 8), moments, 1e9) != _look(
        LiveBench(scenario, 7), moments, 1e9
    )


def test_offline_run_gives_what_the_live_bench_shows() -> None:
    scenario = find_scenario("rapid-acceleration")
    bench, seed = BenchParameters.for_bearing("6311"), 11
    profile = scenario_profile(scenario, bench, seed)
    truth = simulate(profile, bench)
    measured = measure(profile, truth, seed)
    live = LiveBench(scenario, seed)
    live.advance(1800.0)
    columns = dict(zip(TRUTH_COLUMNS, live.take_truth()[-1], strict=True))
    assert columns["time_s"] == 1800.0
    assert columns["t_inner_ring_c"] == pytest.approx(truth.t_inner_ring_c[1800], abs=1e-9)
    assert columns["t_node_7_c"] == pytest.approx(truth.paper_nodes_c[1800, 6], abs=1e-9)
    shown = live.transmitters()
    assert shown["t_inner_ring_c"].temperature_c == measured.t_inner_ring_c[1800]
    assert shown["t_outer_ring_c"].temperature_c == measured.t_outer_ring_c[1800]
    assert shown["ambient_c"].temperature_c == measured.ambient_c[1800]


def test_measuring_needs_even_rows() -> None:
    bench = BenchParameters.for_bearing("6311")
    profile = scenario_profile(find_scenario("demo"), bench, 0, step_s=600.0)
    uneven = replace(profile, time_s=profile.time_s**1.01)
    with pytest.raises(ValueError, match="even spacing"):
        measure(uneven, simulate(uneven, bench, max_step_s=60.0), 0)


def test_sensor_break_runs_through_every_fault_and_recovers() -> None:
    bench = LiveBench(find_scenario("sensor-break"), 0)
    seen: dict[str, set[tuple[int, int]]] = {}
    lost = {"speed_rpm": 0, "load_n": 0}
    for minute in range(90):
        bench.advance(60.0 * minute + 30.0)
        values, status = transmitter_registers(bench.transmitters())
        for channel, raw, word in zip(bench.transmitters(), values, status, strict=True):
            if word:
                seen.setdefault(channel, set()).add((raw, word))
        lost["speed_rpm"] += bench.speed_rpm() is None
        lost["load_n"] += bench.load_n() is None
    assert seen == {
        "t_inner_ring_c": {(0x8000, 1)},
        "t_outer_ring_c": {(0x7FFF, 4), (0x8000, 2)},
        "ambient_c": {(0x7FFF, 4)},
    }
    assert lost == {"speed_rpm": 3, "load_n": 4}
    assert transmitter_registers(bench.transmitters())[1] == [0, 0, 0]


def test_registers_carry_negative_temperatures_as_int16() -> None:
    cold = replace(BenchParameters.for_bearing("6311"), ambient_c=-12.0)
    bench = LiveBench(find_scenario("demo"), 0, cold)
    values, status = transmitter_registers(bench.transmitters())
    assert all(raw > 0xFF00 for raw in values)
    assert all(raw - 0x10000 == pytest.approx(-120, abs=15) for raw in values)
    assert status == [0, 0, 0]


def test_thermostat_stops_a_bench_that_runs_away() -> None:
    tight = replace(BenchParameters.for_bearing("6311"), clearance_um=12.0, preload_share=1.0)
    scenario = Scenario("hot", "", "6311", (BenchPhase("hot", 36_000.0, 6200.0, 5500.0, "high"),))
    bench = LiveBench(scenario, 0, tight)
    bench.advance(36_000.0)
    assert bench.controller_state().run_state is RunState.FAULT
    assert bench.speed_rpm() == 0.0
    hottest = max(row[TRUTH_COLUMNS.index("t_inner_ring_c")] for row in bench.take_truth())
    assert 130.0 < hottest < 140.0


def test_encoder_and_load_cell_are_never_negative() -> None:
    bench = LiveBench(find_scenario("demo"), 3)
    assert bench.speed_rpm() == 0.0
    bench.advance(1e9 / 1e4)
    assert bench.controller_state().run_state is RunState.FINISHED
    load = bench.load_n()
    assert load is not None
    assert load >= 0.0
