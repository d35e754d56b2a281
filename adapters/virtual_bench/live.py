"""The running bench: controller, plant and sensors advanced together along process time."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from adapters.virtual_bench.controller import BenchController, ControllerState
from adapters.virtual_bench.network import INNER_BORE, NODE_NAMES, OUTER_SURFACE
from adapters.virtual_bench.parameters import BenchParameters
from adapters.virtual_bench.plant import Plant
from adapters.virtual_bench.scenarios import FaultKind, Scenario
from adapters.virtual_bench.sensors import PT100_CHANNELS, LineSensor, Pt100, SensorParameters

TRUTH_PERIOD_S = 10
TRIP_C = 130.0  # hard-wired thermostat on the inner ring
TRUTH_COLUMNS = (
    "time_s",
    "speed_rpm",
    "load_n",
    "ambient_c",
    "t_inner_ring_c",
    "t_outer_ring_c",
    *(f"t_node_{number}_c" for number in range(1, 14)),
    *(f"{name}_c" for name in NODE_NAMES),
    "friction_w",
    "run_in",
    "oil",
    "oil_loss",
    "cooling",
    "load_setpoint_n",
)


@dataclass(frozen=True, slots=True)
class Transmitter:
    """Last conversion of a PT100 transmitter: temperature in degC, or what is wrong with it."""

    temperature_c: float
    fault: FaultKind | None


class LiveBench:
    """A bench in motion; everything it shows depends on seed, scenario and process time only.

    The plant moves in whole seconds, so that the moments at which someone looks do not change what
    he sees. By default it is the calibrated bench for the scenario's bearing.

    - ``hold``: while it is set, no high-risk step begins: the step before it goes on.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        parameters: BenchParameters | None = None,
        sensors: SensorParameters | None = None,
    ) -> None:
        bench = parameters or BenchParameters.for_bearing(scenario.bearing)
        errors = sensors or SensorParameters()
        self.scenario = scenario
        self.controller = BenchController(scenario, bench, seed)
        start_c = float(self.controller.ambient_c(np.zeros(1))[0])
        self._plant = Plant(bench, start_c)
        self._chains = [
            Pt100(seed, channel, start_c, errors) for channel in range(len(PT100_CHANNELS))
        ]
        self._readings = [float(chain.convert(np.array([start_c]))[0]) for chain in self._chains]
        self._speed = LineSensor(seed, 1, errors.speed_sd_rpm)
        self._load = LineSensor(seed, 2, errors.load_sd_n)
        self._seconds = 0
        self.time_s = 0.0
        self.hold = False
        self._truth: list[tuple[float, ...]] = []
        self._note_truth(start_c, 0.0)

    def advance(self, time_s: float) -> None:
        """Move on to a process time in seconds since the start; never backwards."""
        self.time_s = max(self.time_s, time_s)
        end = int(self.time_s)
        while self._seconds < end:
            # pieces end at whole truth periods, where thermostat and truth are looked at
            until = min(end, (self._seconds // TRUTH_PERIOD_S + 1) * TRUTH_PERIOD_S)
            if self.hold:
                # Up to one second later: what is read until then is still of the step before.
                self.controller.postpone_high_risk(self._seconds, until + 1.0)
            self._step(until)

    def _step(self, until: int) -> None:
        start = np.arange(self._seconds, until, dtype=np.float64)
        speed, load = self.controller.true_point(start + 0.5)
        rows = self._plant.advance(
            np.ones(start.size),
            speed,
            load,
            self.controller.ambient_c(start),
            self.controller.condition(start + 0.5),
        )
        temperatures = rows.temperatures_c
        ambient = self.controller.ambient_c(start + 1.0)
        true = (temperatures[:, INNER_BORE], temperatures[:, OUTER_SURFACE], ambient)
        self._readings = [
            float(chain.convert(values)[-1])
            for chain, values in zip(self._chains, true, strict=True)
        ]
        self._seconds = until
        if until % TRUTH_PERIOD_S == 0:
            if temperatures[-1, INNER_BORE] > TRIP_C:
                self.controller.trip(float(until))
            self._note_truth(float(ambient[-1]), float(rows.power_w[-1]))

    def _note_truth(self, ambient_c: float, friction_w: float) -> None:
        time_s = float(self._seconds)
        speed, load = self.controller.true_point(np.array([time_s]))
        condition = self.controller.condition(np.array([time_s]))
        nodes = self._plant.temperatures_c
        self._truth.append(
            (
                time_s,
                float(speed[0]),
                float(load[0]),
                ambient_c,
                float(nodes[INNER_BORE]),
                float(nodes[OUTER_SURFACE]),
                *(float(value) for value in self._plant.weights @ nodes),
                *(float(value) for value in nodes),
                friction_w,
                *(float(value) for value in self._plant.grease),
                float(condition.oil_loss[0]),
                float(condition.cooling[0]),
                self.controller.state(time_s).load_setpoint_n,
            )
        )

    def take_truth(self) -> list[tuple[float, ...]]:
        """Rows of truth (`TRUTH_COLUMNS`) since the last call."""
        rows, self._truth = self._truth, []
        return rows

    def _fault(self, channel: str) -> FaultKind | None:
        for fault in self.scenario.faults:
            if (
                fault.channel == channel
                and fault.start_s <= self.time_s < fault.start_s + fault.duration_s
            ):
                return fault.kind
        return None

    def transmitters(self) -> Mapping[str, Transmitter]:
        """Present output of the three PT100 transmitters."""
        return {
            channel: Transmitter(reading, self._fault(channel))
            for channel, reading in zip(PT100_CHANNELS, self._readings, strict=True)
        }

    def controller_state(self) -> ControllerState:
        """Present state of the bench controller."""
        return self.controller.state(self.time_s)

    def speed_rpm(self) -> float | None:
        """Present reading of the encoder; None when the sensor is broken."""
        if self._fault("speed_rpm"):
            return None
        speed, _ = self.controller.true_point(np.array([self.time_s]))
        return self._speed.read(float(speed[0]), self.time_s)

    def load_n(self) -> float | None:
        """Present reading of the load cell; None when the sensor is broken."""
        if self._fault("load_n"):
            return None
        _, load = self.controller.true_point(np.array([self.time_s]))
        return self._load.read(float(load[0]), self.time_s)
