"""State observer: all node temperatures from whatever sensors are good at the moment.

A Kalman filter. The mean goes through the same kernel as every simulation; the covariance
through the exact transition matrix of the operating point. Two kinds of model error:

- *heat disturbances*: unknown heats at the nodes that drift as stationary first-order processes
  over :data:`DISTURBANCE_TIME_S`. Their covariance is what errors of the friction heat, of its
  split and of every resistance (heat that flows from one end of an edge to the other) would
  cause in the steady state of a usual operating point; it goes with the friction heat, and fades
  slowly once that is gone. They are states of the filter: it learns a lasting model error and
  stays on the sensors without an offset, the spread of unmeasured nodes shows how far wrong the
  resistances may have led them, and when sensors are lost it grows everywhere.
- *heat noise*: short-lived, white, the same at every node; in temperature it counts least where
  the heat capacity is large.

A sensor's error is white noise, quantisation and a part that stays for about a minute: readings
that come every second do not count sixty times.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.observers import Observers
from twin_core.profiles import Point
from twin_core.simulation import SimulationError

FLOOR_ERROR_K = 0.5
"""Standard deviation of the coldest temperature of the surroundings."""


class Innovation(NamedTuple):
    """What a sensor said against what was expected."""

    difference_k: float  # reading minus expectation
    std_k: float  # expected standard deviation of the difference


class Observation(NamedTuple):
    """What one machine did since its last step, and what its sensors say now."""

    #: See `Observer.predict`.
    dt_s: float
    speed_rpm: float
    load_n: float
    ambient_c: float
    inputs: tuple[float, ...]
    measured: Mapping[str, float]  # see `Observer.update`


class Observer:
    """Kalman filter over the state nodes of one machine: a row of `Observers`.

    Machines that were advanced together share arrays, of which each has a row.

    `values`: its parameters, shape (p,), physical units; `temperatures_c`: mean, shape (nodes,);
    `covariance`: in K2, shape (nodes, nodes); `revolutions` since greasing. Raises `ValueError` if
    a shape is wrong or a value not finite, `SimulationError` if the model has no steady state at a
    usual operating point.
    """

    def __init__(
        self,
        model: ThermalModel,
        values: ArrayLike,
        temperatures_c: ArrayLike,
        covariance: ArrayLike,
        revolutions: float = 0.0,
    ) -> None:
        own, mean_c, spread = (
            np.asarray(part, np.float64)[None] for part in (values, temperatures_c, covariance)
        )
        self.one = Observers(model, own, mean_c, spread, [revolutions])
        self.shared, self.place = self.one, 0

    def share(self, shared: Observers, place: int) -> None:
        """Go on as a row of arrays that others have rows in, too."""
        self.one, self.shared, self.place = shared.row(place, self.one.form), shared, place

    @property
    def model(self) -> ThermalModel:
        """The model in use."""
        return self.one.model

    @property
    def values(self) -> NDArray[np.float64]:
        """The parameters in use, shape (p,)."""
        return np.asarray(self.one.values[0])

    @property
    def temperatures_c(self) -> NDArray[np.float64]:
        """Mean of the node temperatures, shape (nodes,)."""
        return np.asarray(self.one.temperatures_c[0])

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance of the node temperatures in K2, shape (nodes, nodes)."""
        return np.asarray(self.one.covariance[0])

    @property
    def operating_point(self) -> Point | None:
        """Operating point of the last step; None before the first."""
        return self.one.operating_point(0)

    def state(
        self,
        ambient_c: float | None = None,
        inputs: Sequence[float] | None = None,
        *,
        followed_s: float = np.inf,
    ) -> MachineState:
        """Return the machine's state: what forecasts, maps and advice start from.

        `ambient_c`, `inputs`: ambient temperature in degC and inputs (k,) at this moment; by
        default those of the last step; `followed_s`: for how long the machine has been followed, in
        s; by default long enough for its course to be known. Raises `ValueError` if an ambient
        temperature or inputs are missing before the first step.
        """
        return self.one.state(0, ambient_c, inputs, followed_s=followed_s)

    @property
    def std_c(self) -> NDArray[np.float64]:
        """Standard deviation of the node temperatures in K, shape (nodes,)."""
        std: NDArray[np.float64] = np.sqrt(np.diag(self.covariance))
        return std

    @property
    def revolutions(self) -> float:
        """Revolutions since greasing."""
        return float(self.one.revolutions[0])

    def renew_grease(self) -> None:
        """Count the revolutions from zero again: the grease is fresh."""
        self.one.renew_grease(0)

    @property
    def heat_disturbance_w(self) -> NDArray[np.float64]:
        """Heat in W that the model lacks (or has too much of) per node, shape (nodes,).

        What keeps the estimate on the measurements where the model alone would leave them; it
        fades over :data:`twin_core.kalman.DISTURBANCE_TIME_S`. A forecast that left it out would
        jump at its start.
        """
        return self.one.heat_disturbance_w(0)

    def sensor(self, name: str) -> tuple[float, float]:
        """Mean in degC and standard deviation in K of what a perfect sensor would read now.

        Raises `ValueError` if there is no such sensor or node.
        """
        row = self.model.sensor_row(name)
        return float(row @ self.temperatures_c), float(np.sqrt(row @ self.covariance @ row))

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

        Raises `ValueError` if *dt_s* is negative, an argument is not finite or an input is missing,
        `SimulationError` if the model runs away; the state is left as it was.
        """
        if self.one.predict(dt_s, speed_rpm, load_n, ambient_c, inputs)[0]:
            raise _ran_away(self.model.name, speed_rpm, load_n)

    def update(self, measured: Mapping[str, float]) -> dict[str, Innovation]:
        """Take in readings of any sensors; those not named are simply not there.

        `measured`: temperature in degC by sensor or node name; good readings only. Returns the
        innovation of each sensor, against the state before this call. Raises `ValueError` if a name
        is unknown or a reading not finite; nothing changes then.
        """
        if not measured:
            return {}
        for name, reading in measured.items():
            _check_reading(name, reading)
        difference, std = self.one.update(list(measured), [list(measured.values())])
        return {
            name: Innovation(*found)
            for name, *found in zip(measured, difference[0].tolist(), std[0].tolist(), strict=True)
        }

    def with_parameters(self, model: ThermalModel, values: ArrayLike) -> "Observer":
        """Continue with another model or other parameters and the same temperatures.

        The heat disturbances start again: what they had learned was the old model's error.

        Raises `ValueError` if the model has other nodes, or *values* has the wrong shape.
        """
        swapped = object.__new__(Observer)
        swapped.one = self.one.with_parameters(model, np.asarray(values, np.float64)[None])
        swapped.shared, swapped.place = swapped.one, 0
        return swapped

    def to_dict(self) -> dict[str, object]:
        """Return the whole state as plain JSON types; the model and its values are not in it."""
        return self.one.to_dict(0)

    @classmethod
    def from_dict(cls, model: ThermalModel, values: ArrayLike, data: Mapping[str, object]) -> Self:
        """Restore what :meth:`to_dict` gave.

        Raises `ValueError` if the data do not belong to this kind of model.
        """
        nodes = len(model.node_names)
        observer = cls(model, values, np.zeros(nodes), np.eye(nodes))
        observer.one.restore(0, data)
        return observer


def advance(
    observers: Sequence[Observer], steps: Sequence[Observation]
) -> list[dict[str, Innovation] | ValueError]:
    """Advance many machines, each as by its own `Observer.predict` and `Observer.update`.

    Machines of one network form cost one call. They then share arrays, until one of them is
    advanced together with a machine that is not among them. Each observer is given once. Returns
    their innovations, or what `Observer.predict` or `Observer.update` raises.
    """
    results: list[dict[str, Innovation] | ValueError] = [{} for _ in observers]
    sharing: dict[Observers, list[int]] = {}
    for k, (observer, step) in enumerate(zip(observers, steps, strict=True)):
        numbers = sum(step.inputs, step.dt_s + step.speed_rpm + step.load_n + step.ambient_c)
        usual = isfinite(numbers) and step.dt_s >= 0.0
        if usual and len(step.inputs) == len(observer.model.input_names):
            sharing.setdefault(observer.shared, []).append(k)
            continue
        try:
            observer.predict(*step[:5])
            results[k] = observer.update(step.measured)
        except ValueError as error:
            results[k] = error
    forms: dict[object, list[int]] = {}
    for shared, found in sharing.items():
        forms.setdefault(shared.form.key, []).extend(found)
    for places in forms.values():
        advanced = _advance_form([observers[k] for k in places], [steps[k] for k in places])
        for k, result in zip(places, advanced, strict=True):
            results[k] = result
    return results


def _advance_form(
    observers: Sequence[Observer], steps: Sequence[Observation]
) -> Iterator[dict[str, Innovation] | ValueError]:
    """Advance machines of one form by steps that `Observer.predict` takes; gives the results."""
    many, rows = _shared(observers)
    inputs, width = np.zeros((many.size, len(many.model.input_names))), len(many.readable)
    given = np.zeros((4, many.size))
    given[:, rows] = np.transpose([step[:4] for step in steps])
    if inputs.size:
        inputs[rows] = [step.inputs for step in steps]
    ran_away = many.advance(given, inputs)
    places: list[int] = []
    readings: list[float] = []
    errors: list[ValueError | None] = []
    for observer, row, step, failed in zip(
        observers, rows, steps, ran_away[rows].tolist(), strict=True
    ):
        error: ValueError | None = None
        if failed:
            error = _ran_away(observer.model.name, step.speed_rpm, step.load_n)
        if error is None:
            try:
                for name, reading in step.measured.items():
                    _check_reading(name, reading)
                columns = [many.column(name) for name in step.measured]
            except ValueError as refused:
                error = refused
            else:
                places += [row * width + column for column in columns]
                readings += step.measured.values()
        errors.append(error)
    table = np.full((many.size, width), np.nan)
    table.flat[places] = readings
    found = (part.flat[places].tolist() for part in many.take(table))
    innovations = map(Innovation, *found)
    for step, error in zip(steps, errors, strict=True):
        # Not strict: the innovations of the others follow. The names come first, so that no
        # innovation is lost at their end.
        yield error or dict(zip(step.measured, innovations, strict=False))


def _shared(observers: Sequence[Observer]) -> tuple[Observers, list[int]]:
    """Arrays that hold the machines, and the row of each; they may hold others, too."""
    if len(observers) == 1:
        return observers[0].one, [0]
    shared = observers[0].shared
    if any(observer.shared is not shared for observer in observers):
        shared = Observers.joined([observer.one for observer in observers])
        for row, observer in enumerate(observers):
            observer.share(shared, row)
    return shared, [observer.place for observer in observers]


def _ran_away(model: str, speed_rpm: float, load_n: float) -> SimulationError:
    return SimulationError(
        f"the observer's model {model!r} ran away at {abs(speed_rpm):g} rpm and "
        f"{max(load_n, 0.0):g} N"
    )


def _check_reading(name: str, reading: float) -> None:
    if not isfinite(reading):
        raise ValueError(f"reading of {name} is {reading}, expected a finite number")


def not_colder_than(
    floor_c: float, mean_c: ArrayLike, covariance: ArrayLike
) -> NDArray[np.float64]:
    """Project an estimate onto what is possible: no node colder than its coldest surroundings.

    The nearest possible state in the metric of the covariance (Simon and Chia, IEEE Trans. AES 38,
    2002, 128): what is known hardly moves, what is not known goes to the bound and takes with it
    what depends on it.

    `floor_c`: coldest temperature of the surroundings, now and as long as a body remembers, degC;
    `mean_c`, `covariance`: estimate (nodes,) in degC and its covariance (nodes, nodes) in K2.
    """
    mean = np.asarray(mean_c, np.float64)
    if mean.min() >= floor_c - 1e-9:
        return mean.copy()
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
