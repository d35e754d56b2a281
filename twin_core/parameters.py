"""Named parameters with units, bounds and priors, and their standard normal coordinates.

Identification works in ``z``: every parameter has the prior ``z ~ N(0, 1)``, so a priori all of
them weigh the same whatever their unit. A ``"log"`` parameter is ``centre * exp(spread * z)``
(log-normal: *centre* is the median), a ``"linear"`` one ``centre + spread * z``.
"""

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Transform = Literal["log", "linear"]

Z_LIMIT = 4.0
"""Coordinates are clipped to ``|z| <= Z_LIMIT``: beyond it nothing is physical any more."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One unknown of a model."""

    #: *name* is unique within a model
    name: str
    unit: str
    description: str
    #: ``"log"`` for positive quantities that may span decades, ``"linear"`` otherwise.
    transform: Transform
    centre: float  # prior median, in *unit*
    spread: float  # prior standard deviation: of the natural logarithm (``"log"``) or in *unit*
    #: Physical bounds in *unit*; by default only the clip at ``|z| = 4`` holds.
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        if self.transform not in ("log", "linear"):
            raise ValueError(
                f"parameter {self.name!r}: transform is {self.transform!r}, "
                "expected 'log' or 'linear'"
            )
        if not self.spread > 0.0:
            raise ValueError(f"parameter {self.name!r}: spread is {self.spread}, expected > 0")
        if self.transform == "log" and not self.centre > 0.0:
            raise ValueError(
                f"parameter {self.name!r}: centre is {self.centre}, "
                "expected > 0 for a logarithmic parameter"
            )
        if not self.lower <= self.centre <= self.upper:
            raise ValueError(
                f"parameter {self.name!r}: centre {self.centre} lies outside its bounds "
                f"[{self.lower}, {self.upper}]"
            )


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """The parameters of a model, in the order of its parameter vectors."""

    parameters: tuple[Parameter, ...]
    _centre: NDArray[np.float64] = field(init=False, repr=False, compare=False)
    _spread: NDArray[np.float64] = field(init=False, repr=False, compare=False)
    _is_log: NDArray[np.bool_] = field(init=False, repr=False, compare=False)
    _lower: NDArray[np.float64] = field(init=False, repr=False, compare=False)
    _upper: NDArray[np.float64] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        names = [parameter.name for parameter in self.parameters]
        twice = next((name for name, times in Counter(names).items() if times > 1), None)
        if twice is not None:
            raise ValueError(f"parameter {twice!r} is defined more than once")
        is_log = np.array([p.transform == "log" for p in self.parameters], dtype=np.bool_)
        centre = np.array([p.centre for p in self.parameters], dtype=np.float64)
        spread = np.array([p.spread for p in self.parameters], dtype=np.float64)
        half_range = Z_LIMIT * spread
        # The clip at |z| = 4 becomes part of the bounds, so that `lower` and `upper` are always
        # finite and a searcher in physical units needs nothing else.
        # A spread in the parameter's unit is none of a logarithm: kept away from the exponential.
        ratio = np.exp(np.where(is_log, half_range, 0.0))
        low = np.where(is_log, centre / ratio, centre - half_range)
        high = np.where(is_log, centre * ratio, centre + half_range)
        lower = np.maximum(low, np.array([p.lower for p in self.parameters], dtype=np.float64))
        upper = np.minimum(high, np.array([p.upper for p in self.parameters], dtype=np.float64))
        for name, value in (
            ("_centre", centre),
            ("_spread", spread),
            ("_is_log", is_log),
            ("_lower", lower),
            ("_upper", upper),
        ):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names in order."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def size(self) -> int:
        """Number of parameters, p."""
        return len(self.parameters)

    @property
    def centre(self) -> NDArray[np.float64]:
        """Prior medians in physical units, shape (p,)."""
        return self._centre

    @property
    def lower(self) -> NDArray[np.float64]:
        """Lower bounds in physical units, shape (p,); includes the clip ``z >= -4``."""
        return self._lower

    @property
    def upper(self) -> NDArray[np.float64]:
        """Upper bounds in physical units, shape (p,); includes the clip ``z <= 4``."""
        return self._upper

    @property
    def z_lower(self) -> NDArray[np.float64]:
        """Lower bounds in standard coordinates, shape (p,)."""
        return self._to_z(self._lower)

    @property
    def z_upper(self) -> NDArray[np.float64]:
        """Upper bounds in standard coordinates, shape (p,)."""
        return self._to_z(self._upper)

    def index(self, name: str) -> int:
        """Position of a parameter; raises `KeyError` if there is no such parameter."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(
                f"unknown parameter {name!r}, expected one of {', '.join(self.names)}"
            ) from None

    def values_from_z(self, z: ArrayLike) -> NDArray[np.float64]:
        """Physical values of coordinates (..., p), clipped to ``|z| <= 4`` and to the bounds.

        Raises `ValueError` if the last axis does not hold p coordinates.
        """
        clipped = np.clip(self._checked(z, "z"), -Z_LIMIT, Z_LIMIT)
        scaled = self._spread * clipped
        values = np.where(
            self._is_log,
            self._centre * np.exp(np.where(self._is_log, scaled, 0.0)),
            self._centre + scaled,
        )
        bounded: NDArray[np.float64] = np.clip(values, self._lower, self._upper)
        return bounded

    def z_from_values(self, values: ArrayLike) -> NDArray[np.float64]:
        """Coordinates of physical values (..., p), clipped to the bounds and ``|z| <= 4``.

        Raises `ValueError` if the last axis does not hold p values.
        """
        return self._to_z(np.clip(self._checked(values, "values"), self._lower, self._upper))

    def slopes_by_z(self, z: ArrayLike) -> NDArray[np.float64]:
        """Derivatives of `values_from_z` inside the bounds, (..., p) as *z*, in physical units.

        Raises `ValueError` if the last axis does not hold p coordinates.
        """
        return self._spread * np.where(self._is_log, self.values_from_z(z), 1.0)

    def _to_z(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        ratio = np.where(self._is_log, values / np.where(self._is_log, self._centre, 1.0), 1.0)
        z: NDArray[np.float64] = np.where(
            self._is_log, np.log(ratio) / self._spread, (values - self._centre) / self._spread
        )
        return z

    def _checked(self, array: ArrayLike, what: str) -> NDArray[np.float64]:
        result = np.asarray(array, dtype=np.float64)
        if result.ndim == 0 or result.shape[-1] != self.size:
            raise ValueError(
                f"{what} has shape {result.shape}, expected (..., {self.size}): one value per "
                "parameter"
            )
        return result
