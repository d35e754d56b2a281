"""State observer: all node temperatures from whatever sensors are good at the moment.

A Kalman filter. The mean goes through the same kernel as every simulation; the covariance
through the exact transition matrix of the operating point. Two kinds of model error:

- *heat disturbances*: unknown heats at the nodes that drift as stationary first-order processes
  over :data:`DISTURBANCE_TIME_S`. Their covariance is what errors of the friction heat, of its
  split and of every resistance (heat that flows from one end of an edge to the other) would
  cause in the steady state of a usual operating point; it goes with the friction heat, and fades
  slowly once that is gone. They are states of the filter: it learns a lasting model error and
  stays on the sensors without an offset, the spread of unmeasured nodes tells how far wrong the
  resistances may have led them, and when sensors are lost it grows everywhere.
- *heat noise*: short-lived, white, the same at every node; in temperature it counts least where
  the heat capacity is large.

A sensor's error is white noise, quantisation and a part that stays for about a minute: readings
that come every second do not count sixty times.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.machine_state import MachineState, course_known
from twin_core.models import ThermalModel
from twin_core.network import CompiledNetwork
from twin_core.process_noise import disturbance_structure, transition_and_noise
from twin_core.profiles import OperatingPoint
from twin_core.simulation import (
    SimulationError,
    kernels,
)

DISTURBANCE_TIME_S = 5400.0
DISTURBANCE_FADE_S = 3600.0
DISTURBANCE_AT_REST_W = 1.0
DISTURBANCE_LIMIT_K = 2.0
DISTURBANCE_LIMIT_K_W = 0.05
"""After a stop the heat that scales the disturbances fades over an hour to 1 W, as the heat flows
in the machine do. No disturbance is larger than what moves its node by 2 K, and 0.05 K per watt
of that heat, against its neighbours: at standstill the cage hangs on so little that one watt
would be 50 K."""
HEAT_NOISE_W_SQRT_S = 4.0
"""White heat noise per node, in W s^(1/2): 0.17 K per square root of a minute on a ring."""
NOISE_LIMIT_K = 0.3
"""In the long run the heat noise alone moves no node by more than this."""

SENSOR_NOISE_K = 0.05
SENSOR_RESOLUTION_K = 0.1
SENSOR_DRIFT_K = 0.1
SENSOR_DRIFT_TIME_S = 60.0
"""White noise, quantisation step, and a part of the error that lasts for about a minute."""

FLOOR_ERROR_K = 0.5
"""Standard deviation of the coldest temperature of the surroundings."""


class Innovation(NamedTuple):
    """What a sensor said against what was expected.

    Parameters
    ----------
    difference_k
        Reading minus expectation.
    std_k
        Expected standard deviation of the difference.
    """

    difference_k: float
    std_k: float


class Observer:
    """Kalman filter over the state nodes of a model.

    Parameters
    ----------
    model
        The model.
    values
        Its parameters, shape (p,), physical units.
    temperatures_c
        Mean, shape (nodes,).
    covariance
        In K2, shape (nodes, nodes).
    revolutions
        Revolutions since greasing.

    Raises
    ------
    ValueError
        If a shape is wrong or a value not finite.
    SimulationError
        If the model has no steady state at a usual operating point.
    """

    def __init__(
        self,
        model: ThermalModel,
        values: ArrayLike,
        temperatures_c: ArrayLike,
        covariance: ArrayLike,
        revolutions: float = 0.0,
    ) -> None:
        nodes = len(model.node_names)
        mean = np.array(temperatures_c, dtype=np.float64)
        spread = np.array(covariance, dtype=np.float64)
        self._model = model
        self._values = np.array(values, dtype=np.float64)
        for name, array, shape in (
            ("temperatures_c", mean, (nodes,)),
            ("covariance", spread, (nodes, nodes)),
            ("values", self._values, (model.parameters.size,)),
        ):
            if array.shape != shape:
                raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"{name} is not finite: {array.tolist()}")
        self._nodes = nodes
        self._state = np.concatenate((mean, np.zeros(nodes)))
        self._covariance = np.eye(2 * nodes)
        self._covariance[:nodes, :nodes] = (spread + spread.T) / 2.0
        self._revolutions = float(revolutions)
        self._elapsed_s: dict[str, float] = {}
        self._bound = kernels.bind_network(model.compiled, self._values)
        self._point: tuple[float, float] | None = None
        self._inputs: tuple[float, ...] = ()
        self._ambient_c = 0.0
        self._modes: tuple[NDArray[np.float64], ...] = ()
        self._tie_w_k = np.zeros(nodes)
        self._structure = disturbance_structure(model, self._values)
        self._structure_size = np.sqrt((self._structure**2).sum(axis=1))
        self._heat_w = 0.0

    @property
    def model(self) -> ThermalModel:
        """The model in use."""
        return self._model

    @property
    def values(self) -> NDArray[np.float64]:
        """The parameters in use, shape (p,)."""
        return self._values.copy()

    @property
    def temperatures_c(self) -> NDArray[np.float64]:
        """Mean of the node temperatures, shape (nodes,)."""
        return self._state[: self._nodes].copy()

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance of the node temperatures in K2, shape (nodes, nodes)."""
        return self._covariance[: self._nodes, : self._nodes].copy()

    @property
    def operating_point(self) -> OperatingPoint | None:
        """Operating point of the last step; None before the first."""
        if self._point is None:
            return None
        return OperatingPoint(*self._point, self._ambient_c, self._inputs)

    def state(
        self,
        ambient_c: float | None = None,
        inputs: Sequence[float] | None = None,
        *,
        followed_s: float = np.inf,
    ) -> MachineState:
        """Return the machine's state: what forecasts, maps and advice start from.

        Parameters
        ----------
        ambient_c, inputs
            Ambient temperature in degC and inputs (k,) at this moment; by default those of the
            last step.
        followed_s
            For how long the machine has been followed, in s; by default long enough for its
            course to be known.

        Raises
        ------
        ValueError
            If an ambient temperature or inputs are missing before the first step.
        """
        point = self.operating_point
        if point is None and (ambient_c is None or (inputs is None and self._model.input_names)):
            raise ValueError("the observer has made no step yet: give ambient_c and all inputs")
        last = point or OperatingPoint(0.0, 0.0, 0.0)
        return MachineState(
            temperatures_c=self.temperatures_c,
            covariance=self.covariance,
            revolutions=self._revolutions,
            ambient_c=last.ambient_c if ambient_c is None else float(ambient_c),
            inputs=last.inputs if inputs is None else tuple(inputs),
            heat_disturbance_w=self.heat_disturbance_w,
            operating_point=point,
            course_known=course_known(followed_s),
        )

    @property
    def std_c(self) -> NDArray[np.float64]:
        """Standard deviation of the node temperatures in K, shape (nodes,)."""
        std: NDArray[np.float64] = np.sqrt(np.diag(self._covariance)[: self._nodes])
        return std

    @property
    def revolutions(self) -> float:
        """Revolutions since greasing."""
        return self._revolutions

    def renew_grease(self) -> None:
        """Count the revolutions from zero again: the grease is fresh."""
        self._revolutions = 0.0

    @property
    def heat_disturbance_w(self) -> NDArray[np.float64]:
        """Heat in W that the model lacks (or has too much of) per node, shape (nodes,).

        What keeps the estimate on the measurements where the model alone would leave them; it
        fades over :data:`DISTURBANCE_TIME_S`. A forecast that left it out would jump at its start.
        """
        if self._point is None:
            return np.zeros(self._nodes)
        heat: NDArray[np.float64] = self._disturbance_w(self._heat_w) @ self._state[self._nodes :]
        return heat

    def sensor(self, name: str) -> tuple[float, float]:
        """Mean in degC and standard deviation in K of what a perfect sensor would read now.

        Raises
        ------
        ValueError
            If there is no such sensor or node.
        """
        row = self._model.sensor_row(name)
        spread = self._covariance[: self._nodes, : self._nodes]
        return float(row @ self._state[: self._nodes]), float(np.sqrt(row @ spread @ row))

    def predict(
        self,
        dt_s: float,
        speed_rpm: float,
        load_n: float,
        ambient_c: float,
        inputs: ArrayLike = (),
    ) -> None:
        """Advance by *dt_s* at a constant operating point; any length, zero does nothing.

        The network's inputs, if it has any, are (k,) in its order.

        Raises
        ------
        ValueError
            If *dt_s* is negative, an argument is not finite or an input is missing.
        SimulationError
            If the model runs away; the state is left as it was.
        """
        if not np.isfinite([dt_s, speed_rpm, load_n, ambient_c]).all() or dt_s < 0.0:
            raise ValueError(
                f"predict: dt_s is {dt_s}, speed_rpm {speed_rpm}, load_n {load_n}, ambient_c "
                f"{ambient_c}; expected finite numbers and dt_s >= 0"
            )
        if dt_s == 0.0:
            return
        speed, load = abs(float(speed_rpm)), max(float(load_n), 0.0)
        held = self._model.holding(inputs)
        given = tuple(held.compiled.inputs.tolist())
        compiled, nodes = held.compiled, self._nodes
        if self._point != (speed, load) or self._inputs != given:
            capacity, coefficient, _, _ = self._bound
            self._modes = kernels.decompose(compiled, capacity, coefficient, speed, load)
            rate, modes, _, _ = self._modes
            # The diagonal of C^1/2 V lam V' C^1/2: what ties each node to all others.
            self._tie_w_k = capacity**2 * (modes**2 @ rate)
            self._point, self._inputs = (speed, load), given
        heat_w = max(self._heat_generated_w(compiled, speed, load), self._heat_w)
        disturbance_w = self._disturbance_w(heat_w)
        self._ambient_c = float(ambient_c)
        fading = 1.0 / DISTURBANCE_TIME_S
        mean_fading = -np.expm1(-fading * dt_s) / (fading * dt_s)
        heat = disturbance_w @ self._state[nodes:] * mean_fading
        path = np.empty((2, nodes))
        failed = kernels.simulate_kernel(
            compiled,
            self._values,
            np.array([0.0, dt_s]),
            np.array([speed, speed]),
            np.array([load, load]),
            np.array([ambient_c, ambient_c], dtype=np.float64),
            np.stack((compiled.inputs, compiled.inputs)),
            self._state[:nodes].copy(),
            self._revolutions,
            heat,
            0.0,
            path,
        )
        if failed >= 0:
            raise SimulationError(
                f"the observer's model {self._model.name!r} ran away at {speed:g} rpm and "
                f"{load:g} N"
            )
        # White heat of density s alone gives a node the variance s / (2 G C) in the long run.
        density = np.minimum(
            HEAT_NOISE_W_SQRT_S**2, 2.0 * NOISE_LIMIT_K**2 * self._tie_w_k * self._bound[0]
        )
        rate, modes, inverse, _ = self._modes
        transition, noise = transition_and_noise(
            dt_s, rate, modes, inverse, disturbance_w, DISTURBANCE_TIME_S, density
        )
        self._covariance = transition @ self._covariance @ transition.T + noise
        self._state[:nodes] = path[1]
        self._state[nodes:] *= np.exp(-fading * dt_s)
        self._heat_w = heat_w * float(np.exp(-dt_s / DISTURBANCE_FADE_S))
        self._revolutions += speed * dt_s / 60.0
        for name in self._elapsed_s:
            self._elapsed_s[name] += dt_s

    def update(self, measured: Mapping[str, float]) -> dict[str, Innovation]:
        """Take in readings of any sensors; those not named are simply not there.

        Parameters
        ----------
        measured
            Temperature in degC by sensor or node name; good readings only.

        Returns
        -------
        dict
            The innovation of each sensor, against the state before this call.

        Raises
        ------
        ValueError
            If a name is unknown or a reading not finite; nothing is taken in then.
        """
        names = list(measured)
        if not names:
            return {}
        readings = np.array([measured[name] for name in names], dtype=np.float64)
        for name, reading in zip(names, readings.tolist(), strict=True):
            if not np.isfinite(reading):
                raise ValueError(f"reading of {name} is {reading}, expected a finite number")
        rows = np.zeros((len(names), self._state.size))
        rows[:, : self._nodes] = self._model.sensor_matrix(names)
        variance = np.array([self._sensor_variance(name) for name in names])
        self._elapsed_s.update(dict.fromkeys(names, 0.0))
        difference = readings - rows @ self._state
        expected = rows @ self._covariance @ rows.T + np.diag(variance)
        gain = np.linalg.solve(expected, rows @ self._covariance).T
        self._state = self._state + gain @ difference
        # Joseph form: stays symmetric and positive whatever the rounding of the gain.
        kept = np.eye(self._state.size) - gain @ rows
        self._covariance = kept @ self._covariance @ kept.T + (gain * variance) @ gain.T
        std = np.sqrt(np.diag(expected))
        return {
            name: Innovation(float(difference[k]), float(std[k])) for k, name in enumerate(names)
        }

    def with_parameters(self, model: ThermalModel, values: ArrayLike) -> "Observer":
        """Continue with another model or other parameters and the same temperatures.

        The heat disturbances start again: what they had learned was the old model's error.

        Raises
        ------
        ValueError
            If the model has other nodes, or *values* has the wrong shape.
        """
        if model.node_names != self._model.node_names:
            raise ValueError(
                f"model {model.name!r} has other nodes than model {self._model.name!r}"
            )
        swapped = Observer(model, values, self.temperatures_c, self.covariance, self._revolutions)
        swapped._elapsed_s = dict(self._elapsed_s)
        swapped._heat_w = self._heat_w
        return swapped

    def to_dict(self) -> dict[str, object]:
        """Return the whole state as plain JSON types; the model and its values are not in it."""
        return {
            "state": self._state.tolist(),
            "covariance": self._covariance.tolist(),
            "revolutions": self._revolutions,
            "heat_w": self._heat_w,
        }

    @classmethod
    def from_dict(cls, model: ThermalModel, values: ArrayLike, data: Mapping[str, object]) -> Self:
        """Restore what :meth:`to_dict` gave.

        Raises
        ------
        ValueError
            If the data do not belong to this kind of model.
        """
        nodes = len(model.node_names)
        size = 2 * nodes
        state = np.asarray(data.get("state"), dtype=np.float64)
        covariance = np.asarray(data.get("covariance"), dtype=np.float64)
        if state.shape != (size,) or covariance.shape != (size, size):
            raise ValueError(
                f"observer state has shapes {state.shape} and {covariance.shape}, expected "
                f"({size},) and ({size}, {size})"
            )
        revolutions, heat_w = (_number(data, name) for name in ("revolutions", "heat_w"))
        observer = cls(model, values, state[:nodes], covariance[:nodes, :nodes], revolutions)
        if not (np.isfinite(state).all() and np.isfinite(covariance).all()):
            raise ValueError("observer state is not finite")
        observer._state = state
        observer._covariance = covariance
        observer._heat_w = heat_w
        return observer

    def _heat_generated_w(self, compiled: CompiledNetwork, speed: float, load: float) -> float:
        """Heat of friction and losses at the present state."""
        _, coefficient, friction, _ = self._bound
        temperatures = self._state[: self._nodes]
        losses = kernels.loss_heats_w(compiled, coefficient, temperatures, speed)
        point = kernels.friction_at_point(compiled.friction_kind, friction, speed, load)
        return float(losses.sum()) + float(
            kernels.friction_heat_w(
                compiled.friction_kind,
                friction,
                point,
                self._state[compiled.temperature_node],
                self._revolutions,
            )
        )

    def _disturbance_w(self, heat_w: float) -> NDArray[np.float64]:
        """Heats in W that independent disturbances of one bring to the nodes, (nodes, nodes)."""
        scale = DISTURBANCE_AT_REST_W + heat_w
        limit_k = DISTURBANCE_LIMIT_K + DISTURBANCE_LIMIT_K_W * heat_w
        limit = limit_k * self._tie_w_k / self._structure_size
        result: NDArray[np.float64] = self._structure * np.minimum(scale, limit)[:, None]
        return result

    def _sensor_variance(self, name: str) -> float:
        """Variance of a reading; a quickly repeated one repeats most of the slow error."""
        elapsed = self._elapsed_s.get(name, SENSOR_DRIFT_TIME_S)
        repeats = max(SENSOR_DRIFT_TIME_S / max(elapsed, 1e-3), 1.0)
        return SENSOR_NOISE_K**2 + SENSOR_RESOLUTION_K**2 / 12.0 + SENSOR_DRIFT_K**2 * repeats


