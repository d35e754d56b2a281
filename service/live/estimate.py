"""The running estimate of one asset: the observer, fed with what the readings gave."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from adapters.samples import Quality, Sample
from service.documents.machine import Estimate, PointOfEstimate
from service.domain.channels import AMBIENT, LOAD, SPEED, is_modelled
from service.live.kept import KeptEstimate
from twin_core.filtering import begin
from twin_core.identification.posterior import Posterior
from twin_core.machine_state import FOLLOWED_S, MachineState
from twin_core.models import ThermalModel
from twin_core.naive import NaiveForecasts
from twin_core.observer import Innovation, Observation, Observer, advance, not_colder_than
from twin_core.operating_points import usual_levels
from twin_core.process_noise import (
    DEVIATION_K,
    HALF_WIDTH_95,
    between_joints,
    joint_variance,
    known_within_k,
)
from twin_core.profiles import Point
from twin_core.windows import stands_at_ambient

# A gap without any knowledge of the operating point longer than this starts the estimate again,
# and so does a clock that was set back by more than it ever jitters.
_LONGEST_GAP_S = 1800.0
_CLOCK_JITTER_S = 60.0
# So long a heavy machine stays colder than an ambient that has become warmer.
_REMEMBERS_COLD_S = 6 * 3600.0
# A longer step is a stop of the service: no one saw what the machine did.
_LONGEST_SEEN_S = 300.0


@dataclass(frozen=True, slots=True)
class RunningModel:
    """A model version that the live twin runs on.

    ``drifted``: its drift report says *changed*. ``naive``: simple forecasts fitted to its data.
    """

    version: int
    model: ThermalModel
    posterior: Posterior
    identified_at_us: int | None
    drifted: bool = False
    naive: NaiveForecasts | None = None

    @property
    def identified(self) -> bool:
        """Whether it was identified. A model that was not is no judge of what lies ahead.

        Verdict, alarms, tags and page ask this: until then no word, no predicted alarm, no fan.
        """
        return self.identified_at_us is not None

    @property
    def values(self) -> NDArray[np.float64]:
        """Physical parameter values at the posterior's centre, shape (p,)."""
        return self.model.parameters.values_from_z(self.posterior.z)


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedState:
    """What the live twin knows of its machine at a moment.

    Attributes
    ----------
    active : RunningModel
        The model version that the twin runs on.
    machine : MachineState
        State of the machine.
    point : Point
        What it runs at.
    time_us : int
        Process time.
    """

    active: RunningModel
    machine: MachineState
    point: Point
    time_us: int

    def document(self) -> Estimate:
        """The state without the model, for other processes."""
        point = PointOfEstimate(**asdict(self.point))
        return Estimate(machine=self.machine.to_dict(), point=point, time_us=self.time_us)

    @classmethod
    def read(cls, active: RunningModel, shown: Estimate) -> "EstimatedState":
        """Restore what `document` gave, of a twin that ran on this model."""
        machine = MachineState.from_dict(shown.machine)
        return cls(active, machine, Point(**dict(shown.point)), shown.time_us)


