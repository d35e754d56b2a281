"""The paper's inverse problem: find the parameters that made noise-free temperatures.

Any optimiser may search; what it evaluates is counted here, simulation by simulation, finite
differences and rejected trials included, so that methods can be compared fairly.
"""

import time
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.costs import SUM_OF_SQUARES
from twin_core.identification.searching import SearchEnd
from twin_core.network_model import NetworkModel
from twin_core.networks.simple_5 import (
    AMBIENT_C,
    SPEED_UNIT_RPM,
    simple_5_model,
    simple_5_profile,
    target_values,
)
from twin_core.simulation import OperatingProfile, simulate_batch

FloatArray = NDArray[np.float64]

TOLERANCE = 0.01
"""A parameter counts as found when it is within 1 % of its target."""


class PowerLaw(NamedTuple):
    """A power law of the speed: where its factor and exponent are, and a speed amid the data."""

    factor: int
    exponent: int
    reference: float


@dataclass(frozen=True, slots=True, eq=False)
class InverseProblem:
    """Noise-free temperatures of two sensors, and the box in which their causes lie.

    Every parameter is searched on a logarithmic scale between its bounds, except that of a power
    law ``R = k n^e`` not the factor ``k`` is searched but ``R`` at a speed amid the data, within as
    many decades and as far off its target as the bounds of ``k`` are. Speeds far from 1 would
    otherwise tie factor and exponent together: a change of the one is hidden by a change of the
    other (correlation -0.90 here), and methods that move single coordinates crawl along that
    valley. The parameters that are reported and judged are those of the network as ever.

    - ``model``: the network.
    - ``profile``: n operating points.
    - ``initial_c``: (nodes,) temperatures at the first row.
    - ``sensors``: names of the sensors that are compared.
    - ``targets``: (p,) the values to be found.
    - ``measured_c``: (n - 1, sensors) temperatures after the first row at the targets.
    - ``power_law``: the coupled factor and exponent.
    """

    model: NetworkModel
    profile: OperatingProfile
    initial_c: FloatArray
    sensors: tuple[str, ...]
    targets: FloatArray
    measured_c: FloatArray
    power_law: PowerLaw

    @property
    def dimensions(self) -> int:
        """Number of parameters, p."""
        return self.model.parameters.size

    def values(self, unit: FloatArray) -> FloatArray:
        """Parameters (..., p) of points (..., p) in the unit box."""
        lower, upper = self.model.parameters.lower, self.model.parameters.upper
        values = np.asarray(lower * (upper / lower) ** unit)
        values[..., self.power_law.factor] *= self._factor_over_reference(values)
        return values

    def unit(self, values: FloatArray) -> FloatArray:
        """Points (..., p) of the unit box where parameters (..., p) lie."""
        lower, upper = self.model.parameters.lower, self.model.parameters.upper
        searched = np.array(values, dtype=np.float64)
        searched[..., self.power_law.factor] /= self._factor_over_reference(searched)
        return np.asarray(np.log(searched / lower) / np.log(upper / lower))

    def _factor_over_reference(self, values: FloatArray) -> FloatArray:
        """What makes the factor of the value at the reference speed, by the exponent."""
        exponent = self.power_law.exponent
        return np.asarray(
            self.power_law.reference ** (self.targets[exponent] - values[..., exponent])
        )

    def residuals(self, unit: FloatArray) -> FloatArray:
        """Temperature errors in K of points (B, p) in the unit box, (B, (n - 1) sensors)."""
        return self.residuals_of(self.values(unit))

    def residuals_of(self, values: FloatArray) -> FloatArray:
        """Temperature errors in K of parameters (B, p) or (p,), (B, (n - 1) sensors)."""
        batch = np.atleast_2d(values)
        nodes = simulate_batch(self.model, batch, self.profile, self.initial_c)
        read = nodes[:, 1:] @ self.model.sensor_matrix(self.sensors).T
        return np.asarray((read - self.measured_c).reshape(len(batch), -1))