def not_colder_than(
    floor_c: float, mean_c: ArrayLike, covariance: ArrayLike
) -> NDArray[np.float64]:
    """Project an estimate onto what is possible: no node colder than its coldest surroundings.

    The nearest possible state in the metric of the covariance (Simon and Chia, IEEE Trans. AES 38,
    2002, 128): what is known hardly moves, what is not known goes to the bound and takes with it
    what depends on it.

    Parameters
    ----------
    floor_c
        Coldest temperature of the surroundings, now and as long as a body remembers, degC.
    mean_c, covariance
        Estimate (nodes,) in degC and its covariance (nodes, nodes) in K2.
    """
    mean = np.asarray(mean_c, np.float64)
    spread = np.asarray(covariance, np.float64)
    bound: set[int] = set()
    result = mean.copy()
    for _ in range(mean.size):
        below = set(np.flatnonzero(result < floor_c - 1e-9).tolist())
        if below <= bound:
            break
        bound |= below
        rows = sorted(bound)
        # Where the bound lies is known no better than the sensors that it comes from.
        block = spread[np.ix_(rows, rows)] + FLOOR_ERROR_K**2 * np.eye(len(rows))
        result = mean - spread[:, rows] @ np.linalg.solve(block, mean[rows] - floor_c)
    return np.maximum(result, floor_c) if bound else result


def _number(data: Mapping[str, object], name: str) -> float:
    value = data.get(name)
    if not isinstance(value, int | float):
        raise ValueError(f"observer state: {name} is {value!r}, expected a number")
    return float(value)
