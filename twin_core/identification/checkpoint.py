"""Where an identification is, as plain JSON types, so that one cut short goes on from there.

Resumed on the same data with the same order, it ends in the same result as if nothing had
happened, bit for bit: parameters, samples, history and number of evaluations. On other data a
checkpoint is worthless, which its ``order`` shows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_core import TwinCoreError

FloatArray = NDArray[np.float64]


class CheckpointMismatchError(TwinCoreError, ValueError):
    """The checkpoint belongs to another identification."""


@dataclass(slots=True, eq=False)
class Checkpoint:
    """How far an identification has come."""

    #: What is identified from what and how; two orders that are equal give the same result. Data
    #: and model are in it through costs at the prior's centre and next to it.
    order: Mapping[str, Any]
    #: Of the whole identification so far.
    evaluations: int = 0
    history: list[tuple[int, float]] = field(default_factory=list)
    best_fitness: float = float("inf")
    fraction: float = 0.0
    #: State of the nutcracker search that was under way when this was saved.
    search: dict[str, Any] | None = None
    found_z: FloatArray | None = None  # (p,) where the global search ended
    #: Cost and unknowns (d,) of every start refined so far; None for a start whose simulation
    #: fails.
    refined: dict[str, tuple[float, FloatArray] | None] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types; infinite costs become None.

        ``search`` is None: the state of a search under way is its own and comes in its place.
        """
        return {
            "order": dict(self.order),
            "evaluations": self.evaluations,
            "history": [[count, _finite_or_none(cost)] for count, cost in self.history],
            "best_fitness": _finite_or_none(self.best_fitness),
            "fraction": self.fraction,
            "search": None,
            "found_z": None if self.found_z is None else self.found_z.tolist(),
            "refined": {
                name: None if one is None else [one[0], one[1].tolist()]
                for name, one in self.refined.items()
            },
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, Any], order: Mapping[str, Any]) -> "Checkpoint":
        """Take back what `to_dict` gave.

        Raises `CheckpointMismatchError` if it was made for another order, or is no checkpoint;
        names what differs.
        """
        theirs = document.get("order")
        if not isinstance(theirs, Mapping):
            raise CheckpointMismatchError("not the checkpoint of an identification")
        for name in order:
            if theirs.get(name) != order[name]:
                raise CheckpointMismatchError(
                    f"the checkpoint was made with another {name.replace('_', ' ')}: "
                    f"{_short(theirs.get(name))}, expected {_short(order[name])}"
                )
        found = document["found_z"]
        return cls(
            order,
            int(document["evaluations"]),
            [(int(count), _infinite_if_none(cost)) for count, cost in document["history"]],
            _infinite_if_none(document["best_fitness"]),
            float(document["fraction"]),
            document["search"],
            None if found is None else np.array(found, dtype=np.float64),
            {name: _refined(one) for name, one in document["refined"].items()},
        )


def _refined(one: Sequence[Any] | None) -> tuple[float, FloatArray] | None:
    return None if one is None else (float(one[0]), np.array(one[1], dtype=np.float64))


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _infinite_if_none(value: float | None) -> float:
    return float("inf") if value is None else float(value)