@cache
def simple_network_problem() -> InverseProblem:
    """The simple network of section 5.1 from cold, 450 rows of nodes 1 and 2."""
    model, profile, targets = simple_5_model(), simple_5_profile(), target_values()
    initial_c = np.full(len(model.node_names), AMBIENT_C)
    truth = simulate_batch(model, targets[None], profile, initial_c)[0, 1:]
    measured_c = truth @ model.sensor_matrix(model.sensor_names).T
    names = model.parameters.names
    # k6 is the resistance at 10 rpm; the mean speed is 3000 rpm.
    law = PowerLaw(
        names.index("k6"),
        names.index("k7"),
        float(np.mean(profile.speed_rpm[:-1])) / SPEED_UNIT_RPM,
    )
    return InverseProblem(model, profile, initial_c, model.sensor_names, targets, measured_c, law)


class Best(NamedTuple):
    """A best point so far: when it was found, and the parameters there."""

    evaluations: int
    seconds: float
    values: FloatArray


class CountedSearch:
    """What a method may ask of an inverse problem, within a budget of simulations.

    - ``problem``: what is searched, in the unit box.
    - ``budget``: number of simulations, each counted, whatever it was for.
    - ``stop_at_target``: whether the search ends as soon as all parameters of the best point are
      within 1 %.

    - ``evaluations``: simulations so far; when the target is met, up to the one that met it.
    - ``trace``: every new best point.
    - ``reached``: simulations until all parameters of the best point were within 1 %, or None.
    """

    def __init__(self, problem: InverseProblem, budget: int, stop_at_target: bool = True) -> None:
        self.problem = problem
        self.budget = budget
        self.evaluations = 0
        self.trace: list[Best] = []
        self.reached: int | None = None
        self._stop_at_target = stop_at_target
        self._best = np.inf
        self._began = time.perf_counter()

    @property
    def dimensions(self) -> int:
        """Number of coordinates of the unit box."""
        return self.problem.dimensions

    @property
    def seconds(self) -> float:
        """Wall time since the search was begun."""
        return time.perf_counter() - self._began

    def costs(self, unit: FloatArray) -> FloatArray:
        """Sums of squared temperature errors in K2 of points (B, p), (B,).

        Raises `SearchEnd` when the target is met or the budget is used up.
        """
        return SUM_OF_SQUARES.of(self.residuals(unit))

    def residuals(self, unit: FloatArray) -> FloatArray:
        """Temperature errors in K of points (B, p), (B, m); raises as `costs` does."""
        left = self.budget - self.evaluations
        if left <= 0:
            raise SearchEnd
        points = unit[:left]
        residuals = self.problem.residuals(points)
        costs = SUM_OF_SQUARES.of(residuals)
        for point, cost in zip(points, costs, strict=True):
            self.evaluations += 1
            if cost < self._best:
                self._best = float(cost)
                self._note(self.problem.values(point))
        if len(points) < len(unit):
            raise SearchEnd
        return residuals

    def _note(self, values: FloatArray) -> None:
        self.trace.append(Best(self.evaluations, self.seconds, values))
        errors = np.abs(values / self.problem.targets - 1.0)
        if self.reached is None and np.all(errors <= TOLERANCE):
            self.reached = self.evaluations
            if self._stop_at_target:
                raise SearchEnd

    def within(self, parameter: int) -> tuple[int | None, int | None]:
        """When one parameter of the best point came within 1 % of its target.

        Returns
        -------
        first : int or None
            Simulations until it was so for the first time, which may be by chance.
        for_good : int or None
            Simulations from which on it stayed so to the end of the search.
        """
        target = self.problem.targets[parameter]
        first = for_good = None
        for best in self.trace:
            if abs(best.values[parameter] / target - 1.0) > TOLERANCE:
                for_good = None
                continue
            first = best.evaluations if first is None else first
            for_good = best.evaluations if for_good is None else for_good
        return first, for_good
