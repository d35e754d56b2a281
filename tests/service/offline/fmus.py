"""Models of every kind of part, and FMUs of them as another program runs them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from numpy.typing import NDArray

from service.offline.model_file import IdentifiedModel, RunIn
from service.offline.tables import PlannedRows
from service.site.machines.bearings import named_bearing
from service.site.machines.machine import Machine
from service.site.machines.networks import read_network
from twin_core.identification import prior_posterior

FloatArray = NDArray[np.float64]

# Every kind of edge and loss, a boundary of its own, a sensor that is no node.
DRIVE = """
[parameters]
f2 = { unit = "-", centre = 1.0, spread = 0.5 }
seat = { unit = "K/W", centre = 0.1, spread = 0.5 }
r20 = { unit = "ohm", centre = 0.02, spread = 0.5 }
windage = { unit = "W", centre = 15.0, spread = 0.5 }
time = { unit = "J/K", centre = 900.0, spread = 0.5 }

[nodes]
t_grease_c = { capacity_j_k = 60 }
t_ring_c = { capacity_j_k = "time" }
t_shaft_c = { capacity_j_k = 1500 }
t_winding_c = { capacity_j_k = 2500 }
t_house_c = { capacity_j_k = 9000 }

[[edges]]
between = ["t_grease_c", "t_ring_c"]
kind = "contact"
constant_k_w = 0.02
moving_k_w = 800.0
[[edges]]
between = ["t_grease_c", "t_shaft_c"]
kind = "convective"
base_k_w = 30.0
nusselt_at_rest = 2.0
nusselt_factor = 1.1
nusselt_exponent = 0.5
[[edges]]
between = ["t_ring_c", "t_house_c"]
kind = "constant"
resistance_k_w = "seat"
[[edges]]
between = ["t_winding_c", "t_house_c"]
kind = "convective-reference"
base_k_w = 4.0
nusselt_at_rest = 20.0
nusselt_at_3000_rpm = 80.0
nusselt_exponent = 0.6
[[edges]]
between = ["t_house_c", "ambient"]
kind = "film"
conductance_w_k = 5.0
exponent = 0.2
[[edges]]
between = ["t_shaft_c", "ambient"]
kind = "shaft-sink"
at_rest_w_k = 0.5
at_6000_rpm_w_k = 1.5
[[edges]]
between = ["t_house_c", "coolant_c"]
kind = "speed-power"
resistance_k_w = 0.3
reference_rpm = 2000.0
exponent = -0.3

[[losses]]
node = "t_winding_c"
kind = "copper"
channel = "current_a"
resistance_20_ohm = "r20"
[[losses]]
node = "t_house_c"
kind = "power"
channel = "power_w"
factor = 0.3
[[losses]]
node = "t_shaft_c"
kind = "speed"
loss_w = "windage"
reference_rpm = 3000.0
exponent = 1.5

[source]
kind = "palmgren"
lubricant_node = "t_grease_c"
f2 = "f2"
pitch_diameter_mm = 87.5
static_load_rating_n = 45000
viscosity_mm2_s = 100
viscosity_fall_per_k = 0.03
viscosity_reference_c = 40
shares = [{ node = "t_grease_c", of_rest = 0.2 }, { node = "t_ring_c", of_rest = 0.5 }, { node = "t_shaft_c" }]

[sensors]
t_house_c = "t_house_c"
t_mean_c = { weights = { t_ring_c = 0.7, t_house_c = 0.3 } }

[reference]
inputs = { current_a = 60.0, power_w = 100.0 }
"""  # noqa: E501
DAY_S, ROWS, PERIOD_S = 86400.0, 40, 60.0


def bearing_model(name: str = "default") -> Machine:
    return Machine(name, named_bearing("6311", {}), None)


def own_model(text: str, folder: Path) -> Machine:
    path = folder / "drive.toml"
    path.write_text(text)
    return Machine("default", None, read_network(path))


def identified_model(machine: Machine, seed: int) -> IdentifiedModel:
    """A model with random parameters whose grease had run for a while when its data began."""
    model = machine.build()
    posterior = prior_posterior(model)
    z = np.clip(np.random.default_rng(seed).standard_normal(model.parameters.size), -1.5, 1.5)
    time_s = np.array([0.0, 21600.0])
    run_in = RunIn(None, True, time_s, np.array([120_000.0, 540_000.0]), {})
    return IdentifiedModel(machine, model, replace(posterior, z=z), run_in)


def day(identified: IdentifiedModel, seed: int) -> PlannedRows:
    """24 h in 40 steps of 36 min, standstill and jumps of everything among them."""
    rng = np.random.default_rng(seed)
    speed_rpm = rng.choice([0.0, 600.0, 1500.0, 2400.0, 4200.0, 6000.0], ROWS + 1)
    columns = []
    model = identified.model
    for name, usual in zip(model.input_names, model.reference_inputs, strict=True):
        is_boundary = name in model.network.boundaries
        low, high = (10.0, 40.0) if is_boundary else (0.0, 1.3 * usual)
        columns.append(rng.uniform(low, high, ROWS + 1))
    return PlannedRows(
        np.linspace(0.0, DAY_S, ROWS + 1),
        speed_rpm,
        rng.choice([0.0, 500.0, 2650.0, 4500.0], ROWS + 1),
        rng.uniform(15.0, 28.0, ROWS + 1),
        np.array(columns).reshape(-1, ROWS + 1).T,
    )


def signals(rows: PlannedRows, names: tuple[str, ...], own: tuple[str, ...]) -> FloatArray:
    """Rows as FMPy takes them: each value twice, as it draws lines between the rows."""
    known = {"speed_rpm": rows.speed_rpm, "load_n": rows.load_n, "ambient_c": rows.ambient_c}
    known |= {name: rows.inputs[:, place] for place, name in enumerate(own)}
    table = []
    for row in range(rows.time_s.size - 1):
        values = tuple(float(known[name][row]) for name in names)
        table += [(rows.time_s[row], *values), (rows.time_s[row + 1], *values)]
    return np.array(table, dtype=[("time", float), *((name, float) for name in names)])


def run_fmu(
    path: Path, rows: PlannedRows, names: tuple[str, ...], own: tuple[str, ...], **options: Any
) -> Any:
    """What FMPy records every minute; `names` are the inputs."""
    return fmpy.simulate_fmu(
        str(path),
        start_time=float(rows.time_s[0]),
        stop_time=float(rows.time_s[-1]),
        output_interval=options.pop("period_s", PERIOD_S),
        input=signals(rows, names, own),
        record_events=False,
        **options,
    )
