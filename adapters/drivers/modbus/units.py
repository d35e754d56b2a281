"""The units behind a Modbus source, and how each of them stands."""

import asyncio
from dataclasses import dataclass, field
from enum import Enum

from adapters.backoff import Backoff
from adapters.drivers.modbus.groups import MISFIT
from adapters.drivers.modbus.mapping import PolledChannel, UnitMap


class Probe(Enum):
    """What trying a silent unit over a second connection gave."""

    ANSWERS = "answers"
    STILL_SILENT = "still no answer"
    NO_SECOND_CONNECTION = "no second connection"  # the unit must be tried over the first one


@dataclass(slots=True)
class Unit:
    """A unit with its standing: alive, or silent and tried again now and then."""

    number: int
    backoff: Backoff
    maps: list[UnitMap] = field(default_factory=list)  # one for each poll interval
    silent: str = ""  # why, or empty
    retry_at: float = 0.0  # wall, monotonic
    tried_at: float = 0.0  # wall, monotonic
    lost: bool = False  # the bad samples that mark the gap have been handed over
    losses: int = 0  # gaps so far, and silences: a round that spans one is not finished
    probe: asyncio.Task[Probe] | None = None

    @property
    def points(self) -> list[PolledChannel]:
        """Its channels, of all poll intervals."""
        return [point for one in self.maps for point in one.points]

    @property
    def answers(self) -> bool:
        """Whether the unit answers, and something that fits what it is asked for."""
        points = self.points
        fits = not points or any(point.refusal != MISFIT for point in points)
        return fits and not self.silent

    @property
    def witness(self) -> UnitMap | None:
        """A map of which a first group can be read to see if the unit answers."""
        return next((one for one in self.maps if one.groups), None)
