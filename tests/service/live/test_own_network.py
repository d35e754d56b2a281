"""A live asset with a network of its own."""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from service.domain.requests import ProfileStep
from service.jobs.models import active_model, first_model, why_not_of_this_asset
from service.site.asset_section import AssetSection
from service.site.machines.networks import read_network
from service.store.records import ModelVersion

GEARBOX = Path(__file__).parents[3] / "deploy" / "networks" / "gearbox.toml"
WARM = {
    "speed_rpm": 1400.0,
    "load_n": 2500.0,
    "ambient_c": 20.0,
    "t_bearing_c": 55.0,
    "t_oil_c": 45.0,
}


def section(channels: dict[str, float] = WARM, **changes: Any) -> AssetSection:
    return AssetSection.model_validate(
        {
            "id": "bench-1",
            "network": read_network(GEARBOX).model_dump(mode="json"),
            "low_risk": {"speed_rpm_max": 2000, "load_n_max": 4000},
            "limits": {"t_bearing_c": {"warning": 58, "alarm": 95}},
            "channels": {name: {"source": "push"} for name in channels},
        }
        | changes
    )


def stored(settings: AssetSection) -> ModelVersion:
    document = json.loads(json.dumps(first_model(settings)))
    return ModelVersion("bench-1", 1, "active", "", 0, document)


async def test_its_nodes_and_sensors_are_in_every_answer(make_live: Callable[..., Any]) -> None:
    settings = section()
    live = make_live(settings, active_model(settings, stored(settings)))
    live.start()
    forecast = await live.until(live.documents.forecast, "a forecast", WARM)
    nodes = {"t_bearing_c", "t_housing_c", "t_oil_c"}
    assert set(live.documents.state().nodes) == nodes
    assert set(forecast.nodes) == nodes | {"t_wall_c"}
    assert set(forecast.time_to_limit) == {"t_bearing_c"}
    tags = live.documents.snapshot()["tags"]
    assert {f"{name}.twin" for name in (*nodes, "t_wall_c")} <= set(tags)
    assert "t_inner_ring_c.twin" not in tags
    assert tags["t_bearing_c.twin"]["value"] == pytest.approx(55.0, abs=2.0)
    assert tags["t_bearing_c.forecast_max"]["unit"] == "°C"
    shown = live.documents.summary()
    assert (shown.bearing, shown.network) == (None, "gearbox")
    await live.until(lambda: live.stored, "an estimate for the store", WARM)
    assert {sample.channel for sample in live.stored} == {"t_bearing_c.twin", "t_wall_c.twin"}
    answer = live.what_if(
        [ProfileStep(duration_s=3600.0, speed_rpm=2000.0, load_n=4000.0)], 600.0, ["t_oil_c"]
    )
    assert set(answer.nodes) == {"t_oil_c"}
    assert live.documents.temperature_names == ("t_bearing_c", "t_wall_c", "t_housing_c", "t_oil_c")
    kept = live.runtime.estimate.to_dict()
    again = make_live(settings, active_model(settings, stored(settings)))
    again.runtime.estimate.restore(json.loads(json.dumps(kept)))
    assert again.runtime.estimate.started


def test_a_version_of_another_network_or_bearing_cannot_run_the_asset() -> None:
    settings = section()
    version = stored(settings)
    assert why_not_of_this_asset(settings, version) is None
    network = read_network(GEARBOX).model_dump(mode="json")
    network["nodes"]["t_oil_c"]["capacity_j_k"] = 9000.0
    changed = section(network=network)
    assert why_not_of_this_asset(changed, version) == (
        "the dimensions or the network of 'gearbox' have been changed since"
    )
    rings = dict.fromkeys(("speed_rpm", "load_n", "ambient_c", "t_inner_ring_c"), 0.0)
    bearing = section(rings, network="bearing-14", bearing="6311", limits={})
    assert "does not belong to model 'default'" in str(why_not_of_this_asset(bearing, version))
    larger = section(
        rings,
        network="bearing-14",
        bearing={"designation": "6311", "bore_mm": 55, "outer_mm": 120, "width_mm": 30},
        limits={},
    )
    assert why_not_of_this_asset(larger, stored(bearing)) == (
        "the dimensions or the network of '6311' have been changed since"
    )


STATOR = Path(__file__).parents[3] / "deploy" / "networks" / "stator.toml"
HEATED = {
    "speed_rpm": 0.0,
    "load_n": 0.0,
    "ambient_c": 20.0,
    "power_w": 200.0,
    "t_winding_c": 60.0,
    "t_body_c": 45.0,
}


async def test_inputs_drive_the_estimate_and_every_forecast(make_live: Callable[..., Any]) -> None:
    settings = section(
        HEATED,
        network=read_network(STATOR).model_dump(mode="json"),
        limits={"t_winding_c": {"warning": 120, "alarm": 140}},
    )
    live = make_live(settings, active_model(settings, stored(settings)))
    live.start()
    without = {name: value for name, value in HEATED.items() if name != "power_w"}
    for _ in range(50):
        live.feed(without)
        await asyncio.sleep(0.01)
    assert not live.runtime.estimate.started, "nothing is known of the power yet"
    forecast = await live.until(live.documents.forecast, "a forecast", HEATED)
    estimate = live.runtime.estimate
    assert estimate.point is not None
    assert estimate.point.inputs == (200.0,)
    assert estimate.observer.state().inputs == (200.0,)
    last = forecast.nodes["t_winding_c"].q50[-1]
    assert last > 40.0
    kept = estimate.to_dict()
    assert kept["inputs"] == [200.0]
    again = make_live(settings, active_model(settings, stored(settings)))
    again.runtime.estimate.restore(json.loads(json.dumps(kept)))
    assert again.runtime.estimate.point == estimate.point
    answer = live.what_if(
        [ProfileStep(duration_s=4 * 3600.0, speed_rpm=0.0, load_n=0.0)], 600.0, None
    )
    assert answer.nodes["t_winding_c"].q50[-1] == pytest.approx(last, abs=5.0)
