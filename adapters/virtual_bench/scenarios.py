"""What the bench controller runs: named operating points, sensor faults, changes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Risk = Literal["low", "high"]
FaultKind = Literal["wire break", "short circuit", "over-range", "not available"]
Changing = Literal["oil loss", "cooling", "load"]

_MINUTE = 60.0
_HOUR = 3600.0


class BenchError(ValueError):
    """The root of all errors of the virtual bench."""


class UnknownScenarioError(BenchError):
    """No scenario of that name."""


@dataclass(frozen=True, slots=True)
class BenchPhase:
    """One phase: set-points held for a time, the ramp towards them included.

    `risk` is the test plan's own label: low-risk is what may be run without watching.
    """

    name: str
    duration_s: float
    speed_rpm: float
    load_n: float
    risk: Risk


@dataclass(frozen=True, slots=True)
class SensorFault:
    """A broken sensor, from a time after the start for a while; it recovers on its own.

    Temperature channels know ``wire break``, ``short circuit`` and ``over-range``; the two CAN
    channels (`speed_rpm`, `load_n`) know ``not available``.
    """

    channel: str
    kind: FaultKind
    start_s: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class MachineChange:
    """Something about the machine that changes while it runs, unknown to its controller."""

    #: ``oil loss`` of the grease, ``cooling`` of housing and base plate by the air, ``load`` that
    #: the hydraulics really bring, next to what the set-point says.
    quantity: Changing
    #: When it begins, and over how long it grows (evenly in the logarithm).
    start_s: float
    ramp_s: float
    factor: float  # by what the quantity is multiplied in the end
    end_s: float = math.inf  # when it begins to go back, as fast as it came; default never

    def at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Factor at process times in seconds; same shape."""
        grown = np.clip((time_s - self.start_s) / self.ramp_s, 0.0, 1.0)
        gone = np.clip((time_s - self.end_s) / self.ramp_s, 0.0, 1.0)
        return np.asarray(self.factor ** (grown - gone))


@dataclass(frozen=True, slots=True)
class Scenario:
    """A test plan."""

    name: str
    description: str
    bearing: str
    steps: tuple[
        BenchPhase, ...
    ]  # one after the other; afterwards the bench stands still, unloaded
    faults: tuple[SensorFault, ...] = ()
    #: How fast drive and hydraulics follow a new set-point.
    speed_ramp_rpm_per_s: float = 100.0
    load_ramp_n_per_s: float = 200.0
    changes: tuple[MachineChange, ...] = ()  # what becomes of the machine itself
    #: How fast the grease ages, in multiples of the rate that its life is stated for.
    oil_loss: float = 0.0
    #: Amplitude of the ambient's daily course in K, next to its faster swings.
    ambient_daily_k: float = 0.0

    @property
    def duration_s(self) -> float:
        """Length of all steps in seconds."""
        return sum(step.duration_s for step in self.steps)


def _rest(load_n: float = 2650.0) -> BenchPhase:
    return BenchPhase("at rest", 3 * _MINUTE, 0.0, load_n, "low")


def _point(speed_rpm: float, load_n: float, minutes: float, risk: Risk) -> BenchPhase:
    return BenchPhase(
        f"{speed_rpm:.0f} rpm {load_n:.0f} N", minutes * _MINUTE, speed_rpm, load_n, risk
    )


def _staircase(speeds: Sequence[float], minutes: float) -> tuple[BenchPhase, ...]:
    return tuple(
        _point(speed, 2650.0, minutes, "low" if speed <= 4300.0 else "high") for speed in speeds
    )


def _days(count: int) -> tuple[BenchPhase, ...]:
    """Days of low and medium points, every day the same, with two hours of standstill."""
    day = (
        _point(2400.0, 2650.0, 300.0, "low"),
        _point(3600.0, 2650.0, 300.0, "low"),
        _point(4200.0, 2650.0, 300.0, "low"),
        _point(4200.0, 3300.0, 180.0, "low"),
        _point(3000.0, 2000.0, 240.0, "low"),
        BenchPhase("stop", 2 * _HOUR, 0.0, 2000.0, "low"),
    )
    return (_rest(), *(day * count))


_ONSET_S = 54 * _HOUR
_AGEING = 5.0