class LiveEstimate:
    """Thirteen node temperatures with their spread, carried forward step by step.

    Before the first good temperatures have come there is no estimate; it never starts from an
    assumption about the machine that no sensor supports.

    Parameters
    ----------
    active : RunningModel
        The model version to run on; `swap` changes it without a gap.
    bounds : mapping of str to (float, float), optional
        Lowest and highest speed, load and ambient that are believed at all.
    """

    def __init__(
        self, active: RunningModel, bounds: Mapping[str, tuple[float, float]] | None = None
    ) -> None:
        self._run_on(active)
        self._bounds = bounds or {}
        self.time_us: int | None = None
        self.point: Point | None = None
        #: What the sensors said against what was expected, at the last step.
        self.innovations: Mapping[str, Innovation] = {}
        #: For how long it has followed temperatures, in s; of a machine that began at standstill,
        #: whose state was known then, long enough from the beginning.
        self.followed_s = 0.0
        self._observer: Observer | None = None
        self._revolutions = 0.0
        self._ambient_measured = False
        self._floor_c: float | None = None
        self._known_c: NDArray[np.float64] | None = None
        self._spread_k: NDArray[np.float64] | None = None

    @property
    def started(self) -> bool:
        """Whether there is an estimate."""
        return self._observer is not None

    @property
    def observer(self) -> Observer:
        """The observer; ask `started` first."""
        if self._observer is None:
            raise RuntimeError("the estimate has not started")
        return self._observer

    @property
    def temperatures_c(self) -> NDArray[np.float64]:
        """Mean of the node temperatures in degC: the observer's, not colder than is possible."""
        observer = self.observer
        if self._known_c is None:  # of this step; who shows it asks a dozen times
            means_c = observer.temperatures_c
            if self._floor_c is not None:
                means_c = not_colder_than(self._floor_c, means_c, observer.covariance)
            self._known_c = means_c
        return self._known_c.copy()

    @property
    def std_c(self) -> NDArray[np.float64]:
        """Standard deviation of the node temperatures in K, as a forecast's band begins.

        That of the observer, and what no observer learns: where between its joints a body lies, and
        what no parameter expresses.
        """
        if self._spread_k is None:
            model = self.active.model
            variance = self.observer.std_c**2 + joint_variance(self._joints, self.temperatures_c)
            self._spread_k = np.sqrt(variance + (DEVIATION_K * model.errors.scale) ** 2)
        return self._spread_k.copy()

    def not_known(self) -> dict[str, float]:
        """Nodes without a sensor that are not known: half their 95 % band in K, by name."""
        model = self.active.model
        within_k = known_within_k(model)
        half_k = (HALF_WIDTH_95 * self.std_c).tolist()
        return {
            name: half
            for name, half in zip(model.node_names, half_k, strict=True)
            if not half <= within_k
        }

    def state(self) -> EstimatedState | None:
        """The present state, for forecasts, maps and advice; None before there is an estimate."""
        if self._observer is None or self.point is None or self.time_us is None:
            return None
        machine = self._observer.state(
            self.point.ambient_c, self.point.inputs, followed_s=self.followed_s
        )
        machine = replace(machine, temperatures_c=self.temperatures_c)
        return EstimatedState(self.active, machine, self.point, self.time_us)

    def _note_surroundings(
        self, duration_s: float, point: Point, temperatures: Mapping[str, float]
    ) -> None:
        """Follow the coldest of ambient and readings; a body remembers it for hours."""
        coldest_c = min([point.ambient_c, *temperatures.values()])
        if self._floor_c is None or coldest_c < self._floor_c:
            self._floor_c = coldest_c
        else:
            forgotten = -math.expm1(-max(duration_s, 0.0) / _REMEMBERS_COLD_S)
            self._floor_c += forgotten * (coldest_c - self._floor_c)

    def swap(self, active: RunningModel) -> None:
        """Go on with another model version from the present temperatures."""
        self._known_c = self._spread_k = None
        self.innovations = {}  # those of the model before say nothing about this one
        if self._observer is not None:
            self._observer = self._observer.with_parameters(active.model, active.values)
        self._run_on(active)

    def _run_on(self, active: RunningModel) -> None:
        self.active = active
        self._sensor_rows = active.model.sensor_matrix(active.model.sensor_names)
        self._joints = between_joints(active.model)

    def step(self, now_us: int, means: Mapping[str, float]) -> None:
        """Advance to ``now_us`` with the mean readings since the last step.

        Parameters
        ----------
        now_us : int
            Process time to advance to.
        means : mapping of str to float
            Means of the good samples by channel; a missing channel means that nothing good came.
            Speed, load and ambient then stay what they were, temperatures are not corrected.

        Raises
        ------
        ValueError
            If the machine cannot have such a speed, load or ambient; nothing is used then.
        """
        error = step_together([self], now_us, [means])[0]
        if error is not None:
            raise error

    def _due(self, now_us: int, means: Mapping[str, float]) -> tuple[Observation, Point] | None:
        """What a step has to bring into the observer; None where it goes no further."""
        self._known_c = self._spread_k = None
        for name, (low, high) in self._bounds.items():
            if name in means and not low <= means[name] <= high:
                raise ValueError(
                    f"{name} is {means[name]:g}, expected a value from {low:g} to {high:g}"
                )
        temperatures = {name: value for name, value in means.items() if is_modelled(name)}
        self.innovations = {}
        self._ambient_measured |= AMBIENT in means
        point = self._operating_point(means, temperatures)
        if point is None:
            return None
        duration_s = (now_us - (self.time_us or now_us)) / 1e6
        if not -_CLOCK_JITTER_S < duration_s < _LONGEST_GAP_S:
            self.stop()
        if self._observer is None:
            if temperatures:
                self._start(now_us, point, temperatures)
            return None
        if duration_s <= 0:
            return None
        speed_rpm, load_n, ambient_c = point.speed_rpm, point.load_n, point.ambient_c
        return Observation(
            duration_s, speed_rpm, load_n, ambient_c, point.inputs, temperatures
        ), point

    def _done(
        self, now_us: int, step: Observation, point: Point, innovations: Mapping[str, Innovation]
    ) -> None:
        """Record what the observer has used."""
        if step.measured:
            self.innovations = innovations
            self.followed_s += min(step.dt_s, _LONGEST_SEEN_S)
        self.time_us, self.point = now_us, point
        self._note_surroundings(step.dt_s, point, step.measured)

    def clock_set(self, by_us: int) -> None:
        """Go on without a gap: the clock was set by so much."""
        if self.time_us is not None:
            self.time_us += by_us

    def stop(self) -> None:
        """Give the estimate up; the next good temperatures start it again."""
        self._known_c = self._spread_k = None
        if self._observer is not None:
            self._revolutions = self._observer.revolutions
        self._observer = None

    @property
    def revolutions(self) -> float:
        """Revolutions since the grease was fresh."""
        return self._revolutions if self._observer is None else self._observer.revolutions

    def renew_grease(self) -> float:
        """Count the revolutions from zero again; returns how many there were."""
        before, self._revolutions = self.revolutions, 0.0
        if self._observer is not None:
            self._observer.renew_grease()
        return before

    def _operating_point(
        self, means: Mapping[str, float], temperatures: Mapping[str, float]
    ) -> Point | None:
        last = self.point
        speed_rpm = means.get(SPEED, last.speed_rpm if last else math.nan)
        load_n = means.get(LOAD, last.load_n if last else math.nan)
        ambient_c = means.get(AMBIENT, last.ambient_c if last else math.nan)
        if not self._ambient_measured and temperatures:
            # No ambient sensor: nothing on the machine is colder than the ambient.
            ambient_c = min([*temperatures.values(), *([last.ambient_c] if last else [])])
        names = self.active.model.input_names
        before = dict(zip(names, last.inputs, strict=True)) if last else {}
        inputs = tuple(means.get(name, before.get(name, math.nan)) for name in names)
        if math.isnan(speed_rpm + load_n + ambient_c + sum(inputs)):
            return None
        # Friction does not ask for the direction of rotation.
        return Point(abs(speed_rpm), max(load_n, 0.0), ambient_c, inputs)

    def _start(self, now_us: int, point: Point, temperatures: Mapping[str, float]) -> None:
        at_rest = self._ambient_measured and stands_at_ambient(
            point.speed_rpm, point.ambient_c, temperatures.values()
        )
        model, values = self.active.model, self.active.values
        # What the machine was trained at says more of its past than the present moment does.
        past = usual_levels(self.active.posterior.trained.points)
        self._observer = begin(model, values, temperatures, point, at_rest, past, self._revolutions)
        self.followed_s = FOLLOWED_S if at_rest else 0.0
        self.time_us, self.point = now_us, point

    def samples(self, asset: str, now_us: int, quality: int = Quality.GOOD) -> list[Sample]:
        """The estimate of every standard sensor as samples for the store, of a given quality."""
        names, time_us = self.active.model.sensor_names, self.time_us or now_us
        values = (self._sensor_rows @ self.temperatures_c).tolist()
        return [
            Sample(asset, f"{sensor}.twin", time_us, value, int(quality), now_us)
            for sensor, value in zip(names, values, strict=True)
        ]

    def to_dict(self) -> KeptEstimate | None:
        """The estimate as plain JSON types, or None before it has started."""
        if self._observer is None or self.point is None or self.time_us is None:
            return None
        return {
            "bearing": self.active.model.machine,
            "time_us": self.time_us,
            "observer": self._observer.to_dict(),
            "speed_rpm": self.point.speed_rpm,
            "load_n": self.point.load_n,
            "ambient_c": self.point.ambient_c,
            "inputs": list(self.point.inputs),
            "ambient_measured": self._ambient_measured,
            "followed_s": self.followed_s,
        }

    def restore(self, kept: KeptEstimate) -> None:
        """Take up an estimate that was kept by `to_dict`.

        Raises
        ------
        ValueError
            If it is not one of this kind of model, or of another bearing; the estimate then
            starts again.
        """
        bearing = self.active.model.machine
        if kept.get("bearing") != bearing:
            raise ValueError(f"kept estimate: of bearing {kept.get('bearing')}, not {bearing}")
        try:
            observer = Observer.from_dict(self.active.model, self.active.values, kept["observer"])
            inputs = tuple(float(value) for value in kept.get("inputs", ()))
            if len(inputs) != len(self.active.model.input_names):
                raise ValueError(f"kept estimate: {len(inputs)} inputs of another network")
            point = Point(kept["speed_rpm"], kept["load_n"], kept["ambient_c"], inputs)
            time_us, ambient_measured = int(kept["time_us"]), bool(kept["ambient_measured"])
            # Version 0.1.0 did not keep it: counted from now on.
            followed_s = float(kept.get("followed_s", 0.0))
            if not 0.0 <= followed_s < math.inf:
                raise ValueError(f"kept estimate: followed_s is {followed_s}, expected 0 or more")
        except (AttributeError, KeyError, TypeError) as error:
            raise ValueError(f"kept estimate: {error!r}") from error
        self._observer, self.point, self.time_us = observer, point, time_us
        self._known_c = self._spread_k = None
        self._ambient_measured, self.followed_s = ambient_measured, followed_s


