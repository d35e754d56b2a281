"""Simulation of thermal models: profiles in, temperatures of all nodes out."""

from twin_core.simulation.profile import (
    OperatingProfile,
    OperatingProfiles,
    SimulationError,
    Trajectory,
    hold_operating_point,
    total_revolutions,
)
from twin_core.simulation.sensitivities import Sensitivities, simulate_sensitivities
from twin_core.simulation.simulate import (
    advance,
    heat_balance_slopes_w_k,
    heat_balance_w,
    simulate,
    simulate_batch,
    steady_state,
)

__all__ = [
    "OperatingProfile",
    "OperatingProfiles",
    "Sensitivities",
    "SimulationError",
    "Trajectory",
    "advance",
    "heat_balance_slopes_w_k",
    "heat_balance_w",
    "hold_operating_point",
    "simulate",
    "simulate_batch",
    "simulate_sensitivities",
    "steady_state",
    "total_revolutions",
]
