"""What the bench controller runs: named sequences of operating points and sensor faults."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Risk = Literal["low", "high"]
FaultKind = Literal["wire break", "short circuit", "over-range", "not available"]

_MINUTE = 60.0


class UnknownScenarioError(ValueError):
    """No scenario of that name."""


@dataclass(frozen=True, slots=True)
class Step:
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
    """A broken sensor, from a time after the start for a while; it recovers by itself.

    Temperature channels know ``wire break``, ``short circuit`` and ``over-range``; the two CAN
    channels (`speed_rpm`, `load_n`) know ``not available``.
    """

    channel: str
    kind: FaultKind
    start_s: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class Scenario:
    """A test plan.

    Attributes
    ----------
    name, description : str
        For people.
    bearing : str
        What is mounted.
    steps : tuple of Step
        One after the other; afterwards the bench stands still, unloaded.
    faults : tuple of SensorFault
        Sensor faults on the way.
    speed_ramp_rpm_per_s, load_ramp_n_per_s : float
        How fast drive and hydraulics follow a new set-point.
    """

    name: str
    description: str
    bearing: str
    steps: tuple[Step, ...]
    faults: tuple[SensorFault, ...] = ()
    speed_ramp_rpm_per_s: float = 100.0
    load_ramp_n_per_s: float = 200.0

    @property
    def duration_s(self) -> float:
        """Length of all steps in seconds."""
        return sum(step.duration_s for step in self.steps)


def _rest(load_n: float = 2650.0) -> Step:
    return Step("at rest", 3 * _MINUTE, 0.0, load_n, "low")


def _point(speed_rpm: float, load_n: float, minutes: float, risk: Risk) -> Step:
    return Step(f"{speed_rpm:.0f} rpm {load_n:.0f} N", minutes * _MINUTE, speed_rpm, load_n, risk)


def _staircase(speeds: Sequence[float], minutes: float) -> tuple[Step, ...]:
    return tuple(
        _point(speed, 2650.0, minutes, "low" if speed <= 4300.0 else "high") for speed in speeds
    )


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
        description="from rest straight to 5600 and 6200 rpm at 300 rpm/s, with stops between",
        bearing="6311",
        steps=(
            _rest(),
            _point(5600.0, 2650.0, 60.0, "high"),
            Step("stop", 20 * _MINUTE, 0.0, 2650.0, "low"),
            _point(5600.0, 2650.0, 30.0, "high"),
            Step("stop", 10 * _MINUTE, 0.0, 2650.0, "low"),
            _point(6200.0, 2650.0, 45.0, "high"),
        ),
        speed_ramp_rpm_per_s=300.0,
    ),
    Scenario(
        name="sensor-break",
        description="a calm run on which one sensor after the other fails and recovers",
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
            Step("cool-down", 30 * _MINUTE, 1500.0, 2650.0, "low"),
        ),
    ),
)


def list_scenarios() -> tuple[Scenario, ...]:
    """Return every scenario that the bench can run."""
    return _SCENARIOS


def find_scenario(name: str) -> Scenario:
    """Return the scenario of a name.

    Raises
    ------
    UnknownScenarioError
        When there is none; the message lists those that there are.
    """
    for scenario in _SCENARIOS:
        if scenario.name == name:
            return scenario
    known = ", ".join(scenario.name for scenario in _SCENARIOS)
    raise UnknownScenarioError(f"scenario {name!r}: expected one of {known}")
