"""Observers of many machines of one network form, advanced by one call."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.kalman import (
    SENSOR_DRIFT_TIME_S,
    Estimates,
    Machines,
    Modes,
    advance_range,
    disturbance_heats_w,
    update_range,
)
from twin_core.machine_state import MachineState, course_known
from twin_core.models import ThermalModel
from twin_core.process_noise import disturbance_structure
from twin_core.profiles import Point
from twin_core.simulation import kernels
from twin_core.simulation.compiling import kernel_array

FloatArray = NDArray[np.float64]


class Form:
    """A model, and where the readings of its nodes and sensors go."""

    def __init__(self, model: ThermalModel) -> None:
        self.model = model
        # A node's own sensor goes before a standard one of the same name.
        names = dict.fromkeys((*model.node_names, *model.sensor_names))
        self.column = {name: column for column, name in enumerate(names)}
        self.rows = kernel_array(model.sensor_matrix(list(names)))
        self.every = np.arange(len(names))

    @cached_property
    def key(self) -> tuple[object, ...]:
        """What the models of machines must have in common to be advanced together."""
        net = [np.asarray(part).tobytes() for part in self.model.compiled]
        return *net, *self.column, self.rows.tobytes(), self.model.input_names


class States(NamedTuple):
    """All that the filters of machines hold."""

    machines: Machines
    modes: Modes
    estimates: Estimates


class Observers:
    """Kalman filters of machines of one network form: every array has one row per machine.

    One call advances all of them. A single machine is a row, see `twin_core.observer`.

    `model`: its values are those of no machine; `values`: parameters of the machines, shape (n, p),
    physical units; `temperatures_c`: means, shape (n, nodes); `covariance`: in K2, shape (n, nodes,
    nodes); `revolutions` since greasing, shape (n,). Raises `ValueError` if a shape is wrong or a
    value not finite, `SimulationError` if the model has no steady state at a usual operating point.
    """

    def __init__(
        self,
        model: ThermalModel,
        values: ArrayLike,
        temperatures_c: ArrayLike,
        covariance: ArrayLike,
        revolutions: ArrayLike,
    ) -> None:
        nodes = len(model.node_names)
        own = kernel_array(np.array(values, np.float64))
        machines = len(own)
        mean = kernel_array(np.array(temperatures_c, np.float64))
        spread = np.array(covariance, np.float64)
        turned = kernel_array(np.array(revolutions, np.float64))
        for name, array, shape in (
            ("values", own, (machines, model.parameters.size)),
            ("temperatures_c", mean, (machines, nodes)),
            ("covariance", spread, (machines, nodes, nodes)),
            ("revolutions", turned, (machines,)),
        ):
            if array.shape != shape:
                raise ValueError(
                    f"{name} has shape {array.shape[1:]}, expected {shape[1:]} for each of "
                    f"{machines} machines (got {len(array)})"
                )
            if not np.isfinite(array).all():
                raise ValueError(f"{name} is not finite: {array.tolist()}")
        self.form = Form(model)
        self.states = _new_states(self.form, own, mean, spread, turned)

    @classmethod
    def of(cls, form: Form, states: States) -> Self:
        """Observers of a model with these states."""
        result = object.__new__(cls)
        result.form, result.states = form, states
        return result

    @classmethod
    def joined(cls, parts: "Sequence[Observers]") -> Self:
        """Copy the machines of several, all of one form, into one; see `Form.key`."""

        def join(states: Sequence[tuple[FloatArray, ...]]) -> list[FloatArray]:
            return [np.concatenate(arrays) for arrays in zip(*states, strict=True)]

        machines, modes, estimates = zip(*(part.states for part in parts), strict=True)
        states = States(Machines(*join(machines)), Modes(*join(modes)), Estimates(*join(estimates)))
        return cls.of(parts[0].form, states)

    def row(self, machine: int, form: Form) -> Self:
        """Return a machine alone, with a model of the same form: a view of its row."""
        only = slice(machine, machine + 1)
        machines, modes, estimates = ([array[only] for array in part] for part in self.states)
        return self.of(form, States(Machines(*machines), Modes(*modes), Estimates(*estimates)))

    @property
    def model(self) -> ThermalModel:
        """The model in use."""
        return self.form.model

    @property
    def values(self) -> FloatArray:
        """The parameters in use, shape (n, p)."""
        return self.states.machines.values.copy()

    @property
    def size(self) -> int:
        """Number of machines, n."""
        return len(self.states.machines.values)

    @property
    def temperatures_c(self) -> FloatArray:
        """Means of the node temperatures, shape (n, nodes)."""
        return self.states.estimates.temperatures_c.copy()

    @property
    def covariance(self) -> FloatArray:
        """Covariances of the node temperatures in K2, shape (n, nodes, nodes)."""
        return self.states.estimates.tt.copy()

    @property
    def revolutions(self) -> FloatArray:
        """Revolutions since greasing, shape (n,)."""
        return self.states.estimates.revolutions.copy()

    def operating_point(self, machine: int) -> Point | None:
        """Operating point of a machine's last step; None before the first."""
        speed_rpm, load_n = self.states.modes.point[machine].tolist()
        if np.isnan(speed_rpm):
            return None
        inputs = tuple(self.states.modes.given[machine].tolist())
        return Point(speed_rpm, load_n, float(self.states.modes.ambient_c[machine]), inputs)

    def heat_disturbance_w(self, machine: int) -> FloatArray:
        """Heat in W that a machine's model lacks per node, (nodes,); see `Observer`."""
        known, estimates = self.states.machines, self.states.estimates
        if np.isnan(self.states.modes.point[machine, 0]):
            return np.zeros(len(self.model.node_names))
        brought_w = disturbance_heats_w(
            known.structure[machine],
            known.structure_size[machine],
            self.states.modes.tie_w_k[machine],
            float(estimates.heat_w[machine]),
        )
        return np.asarray(brought_w @ estimates.disturbances[machine])

    def predict(
        self,
        dt_s: ArrayLike,
        speed_rpm: ArrayLike,
        load_n: ArrayLike,
        ambient_c: ArrayLike,
        inputs: ArrayLike = (),
    ) -> NDArray[np.bool_]:
        """Advance every machine by its *dt_s* at its operating point; zero does nothing.

        Each is (n,) or one number for all; the network's inputs, if it has any, are (n, k) or (k,).

        Returns (n,) machines whose model runs away; they are left as they were. Raises `ValueError`
        if a *dt_s* is negative, an argument is not finite or an input is missing.
        """
        columns = {"dt_s": dt_s, "speed_rpm": speed_rpm, "load_n": load_n, "ambient_c": ambient_c}
        given = np.empty((len(columns), self.size))
        for array, (name, values) in zip(given, columns.items(), strict=True):
            array[:] = values
            wrong = ~np.isfinite(array)
            if name == "dt_s":
                wrong |= array < 0.0
            if wrong.any():
                machine = int(np.flatnonzero(wrong)[0])
                raise ValueError(
                    f"predict: {name} of machine {machine} is {array[machine]}, expected finite "
                    "numbers and dt_s >= 0"
                )
        count = len(self.model.input_names)
        drives = np.asarray(inputs, np.float64)
        if drives.shape[-1] != count or not np.isfinite(drives).all():
            for row in np.atleast_2d(drives):
                self.model.holding(row)
        every = np.empty((self.size, count))
        every[:] = drives
        return self.advance(given, every)

    def advance(self, given: FloatArray, inputs: FloatArray) -> NDArray[np.bool_]:
        """`predict` without its checks: *given* has the rows dt_s, speed_rpm, load_n, ambient_c."""
        ran_away = advance_range(self.model.compiled, *self.states, given, inputs)
        return np.asarray(ran_away)

    def update(self, names: Sequence[str], readings: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Take in readings of any sensors.

        `names`: sensors or nodes; `readings` (n, names) temperatures in degC, NaN where there is
        none; good readings only. Returns `difference_k`, `std_k`: (n, names) reading minus
        expectation, and the expected standard deviation of that, against the state before this
        call; NaN where there is no reading. Raises `ValueError` if a name is unknown or a shape
        wrong; nothing changes then.
        """
        table = kernel_array(readings)
        if table.shape != (self.size, len(names)):
            raise ValueError(
                f"readings have shape {table.shape}, expected {(self.size, len(names))}"
            )
        columns = np.array([self.column(name) for name in names], np.int64)
        difference_k, std_k = update_range(
            self.form.rows[columns], columns, table, self.states.estimates
        )
        return difference_k, std_k

    def take(self, table: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`update` without its checks: *table* (n, readable) has all `readable` in their order."""
        difference_k, std_k = update_range(
            self.form.rows, self.form.every, table, self.states.estimates
        )
        return difference_k, std_k

    def column(self, name: str) -> int:
        """Place of a sensor or node among `readable`; raises `ValueError` if there is no such."""
        if name not in self.form.column:
            self.model.sensor_row(name)  # raises, and says which there are
        return self.form.column[name]

    @property
    def readable(self) -> Sequence[str]:
        """The nodes and sensors that can be read."""
        return tuple(self.form.column)

    def state(
        self,
        machine: int,
        ambient_c: float | None = None,
        inputs: Sequence[float] | None = None,
        *,
        followed_s: float = np.inf,
    ) -> MachineState:
        """Return the state of a machine; see `Observer.state`."""
        point, estimates = self.operating_point(machine), self.states.estimates
        if point is None and (ambient_c is None or (inputs is None and self.model.input_names)):
            raise ValueError("the observer has made no step yet: give ambient_c and all inputs")
        last = point or Point(0.0, 0.0, 0.0)
        return MachineState(
            temperatures_c=estimates.temperatures_c[machine].copy(),
            covariance=estimates.tt[machine].copy(),
            revolutions=float(estimates.revolutions[machine]),
            ambient_c=last.ambient_c if ambient_c is None else float(ambient_c),
            inputs=last.inputs if inputs is None else tuple(inputs),
            heat_disturbance_w=self.heat_disturbance_w(machine),
            operating_point=point,
            course_known=course_known(followed_s),
        )

    def renew_grease(self, machine: int) -> None:
        """Count the revolutions of a machine from zero again: the grease is fresh."""
        self.states.estimates.revolutions[machine] = 0.0

    def to_dict(self, machine: int) -> dict[str, object]:
        """Return the whole state of a machine as plain JSON types; the model is not in it."""
        estimates, nodes = self.states.estimates, len(self.model.node_names)
        covariance = np.empty((2 * nodes, 2 * nodes))
        covariance[:nodes, :nodes] = estimates.tt[machine]
        covariance[:nodes, nodes:] = estimates.td[machine]
        covariance[nodes:, :nodes] = estimates.td[machine].T
        covariance[nodes:, nodes:] = estimates.dd[machine]
        means = estimates.temperatures_c[machine], estimates.disturbances[machine]
        return {
            "state": np.concatenate(means).tolist(),
            "covariance": covariance.tolist(),
            "revolutions": float(estimates.revolutions[machine]),
            "heat_w": float(estimates.heat_w[machine]),
        }

    def restore(self, machine: int, data: Mapping[str, object]) -> None:
        """Restore what `to_dict` gave.

        Raises `ValueError` if the data do not belong to this kind of model.
        """
        nodes = len(self.model.node_names)
        size = 2 * nodes
        state = np.asarray(data.get("state"), dtype=np.float64)
        covariance = np.asarray(data.get("covariance"), dtype=np.float64)
        if state.shape != (size,) or covariance.shape != (size, size):
            raise ValueError(
                f"observer state has shapes {state.shape} and {covariance.shape}, expected "
                f"({size},) and ({size}, {size})"
            )
        if not (np.isfinite(state).all() and np.isfinite(covariance).all()):
            raise ValueError("observer state is not finite")
        revolutions, heat_w = (_number(data, name) for name in ("revolutions", "heat_w"))
        estimates = self.states.estimates
        estimates.temperatures_c[machine] = state[:nodes]
        estimates.disturbances[machine] = state[nodes:]
        estimates.tt[machine] = covariance[:nodes, :nodes]
        estimates.td[machine] = covariance[:nodes, nodes:]
        estimates.dd[machine] = covariance[nodes:, nodes:]
        estimates.revolutions[machine], estimates.heat_w[machine] = revolutions, heat_w

    def with_parameters(self, model: ThermalModel, values: ArrayLike) -> "Observers":
        """Continue with another model or other parameters (n, p) and the same temperatures.

        The heat disturbances start again: what they had learned was the old model's error.

        Raises `ValueError` if the model has other nodes, or *values* has the wrong shape.
        """
        if model.node_names != self.model.node_names:
            raise ValueError(f"model {model.name!r} has other nodes than model {self.model.name!r}")
        swapped = Observers(model, values, self.temperatures_c, self.covariance, self.revolutions)
        swapped.states.estimates.heat_w[:] = self.states.estimates.heat_w
        for name, column in swapped.form.column.items():
            if name in self.form.column:
                since_s = self.states.estimates.elapsed_s[:, self.form.column[name]]
                swapped.states.estimates.elapsed_s[:, column] = since_s
        return swapped


def _new_states(
    form: Form, own: FloatArray, mean: FloatArray, spread: FloatArray, turned: FloatArray
) -> States:
    """States of machines with these parameters and estimates that have made no step yet."""
    model, (machines, nodes) = form.model, mean.shape
    bound = [kernels.bind_network(model.compiled, row) for row in own]
    capacity, coefficient, friction = (np.array([parts[k] for parts in bound]) for k in range(3))
    structure = np.array([disturbance_structure(model, row) for row in own])
    return States(
        Machines(
            own,
            capacity,
            coefficient,
            friction,
            structure,
            np.sqrt((structure**2).sum(axis=2)),
        ),
        Modes(
            np.full((machines, 2), np.nan),
            np.full((machines, len(model.input_names)), np.nan),
            np.zeros((machines, nodes)),
            np.zeros((machines, nodes, nodes)),
            np.zeros((machines, nodes, nodes)),
            np.zeros((machines, nodes)),
            np.zeros(machines),
        ),
        Estimates(
            mean,
            np.zeros((machines, nodes)),
            kernel_array((spread + spread.transpose(0, 2, 1)) / 2.0),
            np.zeros((machines, nodes, nodes)),
            np.tile(np.eye(nodes), (machines, 1, 1)),
            turned,
            np.zeros(machines),
            np.full((machines, len(form.column)), SENSOR_DRIFT_TIME_S),
        ),
    )


def _number(data: Mapping[str, object], name: str) -> float:
    value = data.get(name)
    if not isinstance(value, int | float):
        raise ValueError(f"observer state: {name} is {value!r}, expected a number")
    return float(value)
