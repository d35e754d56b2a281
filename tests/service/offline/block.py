"""A heated block as a network of one node, and what a logger records of it."""

from pathlib import Path

import numpy as np
from site_files import COLUMNS, asset_text

from service.site.machines.machine import Machine
from service.site.machines.networks import read_network
from twin_core.simulation import OperatingProfile, simulate

from .files import write

HEADER = ("time_s", "speed_rpm", "load_n", "ambient_c", "t_block_c")
NETWORK = """
[parameters]
film = { unit = "W/K", centre = 5.0, spread = 0.4 }
speed = { unit = "W/rpm", centre = 0.05, spread = 0.7 }
load = { unit = "W/N", centre = 0.02, spread = 0.7 }
[nodes]
t_block_c = { capacity_j_k = 9000 }
[[edges]]
between = ["t_block_c", "ambient"]
kind = "film"
conductance_w_k = "film"
exponent = 0.15
[source]
kind = "linear"
per_rpm_w = "speed"
per_n_w = "load"
shares = [{ node = "t_block_c" }]
[sensors]
t_block_c = "t_block_c"
[reference]
speed_rpm = 2000
load_n = 3000
"""
STEPS = ((800.0, 1500.0), (1600.0, 1500.0), (1600.0, 5000.0), (2400.0, 2500.0))
CONFIGURATION = asset_text(
    "block-1", ("t_block_c", *COLUMNS), machine='network = "block.toml"', low_risk=(3000, 6000)
)


def recorded(
    folder: Path,
    noise_k: np.ndarray | float = 0.0,
    values: tuple[float, ...] = (7.0, 0.06, 0.03),
    early: float = 1.0,
    seed: int = 3,
) -> Path:
    """Eight hours of the network, minute by minute; for six of them it rises by a factor more."""
    file = folder / "true.toml"
    file.write_text(NETWORK)
    model = Machine("default", None, read_network(file)).build()
    speed, load = np.repeat(np.array(STEPS), 120, axis=0).T
    profile = OperatingProfile(np.arange(480) * 60.0, speed, load, np.full(480, 21.0))
    path = simulate(model, np.array(values), profile, np.array([21.0]))
    white = 0.05 * np.random.default_rng(seed).standard_normal(480)
    rise = (path.temperatures_c[:, 0] - 21.0) * np.where(np.arange(480) < 360, early, 1.0)
    measured = 21.0 + rise + white + noise_k
    rows = np.stack([profile.time_s, speed, load, profile.ambient_c, measured], axis=1)
    return write(folder / f"data-{seed}.csv", rows, HEADER)
