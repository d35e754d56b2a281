"""The study of alarms: one short run for real, and what the report makes of several."""

from dataclasses import fields

import pytest

from adapters.virtual_bench import BenchParameters, MeasuredRun, find_scenario
from bearing_twin_laboratory.studies import alarm_runs
from bearing_twin_laboratory.studies.alarm_runs import AlarmRun, Call, Fault
from bearing_twin_laboratory.studies.alarms import STUDY
from twin_core.bearings import bearing
from twin_core.identification.posterior import prior_posterior
from twin_core.models import build_model


def test_a_broken_sensor_is_told_at_once_and_its_values_raise_nothing() -> None:
    scenario = find_scenario("sensor-break")
    bench = BenchParameters.random(7, alarm_runs.BEARING)
    seen = alarm_runs._break(scenario, alarm_runs._measured(scenario, bench, 7))
    cut = MeasuredRun(**{one.name: getattr(seen, one.name)[:140] for one in fields(MeasuredRun)})
    assert cut.t_inner_ring_c.min() < -1000.0
    limits = dict.fromkeys(alarm_runs.RINGS, 60.0)
    hottest = limits | {f"{name} above ambient": 40.0 for name in limits}
    faults = tuple(Fault(one.channel, one.start_s / 3600.0) for one in scenario.faults[:2])
    posterior = prior_posterior(build_model(bearing=bearing(alarm_runs.BEARING)))
    run = alarm_runs._watched("sensor-break", 7, cut, posterior, hottest, faults, 0.0)
    assert [(call.kind, call.channel) for call in run.calls] == [
        ("sensor fault", "t_inner_ring_c"),
        ("sensor fault", "t_outer_ring_c"),
    ]
    for call, fault in zip(run.calls, run.faults, strict=True):
        assert 0.0 < (call.time_h - fault.onset_h) * 3600.0 <= 30.0


def test_false_alarms_are_counted_per_1000_h_and_delays_from_the_onset() -> None:
    calm = Call("rate of rise", "t_inner_ring_c", "warning", 50.0)
    early = Call("twin residual", "t_outer_ring_c", "", 53.0)
    late = Call("twin residual", "t_outer_ring_c", "", 60.0)
    later = Call("twin residual", "t_outer_ring_c", "", 64.0)
    broken = [
        Call("sensor fault", "t_inner_ring_c", "", 1.01),
        Call("sensor fault", "t_inner_ring_c", "", 2.01),  # of another sensor's time
    ]
    found = STUDY.report(
        [
            [
                AlarmRun("unchanged", 1, 150.0, (calm, calm), ()),
                AlarmRun("unchanged, other plans", 1, 100.0, (), ()),
                AlarmRun("cooling-loss", 1, 60.0, (early, late, later), (Fault("", 54.0),)),
                AlarmRun("cooling-loss", 2, 60.0, (), (Fault("", 54.0),)),
                AlarmRun(
                    "sensor-break",
                    1,
                    1.5,
                    tuple(broken),
                    (Fault("t_inner_ring_c", 1.0), Fault("t_outer_ring_c", 2.0)),
                ),
            ]
        ]
    )
    document = found.document
    assert document["fault_free_hours"] == 250.0
    assert document["false_alarms_per_1000_h"]["rate of rise"] == 8.0
    assert document["false_alarms_per_1000_h"]["twin residual"] == 0.0
    assert document["detection"]["cooling-loss"]["twin residual"] == {
        "told": 1,
        "faults": 2,
        "median_delay_s": 21_600.0,
        "longest_delay_s": 21_600.0,
    }
    sensors = document["detection"]["sensor-break"]["sensor fault"]
    assert (sensors["told"], sensors["faults"]) == (1, 2)
    assert sensors["median_delay_s"] == pytest.approx(36.0)
    assert "6.0 h (1 of 2)" in found.tables[1].markdown()
    assert "8.00" in found.tables[0].markdown()
