"""The model alone: driven by speed, load and ambient, never corrected by the sensors.

The observer learns what its model lacks and stays on the measurements; next to it this one shows
how far the machine has moved away from its model.
"""

import numpy as np
from numpy.typing import NDArray

from service.live.estimate import ActiveModel
from service.live.kept import KeptReference
from twin_core.models import ThermalModel
from twin_core.observer import Observer
from twin_core.profiles import OperatingPoint
from twin_core.simulation import SimulationError, advance


class Reference:
    """Temperatures of the nodes as the model alone has them; None before the first start."""

    def __init__(self) -> None:
        self._temperatures_c: NDArray[np.float64] | None = None
        self._revolutions = 0.0
        # What a step needs of a model does not change; it is asked for once.
        self._active: ActiveModel | None = None
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

    def step(self, active: ActiveModel, duration_s: float, point: OperatingPoint) -> None:
        """Advance at a constant operating point; a model that runs away ends it."""
        if self._temperatures_c is None or duration_s <= 0.0:
            return
        if active is not self._active:
            self._active, self._values = active, active.values
        try:
            self._temperatures_c, self._revolutions = advance(
                active.model,
                self._values,
                point,
                duration_s,
                self._temperatures_c,
                self._revolutions,
            )
        except SimulationError:
            self.stop()

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
