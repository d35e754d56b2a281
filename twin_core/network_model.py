"""What can be simulated: any thermal network together with its parameters."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.network import CompiledNetwork, Network
from twin_core.parameters import ParameterSet


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """How far a sensor is from what a model says even with the right parameters.

    The defaults are those of a bearing on its bench. A coarse network of a machine in the field,
    with inputs that no one measures, is wrong by kelvins for hours.

    Raises `ValueError` if one of them is not a positive number.
    """

    white_k: float = 0.15  # standard deviation of white noise
    #: Standard deviation and correlation time of what the network cannot express.
    slow_k: float = 0.30
    slow_s: float = 1800.0
    offset_k: float = 0.10  # standard deviation of a constant offset

    def __post_init__(self) -> None:
        for name in ("white_k", "slow_k", "slow_s", "offset_k"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}, expected a number > 0")

    @property
    def total_k(self) -> float:
        """Standard deviation of a single reading."""
        return float(np.sqrt(self.white_k**2 + self.slow_k**2 + self.offset_k**2))

    @property
    def scale(self) -> float:
        """How much larger than on a bench errors are to be expected."""
        return self.total_k / ErrorModel().total_k


@dataclass(frozen=True, slots=True)
class RunawayLimits:
    """From where on a thermal runaway counts as not excluded.

    The defaults are those of a grease-lubricated bearing. It runs away for reasons that no network
    here contains (preload by the growing inner ring, starved grease), so limits stand in for them.

    Raises `ValueError` if one of them is not a finite number, the factor is below 1 or ``lost_c``
    below ``hot_c``.
    """

    hot_c: float = 100.0  # upper edge (97.5 %) of a forecast in degC
    load_factor: float = 1.5  # load ahead over the largest trained one
    #: A member in which any sensor passes this temperature in degC has run away: no grease survives
    #: it.
    lost_c: float = 130.0
    #: Radial clearance in micrometres that a kelvin between inner and outer ring takes up; given,
    #: where the probability of a runaway that follows from it was tested on benches that ran away,
    #: up to ``load_factor``. Zero elsewhere: the members' share stands for it.
    clearance_um_k: float = 0.0

    def __post_init__(self) -> None:
        for name in ("hot_c", "load_factor", "lost_c", "clearance_um_k"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"{name} is {getattr(self, name)}, expected a finite number")
        if self.load_factor < 1.0:
            raise ValueError(f"load_factor is {self.load_factor}, expected at least 1")
        if self.lost_c < self.hot_c:
            raise ValueError(f"lost_c is {self.lost_c}, expected at least hot_c = {self.hot_c}")

    @property
    def tested(self) -> bool:
        """Whether the probability of a runaway was tested."""
        return self.clearance_um_k > 0.0


@dataclass(frozen=True, slots=True, eq=False)
class NetworkModel:
    """A network and its parameters, compiled, ready to simulate."""

    name: str
    network: Network
    parameters: ParameterSet  # what is identified, with priors
    compiled: CompiledNetwork
    #: What is left between a sensor and the model.
    errors: ErrorModel = field(default=ErrorModel(), kw_only=True)
    #: A usual operating point, speed in rpm and load in N.
    reference_point: tuple[float, float] = field(default=(4000.0, 2650.0), kw_only=True)
    #: The network's inputs there; a boundary's are not used, it counts as at ambient.
    reference_inputs: tuple[float, ...] = field(default=(), kw_only=True)
    #: From where on a runaway counts as not excluded; None for a machine without a bearing's
    #: friction, of which only a simulation that fails has run away.
    runaway: RunawayLimits | None = field(default=RunawayLimits(), kw_only=True)

    @property
    def lost_c(self) -> float:
        """Temperature in degC above which a sensor has run away; infinite without limits."""
        return np.inf if self.runaway is None else self.runaway.lost_c

    @property
    def node_names(self) -> tuple[str, ...]:
        """Names of the state nodes in order."""
        return self.network.node_names

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the standard sensors."""
        return tuple(sensor.name for sensor in self.network.sensors)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs besides speed, load and ambient, in the order of their values."""
        return self.network.inputs

    def holding(self, inputs: ArrayLike) -> Self:
        """Return the model with its inputs held at values, shape (k,), wherever no profile is.

        Raises `ValueError` if there are more or fewer values than inputs, or one is not finite.
        """
        values = np.ascontiguousarray(inputs, np.float64).reshape(-1)
        if values.size != len(self.input_names) or not np.isfinite(values).all():
            raise ValueError(
                f"inputs are {values.tolist()}, expected one number for each of "
                f"{', '.join(self.input_names) or 'none'}"
            )
        return (
            replace(self, compiled=self.compiled._replace(inputs=values)) if values.size else self
        )

    def at_reference(self, ambient_c: float) -> Self:
        """Return the model at its reference inputs, all boundaries as warm as the ambient."""
        boundaries = self.network.boundaries
        return self.holding(
            [
                ambient_c if name in boundaries else value
                for name, value in zip(self.input_names, self.reference_inputs, strict=True)
            ]
        )

    def sensor_row(self, name: str) -> NDArray[np.float64]:
        """Weights (nodes,) of the nodes in the reading of a sensor or of a node's own sensor.

        Raises `ValueError` if there is no such sensor or node.
        """
        row = np.zeros(len(self.node_names))
        if name in self.node_names:
            row[self.node_names.index(name)] = 1.0
            return row
        for sensor in self.network.sensors:
            if sensor.name == name:
                for node, weight in sensor.weights:
                    row[self.node_names.index(node)] += weight
                return row
        raise ValueError(
            f"unknown sensor {name!r}, expected one of "
            f"{', '.join((*self.sensor_names, *self.node_names))}"
        )

    def sensor_matrix(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Rows of several sensors, shape (len(names), nodes)."""
        return np.array([self.sensor_row(name) for name in names]).reshape(
            len(names), len(self.node_names)
        )