def step_together(
    estimates: Sequence[LiveEstimate], now_us: int, means: Sequence[Mapping[str, float]]
) -> list[Exception | None]:
    """Advance many estimates, each as by its own `LiveEstimate.step`; a failure harms no other.

    Machines of one network form cost one call of the observer.

    Parameters
    ----------
    estimates : sequence of LiveEstimate
        The estimates, each of them once.
    now_us : int
        Process time to advance to.
    means : sequence of mapping of str to float
        (estimates,) mean readings of each since its last step.

    Returns
    -------
    list of Exception or None
        (estimates,) what `LiveEstimate.step` raises, None where all went well.
    """
    errors: list[Exception | None] = [None] * len(estimates)
    due: list[tuple[int, Observation, Point]] = []
    for k, (estimate, given) in enumerate(zip(estimates, means, strict=True)):
        try:
            found = estimate._due(now_us, given)
        except Exception as error:
            # Whatever it was that one stumbled over: the other machines run on.
            errors[k] = error
        else:
            if found is not None:
                due.append((k, *found))
    observers, steps = [estimates[k].observer for k, _, _ in due], [step for _, step, _ in due]
    results: Sequence[dict[str, Innovation] | Exception]
    try:
        results = advance(observers, steps)
    except Exception as error:
        # How far each has come is not known: all of them begin again.
        for k, _, _ in due:
            estimates[k].stop()
        results = [error] * len(due)
    for (k, step, point), result in zip(due, results, strict=True):
        if isinstance(result, Exception):
            errors[k] = result
        else:
            estimates[k]._done(now_us, step, point, result)
    return errors