_SCENARIOS = (
    Scenario(
        name="staircase",
        description="the six speeds of Wang et al. 2025, 1500 to 6200 rpm at 2650 N, 90 min each",
        bearing="6311",
        steps=(_rest(), *_staircase((1500.0, 2400.0, 4200.0, 4900.0, 5600.0, 6200.0), 90.0)),
    ),
    Scenario(
        name="load-steps",
        description="6016 at 5800 rpm: 2650 N for 6 h, then 4000 N and 5500 N for 3 h each",
        bearing="6016",
        steps=(
            _rest(),
            _point(5800.0, 2650.0, 360.0, "low"),
            _point(5800.0, 4000.0, 180.0, "high"),
            _point(5800.0, 5500.0, 180.0, "high"),
        ),
    ),
    Scenario(
        name="rapid-acceleration",
        description="from standstill to 5600 and 6200 rpm at 300 rpm/s, with stops between",
        bearing="6311",
        steps=(
            _rest(),
            _point(5600.0, 2650.0, 60.0, "high"),
            BenchPhase("stop", 20 * _MINUTE, 0.0, 2650.0, "low"),
            _point(5600.0, 2650.0, 30.0, "high"),
            BenchPhase("stop", 10 * _MINUTE, 0.0, 2650.0, "low"),
            _point(6200.0, 2650.0, 45.0, "high"),
        ),
        speed_ramp_rpm_per_s=300.0,
    ),
    Scenario(
        name="sensor-break",
        description="a healthy run; one sensor after the other fails and recovers",
        bearing="6311",
        steps=(_rest(), _point(2400.0, 2650.0, 57.0, "low"), _point(4200.0, 2650.0, 30.0, "low")),
        faults=(
            SensorFault("t_inner_ring_c", "wire break", 10 * _MINUTE, 6 * _MINUTE),
            SensorFault("t_outer_ring_c", "over-range", 20 * _MINUTE, 5 * _MINUTE),
            SensorFault("ambient_c", "over-range", 30 * _MINUTE, 5 * _MINUTE),
            SensorFault("load_n", "not available", 40 * _MINUTE, 4 * _MINUTE),
            SensorFault("speed_rpm", "not available", 48 * _MINUTE, 3 * _MINUTE),
            SensorFault("t_outer_ring_c", "short circuit", 65 * _MINUTE, 4 * _MINUTE),
        ),
    ),
    Scenario(
        name="durability",
        description="five equal days at changing low points; the grease runs in and ages slowly",
        bearing="6311",
        steps=_days(5),
        oil_loss=_AGEING,
        ambient_daily_k=1.5,
    ),
    Scenario(
        name="grease-degradation",
        description="days as in durability; from 54 h the grease bleeds and friction grows",
        bearing="6311",
        steps=_days(6),
        changes=(MachineChange("oil loss", _ONSET_S, 2 * _HOUR, 12.0),),
        oil_loss=_AGEING,
        ambient_daily_k=1.5,
    ),
    Scenario(
        name="cooling-loss",
        description="days as in durability; at 54 h the housing is covered, heat cannot leave",
        bearing="6311",
        steps=_days(4),
        changes=(MachineChange("cooling", _ONSET_S, 2 * _HOUR, 0.5),),
        oil_loss=_AGEING,
        ambient_daily_k=1.5,
    ),
    Scenario(
        name="overload",
        description="a healthy run; at 150 min the load doubles beyond its set-point for an hour",
        bearing="6311",
        steps=(_rest(), _point(2400.0, 2650.0, 60.0, "low"), _point(4200.0, 2650.0, 210.0, "low")),
        changes=(MachineChange("load", 150 * _MINUTE, 2 * _MINUTE, 2.0, end_s=210 * _MINUTE),),
    ),
    Scenario(
        name="demo",
        description="low-risk staircase and light load stages, then high speed and heavy load",
        bearing="6311",
        steps=(
            _rest(),
            _point(1500.0, 2650.0, 55.0, "low"),
            _point(2400.0, 2650.0, 55.0, "low"),
            _point(4200.0, 2650.0, 70.0, "low"),
            _point(4200.0, 3300.0, 45.0, "low"),
            _point(4200.0, 2000.0, 45.0, "low"),
            _point(4200.0, 2650.0, 25.0, "low"),
            _point(6200.0, 2650.0, 75.0, "high"),
            _point(6200.0, 5500.0, 75.0, "high"),
            BenchPhase("cool-down", 30 * _MINUTE, 1500.0, 2650.0, "low"),
        ),
    ),
)


def list_scenarios() -> tuple[Scenario, ...]:
    """Return every scenario that the bench can run."""
    return _SCENARIOS


def find_scenario(name: str) -> Scenario:
    """Return the scenario of a name. Raises `UnknownScenarioError`."""
    for scenario in _SCENARIOS:
        if scenario.name == name:
            return scenario
    known = ", ".join(scenario.name for scenario in _SCENARIOS)
    raise UnknownScenarioError(f"scenario {name!r}: expected one of {known}")
