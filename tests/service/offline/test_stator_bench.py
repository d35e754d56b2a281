"""The shipped stator network on recorded heating runs, where they are.

``BEARING_TWIN_STATOR_DATA`` names the folder with the recorded files; on made-up runs always.
"""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.offline.forecasting import follow, forecast_profile
from service.offline.identification import identify_recording
from service.offline.model_file import IdentifiedModel
from service.offline.tables import PlannedRows, Recording, read_recording
from service.site.machines.machine import Machine
from service.site.machines.networks import NetworkSection, read_network
from twin_core.simulation import OperatingProfile, simulate

NETWORK = Path(__file__).parents[3] / "deploy" / "networks" / "stator.toml"
RECORDED = Path(os.environ.get("BEARING_TWIN_STATOR_DATA", "/nowhere"))
HEATING_W = 100.0


def part(recording: Recording, rows: slice) -> Recording:
    return replace(
        recording,
        time_s=recording.time_s[rows],
        speed_rpm=recording.speed_rpm[rows],
        load_n=recording.load_n[rows],
        ambient_c=recording.ambient_c[rows],
        temperatures_c={name: of[rows] for name, of in recording.temperatures_c.items()},
        inputs={name: of[rows] for name, of in recording.inputs.items()},
    )


def judged(found: IdentifiedModel, run: Recording) -> dict[str, tuple[float, float]]:
    """Rms error in K and share in the 95 % band of a forecast made when the heating begins."""
    power = run.inputs["power_w"]
    known = np.flatnonzero(np.isfinite(power) & np.isfinite(run.ambient_c))
    begin = int(np.flatnonzero(power > HEATING_W)[0])
    rows = known[known >= begin]
    planned = PlannedRows(
        run.time_s[rows] - run.time_s[begin],
        np.zeros(rows.size),
        np.zeros(rows.size),
        run.ambient_c[rows],
        power[rows, None],
    )
    made = forecast_profile(found, follow(found, part(run, slice(0, begin + 1))), planned)
    result = {}
    for name in made.sensors:
        quantiles = made.quantiles[:, :, made.names.index(name)]
        measured = run.temperatures_c[name][rows]
        inside = (measured >= quantiles[0]) & (measured <= quantiles[-1])
        rms_k = float(np.sqrt(np.mean((quantiles[2] - measured) ** 2)))
        result[name] = rms_k, float(np.mean(inside))
    return result


def heated(section: NetworkSection, power_w: float, seconds: int, seed: int) -> Recording:
    """A run of the network itself with true parameters off the prior's centre, and noise."""
    model = Machine("default", None, section).build()
    values = model.parameters.centre.copy()
    for name, factor in (("slot", 1.5), ("body", 0.8), ("seat", 1.5), ("body_air", 0.5)):
        values[model.parameters.index(name)] *= factor
    rng = np.random.default_rng(seed)
    time_s = np.arange(float(seconds))
    power = np.where(time_s < 20.0, 0.0, power_w) * rng.uniform(0.9, 1.1, time_s.size)
    ambient, none = np.full(time_s.size, 21.0), np.zeros(time_s.size)
    profile = OperatingProfile(time_s, none, none, ambient, power[:, None])
    path = simulate(model, values, profile, np.full(3, 21.0)).temperatures_c
    # Sensors show what was 15 s before.
    shown = np.stack([np.interp(time_s - 15.0, time_s, column) for column in path.T])
    shown += 0.1 * rng.standard_normal(shown.shape)
    readings = dict(zip(model.node_names, shown, strict=True))
    del readings["t_slot_c"]
    return Recording("made", None, time_s, none, none, ambient, readings, {"power_w": power}, ())


def test_a_made_up_stator_is_forecast_at_twice_the_power() -> None:
    section = read_network(NETWORK)
    learned = heated(section, 333.0, 500, 1)
    found = identify_recording(learned, machine=Machine("default", None, section), at_rest=True)
    assert found.rms_k < 0.5
    assert found.model.posterior.trained.drives["power_w"] == pytest.approx(360.0, rel=0.05)
    for rms_k, inside in judged(found.model, heated(section, 600.0, 200, 2)).values():
        assert rms_k < 3.0
        assert inside > 0.9


if RECORDED.is_dir():

    def test_learned_at_333_w_it_forecasts_600_w() -> None:
        section = read_network(NETWORK)
        learned = read_recording(RECORDED / "run1_thr4.csv", section)
        found = identify_recording(learned, machine=Machine("default", None, section), at_rest=True)
        assert found.rms_k < 1.5
        for name in ("run2_thr100", "run5_thr11"):
            scores = judged(found.model, read_recording(RECORDED / f"{name}.csv", section))
            # What one heating run cannot tell is in docs/start/field-csv.md.
            assert scores["t_winding_c"][0] < 11.0
            assert scores["t_winding_c"][1] > 0.3
            assert scores["t_body_c"][0] < 1.5
            assert scores["t_body_c"][1] > 0.95
        with_fan = judged(found.model, read_recording(RECORDED / "run4_thr8_fan.csv", section))
        # The fan is in no column: the body stays far cooler than forecast.
        assert with_fan["t_body_c"][1] < 0.5
