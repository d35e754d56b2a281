"""The bench controller: where the plan stands, and what drive, hydraulics and air really do.

Everything here is a function of process time alone, so a run can be repeated and read at any
moment.
"""

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from adapters.virtual_bench.parameters import BenchParameters
from adapters.virtual_bench.plant import BenchProfile, Condition
from adapters.virtual_bench.scenarios import BenchPhase, Changing, Scenario


class RunState(IntEnum):
    """Run state of the bench controller, as on the wires."""

    STANDING = 0
    RUNNING = 1
    FINISHED = 2
    FAULT = 3


@dataclass(frozen=True, slots=True)
class PlanRow:
    """Set-points for a time."""

    duration_s: int
    speed_rpm: float
    load_n: float


@dataclass(frozen=True, slots=True)
class ControllerState:
    """What the controller shows at one moment."""

    phase: int  # 1 for the first step; one more than the number of steps after the end
    run_state: RunState
    speed_setpoint_rpm: float
    load_setpoint_n: float
    #: Rest of the phase (rounded up) and time since the start in seconds.
    seconds_left: int
    elapsed_s: int
    #: What is ahead; row 0 is the rest of the present step; empty after the end.
    plan: tuple[PlanRow, ...]


class BenchController:
    """Runs a scenario on the true machine.

    The drive follows the speed set-point along a ramp. The hydraulics follow theirs along a ramp
    and with play: coming from below the true load stays a little below the set-point, coming from
    above a little above (pressure hysteresis, named in Wang et al. 2025, section 5.1).
    """

    def __init__(self, scenario: Scenario, parameters: BenchParameters, seed: int) -> None:
        self.scenario = scenario
        self._parameters = parameters
        starts = np.cumsum([0.0, *(step.duration_s for step in scenario.steps)])
        self._starts: list[float] = [float(start) for start in starts]
        self._steps = [*scenario.steps, BenchPhase("stand still", math.inf, 0.0, 0.0, "low")]
        self._tripped = False
        self._ambient_phases = np.random.default_rng([seed, 0xA1B]).uniform(0, 2 * math.pi, 3)
        self._compile()

    def _compile(self) -> None:
        """Work out speed, load set-point and load at the start of every phase."""
        play = self._parameters.load_play_n
        speed, setpoint = 0.0, self._steps[0].load_n
        load = setpoint
        rows = []
        for index, step in enumerate(self._steps):
            rows.append((speed, setpoint, load))
            if index + 1 < len(self._steps):
                span = self._starts[index + 1] - self._starts[index]
                speed = _towards(speed, step.speed_rpm, span * self.scenario.speed_ramp_rpm_per_s)
                setpoint = _towards(setpoint, step.load_n, span * self.scenario.load_ramp_n_per_s)
                load = min(max(load, setpoint - play), setpoint + play)
        self._entry = np.array(rows)
        self._start_array = np.array(self._starts)
        self._target = np.array([(step.speed_rpm, step.load_n) for step in self._steps])

    def trip(self, time_s: float) -> None:
        """Stop the machine for good: set-points to zero, run state `FAULT`."""
        if self._tripped:
            return
        kept = sum(start < time_s for start in self._starts)
        self._tripped = True
        self._starts = [*self._starts[:kept], time_s]
        self._steps = [*self._steps[:kept], BenchPhase("tripped", math.inf, 0.0, 0.0, "low")]
        self._compile()

    def postpone_high_risk(self, begin_s: float, end_s: float) -> None:
        """Let a high-risk step that would begin within a span begin one second after it.

        The step before it lasts so much longer; all that follows begins as much later. Both are
        process seconds since the start, the begin excluded.
        """
        for index, step in enumerate(self._steps[:-1]):
            if step.risk == "high" and begin_s < self._starts[index] <= end_s:
                delay_s = end_s + 1.0 - self._starts[index]
                later = [start + delay_s for start in self._starts[index:]]
                self._starts = [*self._starts[:index], *later]
                self._compile()
                return

    def true_point(
        self, time_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Speed in rpm and load in N that the bearing really sees, at times (n,) in s."""
        phase = np.searchsorted(self._start_array, time_s, side="right") - 1
        phase = np.maximum(phase, 0)
        inside = time_s - self._start_array[phase]
        speed, setpoint, load = self._entry[phase].T
        target_speed, target_load = self._target[phase].T
        reach = inside * self.scenario.speed_ramp_rpm_per_s
        speed = speed + np.clip(target_speed - speed, -reach, reach)
        reach = inside * self.scenario.load_ramp_n_per_s
        setpoint = setpoint + np.clip(target_load - setpoint, -reach, reach)
        play = self._parameters.load_play_n
        load = np.clip(load, setpoint - play, setpoint + play)
        return speed, load * self._changed("load", time_s)

    def condition(self, time_s: NDArray[np.float64]) -> Condition:
        """What the scenario does to the machine at process times in seconds since the start."""
        return Condition(
            self.scenario.oil_loss * self._changed("oil loss", time_s),
            self._changed("cooling", time_s),
        )

    def _changed(self, quantity: Changing, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        factor = np.ones_like(time_s)
        for change in self.scenario.changes:
            if change.quantity == quantity:
                factor *= change.at(time_s)
        return factor

    def ambient_c(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Air temperature in degC: a level, slow swings (2 h and 7.3 h), the course of a day."""
        first, second, third = self._ambient_phases
        swing = 0.6 * np.sin(2 * math.pi * time_s / 7200.0 + first) + 0.8 * np.sin(
            2 * math.pi * time_s / 26300.0 + second
        )
        daily = self.scenario.ambient_daily_k * np.sin(2 * math.pi * time_s / 86400.0 + third)
        level = self._parameters.ambient_c + daily
        return np.asarray(level + self._parameters.ambient_swing_k * swing)

    def state(self, time_s: float) -> ControllerState:
        """Give what the controller shows at a process time in seconds since the start."""
        index = max(int(np.searchsorted(self._start_array, time_s, side="right")) - 1, 0)
        step = self._steps[index]
        last = index == len(self._steps) - 1
        left = 0 if last else max(1, math.ceil(self._starts[index + 1] - time_s - 1e-9))
        plan: list[PlanRow] = []
        if not last:
            plan.append(PlanRow(left, step.speed_rpm, step.load_n))
            plan += [
                PlanRow(round(ahead.duration_s), ahead.speed_rpm, ahead.load_n)
                for ahead in self._steps[index + 1 : -1]
            ]
        speed = float(self.true_point(np.array([time_s]))[0][0])
        if last:
            run_state = RunState.FAULT if self._tripped else RunState.FINISHED
        elif speed == 0.0 and step.speed_rpm == 0.0:
            run_state = RunState.STANDING
        else:
            run_state = RunState.RUNNING
        return ControllerState(
            phase=index + 1,
            run_state=run_state,
            speed_setpoint_rpm=step.speed_rpm,
            load_setpoint_n=step.load_n,
            seconds_left=left,
            elapsed_s=int(time_s),
            plan=tuple(plan),
        )


def _towards(value: float, target: float, reach: float) -> float:
    return value + min(max(target - value, -reach), reach)


def scenario_profile(
    scenario: Scenario, parameters: BenchParameters, seed: int, step_s: float = 1.0
) -> BenchProfile:
    """Sample what a scenario makes the machine do, for an offline `simulate`.

    Each row holds the mean point of its `step_s` (the live bench: 1 s).
    """
    controller = BenchController(scenario, parameters, seed)
    time_s = np.arange(0.0, scenario.duration_s + 0.5 * step_s, step_s)
    speed, load = controller.true_point(time_s + 0.5 * step_s)
    return BenchProfile(
        time_s,
        speed,
        load,
        controller.ambient_c(time_s),
        controller.condition(time_s + 0.5 * step_s),
    )
