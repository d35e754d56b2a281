"""A bearing test bench that is not there: physics, sensors, Modbus TCP and CAN on real sockets.

A process of its own that a real bench could replace unnoticed. It shares no code with the twin
and none with the drivers.
"""

from adapters.virtual_bench.announcements import BenchAnnouncement, FleetAnnouncement
from adapters.virtual_bench.can_sender import dbc_path
from adapters.virtual_bench.controller import scenario_profile
from adapters.virtual_bench.fleet_run import run_fleet
from adapters.virtual_bench.modbus_server import PortInUseError
from adapters.virtual_bench.parameters import BenchParameters
from adapters.virtual_bench.plant import BenchProfile, Condition, Truth, simulate
from adapters.virtual_bench.reference import friction_moment_nmm
from adapters.virtual_bench.run import run
from adapters.virtual_bench.scenarios import (
    MachineChange,
    Scenario,
    UnknownScenarioError,
    find_scenario,
    list_scenarios,
)
from adapters.virtual_bench.sensors import MeasuredRun, SensorParameters, measure

__all__ = [
    "BenchAnnouncement",
    "BenchParameters",
    "BenchProfile",
    "Condition",
    "FleetAnnouncement",
    "MachineChange",
    "MeasuredRun",
    "PortInUseError",
    "Scenario",
    "SensorParameters",
    "Truth",
    "UnknownScenarioError",
    "dbc_path",
    "find_scenario",
    "friction_moment_nmm",
    "list_scenarios",
    "measure",
    "run",
    "run_fleet",
    "scenario_profile",
    "simulate",
]
