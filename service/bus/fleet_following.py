"""The live messages of all cells of a fleet as one stream of this process."""

import asyncio
from collections.abc import Collection
from functools import partial
from typing import Final

import msgspec

from adapters.protocol import Clock
from service.bus.fleet_cells import Fleet
from service.bus.followed import Followed
from service.bus.following import Following
from service.bus.nats_bus import CellLink
from service.bus.stream import LiveMessages
from service.bus.subscription import Message
from service.documents.messages import ServiceHealth
from service.domain.errors import CellUnavailableError

#: Wall seconds between two looks for other cells, and two words on the health of all.
_LOOK_EVERY_S: Final = 0.1
_HEALTH_EVERY_S: Final = 1.0
#: Live messages of a cell are kept by the bus of all.
_KEPT: Final = 1


class _Mirror(LiveMessages):
    """The live messages of one cell under its own numbers; reports gaps to the bus of all cells."""

    def __init__(self, clock: Clock, whole: "FleetFollowing") -> None:
        super().__init__(clock, "", history_messages=_KEPT, on_message=whole.take)
        self._whole = whole

    def end_subscriptions(self, reason: str) -> None:
        """Report to all subscribers that messages are missing."""
        self._whole.miss(reason)


class FleetFollowing:
    """Brings the live messages of all cells into one `LiveMessages`, with numbers of its own.

    Parameters
    ----------
    fleet : Fleet
        All cells.
    bus : LiveMessages
        Takes the messages.
    clock : Clock
        Process time.

    Attributes
    ----------
    caught_up : asyncio.Event
        Set when the cells of the beginning are followed.
    """

    def __init__(self, fleet: Fleet, bus: LiveMessages, clock: Clock) -> None:
        self.caught_up = asyncio.Event()
        self._fleet = fleet
        self._bus = bus
        self._clock = clock
        self._of_cell: dict[str, Following] = {}
        self._running: dict[str, asyncio.Task[None]] = {}
        self._health: dict[str, ServiceHealth] = {}
        self._noted = Followed()

    async def run(self) -> None:
        """Follow until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._report_health())
            assets = self._fleet.state.assets
            while True:
                cells = dict(self._fleet.cells)
                for token in self._running.keys() - cells.keys():
                    self._running.pop(token).cancel()
                    del self._of_cell[token]
                    self._health.pop(token, None)
                    self.miss("a cell is gone")
                for token, cell in cells.items():
                    if token not in self._running:
                        mirror = _Mirror(self._clock, self)
                        one = Following(cell, mirror, partial(self._wanted, cell), replays=False)
                        self._of_cell[token] = one
                        self._running[token] = tasks.create_task(one.run())
                alive = [cell.epoch for cell in self._fleet.alive()]
                if alive and all(self._of_cell[one].caught_up.is_set() for one in alive):
                    self.caught_up.set()
                if assets != self._fleet.state.assets:
                    assets = self._fleet.state.assets
                    self.miss("assets have come, gone, or have another cell")
                await asyncio.sleep(_LOOK_EVERY_S)

    async def follow(self, assets: Collection[str] | None) -> int:
        """Have the cells make the live messages of some assets, or of all.

        Returns
        -------
        int
            Number after which there are all of them.

        Raises
        ------
        CellUnavailableError
            If no cell answers.
        """
        cells = self._fleet.alive()
        if not cells:
            raise CellUnavailableError("no cell answers")
        answers = await asyncio.gather(
            *(
                self._of_cell[cell.epoch].follow(self._fleet.assets.of_cell(cell.epoch, assets))
                for cell in cells
                if cell.epoch in self._of_cell
            ),
            return_exceptions=True,
        )
        for answer in answers:
            if isinstance(answer, BaseException) and not isinstance(answer, CellUnavailableError):
                raise answer
        return self._noted.note(assets, self._bus.seq)

    def take(self, message: Message) -> None:
        """Hand on a message of a cell."""
        if message.type == "health":
            # Each cell reports its own sources; a subscriber gets those of all cells together.
            epoch, health = _read_health.decode(message.text).parts()
            self._health[epoch] = health
        elif message.type != "heartbeat":
            self._bus.renumber(message)

    def miss(self, reason: str) -> None:
        """Have those who follow begin again: messages are missing, whose numbers none know."""
        self._bus.skip_to(self._bus.seq + 1, self._bus.seq + 1)
        self._bus.end_subscriptions(reason)

    def _wanted(self, cell: CellLink) -> Collection[str] | None:
        return self._fleet.assets.of_cell(cell.epoch, self._bus.followed())

    async def _report_health(self) -> None:
        while True:
            await asyncio.sleep(_HEALTH_EVERY_S)
            alive = {cell.epoch for cell in self._fleet.alive()}
            known = [one for token, one in self._health.items() if token in alive]
            if known:
                whole = ServiceHealth(
                    sources=[source for one in known for source in one.sources],
                    degraded=any(one.degraded for one in known) or bool(self._fleet.missing()),
                    clock_rate=self._clock.rate,
                )
                self._bus.publish("health", None, whole)


class _HealthMessage(msgspec.Struct):
    """The parts of a cell's message on its sources that are put together."""

    epoch: str
    data: msgspec.Raw

    def parts(self) -> tuple[str, ServiceHealth]:
        """The cell, and what it says."""
        return self.epoch, ServiceHealth.model_validate_json(bytes(self.data))


_read_health = msgspec.json.Decoder(_HealthMessage)
