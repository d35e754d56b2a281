"""The state of a machine: what forecasts, maps and advice start from."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_core.profiles import Point

FloatArray = NDArray[np.float64]

FOLLOWED_S = 3600.0
"""A course that has been followed for this time counts as known."""


@dataclass(frozen=True, slots=True, eq=False)
class MachineState:
    """A machine at one moment, as its observer knows it.

    Raises `ValueError` if a shape is wrong, or a number not finite or out of range.
    """

    #: Mean (nodes,) in degC and covariance (nodes, nodes) in K2 of the node temperatures.
    temperatures_c: FloatArray
    covariance: FloatArray
    revolutions: float  # revolutions since the grease was fresh; negative numbers count as 0
    #: Ambient temperature and the network's inputs (k,) at this moment: what envelope and advice
    #: hold constant.
    ambient_c: float
    inputs: tuple[float, ...] = ()
    #: (nodes,) heat that the model lacks at present, the observer's ``heat_disturbance_w``; in a
    #: forecast it fades as in the observer. None for none.
    heat_disturbance_w: FloatArray | None = None
    #: What the machine ran at up to now; None for a machine that has not been followed. A member of
    #: an ensemble whose resistances are not those of the observer's model is out of balance in the
    #: state that this model has found. It starts with the heats that keep it on the observed
    #: course. They fade also, and end when the machine stops or starts, as what is wrong is mostly
    #: friction. Without an operating point every member is taken to be in the present state on its
    #: own, as a cold machine is.
    operating_point: Point | None = None
    #: How much of the present course has been observed, 0 to 1; see `course_known`. By this part
    #: members get the heats that keep them on it: from a few readings no one knows where a machine
    #: is going. Below 1 a forecast has a label that gives how well the state is known, where that
    #: is badly.
    course_known: float = 1.0

    def __post_init__(self) -> None:
        nodes = np.size(self.temperatures_c)
        for name, shape in (
            ("temperatures_c", (nodes,)),
            ("covariance", (nodes, nodes)),
            ("heat_disturbance_w", (nodes,)),
        ):
            value = getattr(self, name)
            if value is None and name == "heat_disturbance_w":
                continue
            array = np.asarray(value, np.float64)
            if array.shape != shape or not np.isfinite(array).all():
                raise ValueError(
                    f"machine state: {name} has shape {array.shape}, expected finite numbers of "
                    f"shape {shape}"
                )
            object.__setattr__(self, name, array)
        if not np.isfinite([self.revolutions, self.ambient_c, *self.inputs]).all():
            raise ValueError(
                f"machine state: revolutions is {self.revolutions}, ambient_c {self.ambient_c}, "
                f"inputs {list(self.inputs)}; expected finite numbers"
            )
        if not 0.0 <= self.course_known <= 1.0:
            raise ValueError(f"machine state: course_known is {self.course_known}, expected 0 to 1")
        object.__setattr__(self, "revolutions", max(float(self.revolutions), 0.0))

    def to_dict(self) -> dict[str, Any]:
        """Return the state as plain numbers and lists."""
        heat_w, point = self.heat_disturbance_w, self.operating_point
        return {
            "temperatures_c": self.temperatures_c.tolist(),
            "covariance": self.covariance.tolist(),
            "revolutions": self.revolutions,
            "ambient_c": self.ambient_c,
            "inputs": list(self.inputs),
            "heat_disturbance_w": None if heat_w is None else heat_w.tolist(),
            "operating_point": None if point is None else asdict(point),
            "course_known": self.course_known,
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> "MachineState":
        """Restore what `to_dict` gave.

        Raises `ValueError` if a value is missing, has the wrong shape or is out of range.
        """
        try:
            point = document["operating_point"]
            values = dict(document) | {
                "inputs": tuple(document["inputs"]),
                "operating_point": None
                if point is None
                else Point(**dict(point) | {"inputs": tuple(point["inputs"])}),
            }
            return cls(**values)
        except (KeyError, TypeError) as error:
            raise ValueError(f"machine state: {error!r}") from error


def course_known(followed_s: float) -> float:
    """How much of a machine's course is known, 0 to 1, once it has been followed for a time in s.

    A machine is on its own course, as little as its model knows of it, once the observer has seen
    the slower parts answer.
    """
    return min(max(followed_s, 0.0) / FOLLOWED_S, 1.0)
