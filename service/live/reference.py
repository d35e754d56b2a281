"""The model alone: driven by speed, load and ambient, never corrected by the sensors.

The observer learns what its model lacks and stays on the measurements; next to it this one shows
how far the machine has moved away from its model.
"""

from collections.abc import Iterable, Sequence

import numpy as np
import structlog
from numpy.typing import NDArray

from service.live.estimate import RunningModel
from service.live.kept import KeptReference
from twin_core.models import ThermalModel
from twin_core.observer import Observer
from twin_core.profiles import Point
from twin_core.simulation import advance

_log = structlog.get_logger(__name__)


class Reference:
    """Temperatures of the nodes as the model alone has them; None before the first start."""

    def __init__(self) -> None:
        self._temperatures_c: NDArray[np.float64] | None = None
        self._revolutions = 0.0
        self._held: tuple[float, Point] | None = None
        # What a step needs of a model does not change; it is asked for once.
        self._active: RunningModel | None = None
        self._values: NDArray[np.float64] = np.empty(0)
        self._model: ThermalModel | None = None
        self._rows: dict[str, NDArray[np.float64]] = {}

    @property
    def started(self) -> bool:
        """Whether there is anything to compare with."""
        return self._temperatures_c is not None

    def start(self, observer: Observer) -> None:
        """Go on from the observer's present temperatures."""
        self._temperatures_c = observer.temperatures_c
        self._revolutions = observer.revolutions

    def stop(self) -> None:
        """Give it up."""
        self._temperatures_c = None

    def hold(self, active: RunningModel, duration_s: float, point: Point) -> bool:
        """Be held at an operating point by the next `advance_together`; says whether it needs to.

        A model that runs away then ends.
        """
        if self._temperatures_c is None or duration_s <= 0.0:
            return False
        if active is not self._active:
            self._active, self._values = active, active.values
        self._held = duration_s, point
        return True

    def expected_c(self, model: ThermalModel, channel: str) -> float | None:
        """What the model alone expects a sensor to read; None before the start."""
        if self._temperatures_c is None:
            return None
        if model is not self._model:
            self._model, self._rows = model, {}
        row = self._rows.get(channel)
        if row is None:
            row = self._rows[channel] = model.sensor_row(channel)
        return float(row @ self._temperatures_c)

    def to_dict(self) -> KeptReference | None:
        """The state as plain JSON types; None before the start."""
        if self._temperatures_c is None:
            return None
        return {
            "temperatures_c": self._temperatures_c.tolist(),
            "revolutions": self._revolutions,
        }

    def restore(self, model: ThermalModel, kept: KeptReference) -> None:
        """Take up what `to_dict` gave; a state of another kind of model is left aside."""
        try:
            temperatures = np.asarray(kept["temperatures_c"], dtype=np.float64)
            revolutions = float(kept["revolutions"])
        except (KeyError, TypeError, ValueError):
            return
        if temperatures.shape == (len(model.node_names),) and np.isfinite(temperatures).all():
            self._temperatures_c, self._revolutions = temperatures, revolutions


def advance_together(references: Iterable[Reference | None]) -> None:
    """Advance models that are held at an operating point; those of one kind cost one call."""
    of_model: dict[int, list[Reference]] = {}
    for one in references:
        if one is not None and one._active is not None and one._held is not None:
            of_model.setdefault(id(one._active.model), []).append(one)
    for alike in of_model.values():
        try:
            _advance(alike)
        except ValueError:
            # Whose it is that does not fit is not known; the machines run on without.
            _log.exception("models_alone_not_advanced", count=len(alike))
            for one in alike:
                one.stop()


def _advance(alike: Sequence[Reference]) -> None:
    held = [one._held for one in alike if one._held is not None]
    active = alike[0]._active
    if active is None:
        return
    temperatures_c, revolutions = advance(
        active.model,
        np.array([one._values for one in alike]),
        [point for _, point in held],
        [duration_s for duration_s, _ in held],
        np.array([one._temperatures_c for one in alike]),
        np.array([one._revolutions for one in alike]),
    )
    finite = np.isfinite(temperatures_c[:, 0]).tolist()
    for one, ends_c, turned, is_finite in zip(
        alike, temperatures_c, revolutions.tolist(), finite, strict=True
    ):
        one._held = None
        if is_finite:
            one._temperatures_c, one._revolutions = ends_c.copy(), turned
        else:
            one.stop()
