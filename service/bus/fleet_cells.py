"""All cells of a fleet as one, for a web or plant side: each question goes to who can answer it."""

import asyncio
import contextlib
import math
import os
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final, cast

import msgspec
import structlog

from service.alarms import UnknownAlarmError
from service.bus import commands
from service.bus.alarm_lists import parts_of
from service.bus.assets_of_cells import AssetsOfCells
from service.bus.calls import call, command_type
from service.bus.interface import AWAY_AFTER_S
from service.bus.messages import AnswerT, CellState, Change, Command
from service.bus.nats_bus import (
    STATES,
    CellLink,
    NatsConnection,
    changes_of,
    inbox,
    unpacked,
)
from service.bus.of_record import OwnersOfRecord
from service.domain.errors import CellUnavailableError, PushRefusedError
from service.store import Alarm, StoreUnavailableError

if TYPE_CHECKING:
    from nats.aio.msg import Msg

#: Wall seconds for the names of a cell's assets.
_NAMES_S: Final = 5.0
_LOOK_EVERY_S: Final = 0.1
#: A cell that was silent for so long is forgotten: another one has its assets.
_FORGET_AFTER_S: Final = 10.0

_log = structlog.get_logger(__name__)


class Fleet:
    """All cells of a fleet; see `service.bus.interface.ReaderBus`.

    Parameters
    ----------
    connection : NatsConnection
        Of this process; not running yet.
    partitions : int
        How many there are.
    known : callable
        Gives the ids of all assets of the fleet, in any cell.
    open_alarms : callable
        Reads the alarms that are not over from the store.
    owners_of_record : callable
        Reads epoch and owner of each partition from the database: a cell that claims anything
        else is not believed.

    Attributes
    ----------
    epoch : str
        Names this process: its live messages have numbers of its own.
    cells : dict of str to CellLink
        Those that were heard in the last seconds.
    partitions : int
        How many there are.
    assets : AssetsOfCells
        Which cell follows which asset.
    """

    def __init__(
        self,
        connection: NatsConnection,
        partitions: int,
        known: Callable[[], Collection[str]],
        open_alarms: Callable[[], Awaitable[Sequence[Alarm]]],
        owners_of_record: Callable[[], Awaitable[Mapping[int, tuple[int, str]]]],
    ) -> None:
        caller = os.urandom(8)
        self.epoch = caller.hex()
        self.cells: dict[str, CellLink] = {}
        self._connection = connection
        self._caller = caller
        self.partitions = partitions
        self.assets = AssetsOfCells(known)
        self._open_alarms = open_alarms
        self._of_record = OwnersOfRecord(owners_of_record)
        self._whole_s = -math.inf
        self._change = msgspec.msgpack.Decoder(Change)
        self._state = msgspec.msgpack.Decoder(CellState)
        # What must be asked of several cells, and more than one answer made of theirs.
        self._of_fleet: dict[type[Command[Any]], Callable[[Any, float], Awaitable[Any]]] = {
            command_type(commands.Assets.names): self._asset_names,
            command_type(commands.Assets.documents): self._documents,
            command_type(commands.Assets.apply): self._apply,
            command_type(commands.Pushes.take): self._take_pushes,
            command_type(commands.Alarms.listed): self._listed_alarms,
            command_type(commands.Alarms.act): self._act,
            command_type(commands.Alarms.acknowledge): self._acknowledge,
        }
        connection.listen(f"{STATES}.*", self._take_state)
        connection.listen(f"{inbox(caller)}.*", self._take_answer)

    # ------------------------------------------------------------------ who is there
    @property
    def away_s(self) -> float:
        """Wall seconds since every partition had an owner that lives."""
        if not self.missing():
            self._whole_s = time.monotonic()
            return 0.0
        return time.monotonic() - self._whole_s

    @property
    def state(self) -> CellState:
        """What all cells report together."""
        alive = self.alive()
        return CellState(
            waits_for="" if alive else "a cell",
            ready=bool(alive) and all(map(self._is_learned, alive)),
            assets=self.assets.revision,
        )

    def alive(self) -> list[CellLink]:
        """Cells that take commands."""
        return [cell for cell in self.cells.values() if cell.alive]

    def owners(self) -> dict[int, str]:
        """Cell by partition, where the database says so too."""
        return {
            partition: cell.epoch
            for cell in self.alive()
            for partition, epoch in cell.state.partitions.items()
            if self._of_record.has(cell.epoch, partition, epoch)
        }

    def missing(self) -> list[int]:
        """Partitions that no living cell owns."""
        owners = self.owners()
        return [one for one in range(self.partitions) if one not in owners]

    def is_known(self, asset: str) -> bool:
        """Whether an asset belongs to the fleet, in any cell."""
        return asset in self.assets.known()

    def _owner(self, asset: str) -> CellLink | None:
        """The cell that follows an asset."""
        for token in self.assets.claims(asset):
            cell = self.cells.get(token)
            if cell is not None and cell.alive:
                return cell
        return None

    def _is_replaced(self, cell: CellLink) -> bool:
        """Whether another cell has taken over what this one still takes for its own."""
        owners = self.owners()
        return any(
            owners.get(partition, cell.epoch) != cell.epoch for partition in cell.state.partitions
        )

    def _is_learned(self, cell: CellLink) -> bool:
        return self.assets.state_of(cell.epoch) is not None

    async def run(self) -> None:
        """Keep the connection and the knowledge of the cells until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._connection.run())
            tasks.create_task(self._of_record.run(self._count_assets))
            while True:
                await asyncio.sleep(_LOOK_EVERY_S)
                for token, cell in list(self.cells.items()):
                    if cell.away_s > _FORGET_AFTER_S:
                        self._forget(token)
                    elif cell.away_s > AWAY_AFTER_S:
                        cell.lose()  # who waits may ask again, and is answered by another cell
                due = [
                    cell for cell in self.alive() if self.assets.state_of(cell.epoch) != _kind(cell)
                ]
                await asyncio.gather(*(self._learn(cell) for cell in due))

    async def _learn(self, cell: CellLink) -> None:
        """Ask a cell for the names of its assets."""
        kind = _kind(cell)
        try:
            names = await cell.ask(call(commands.Assets.names), _NAMES_S)
        except CellUnavailableError:
            return
        self.assets.learn(cell.epoch, names, kind)
        self._count_assets()

    def _forget(self, token: str) -> None:
        _log.warning("cell_gone", cell=token)
        self.cells.pop(token).lose()
        self.assets.forget(token)
        self._count_assets()

    def _count_assets(self) -> None:
        """Note who follows what now."""
        self.assets.count({token for token, cell in self.cells.items() if self._is_replaced(cell)})

    async def _take_state(self, message: "Msg") -> None:
        with contextlib.suppress(msgspec.DecodeError):
            change = self._change.decode(unpacked(message.data))
            cell = self.cells.get(change.epoch)
            if cell is None:
                cell = CellLink(self._connection, change.epoch, self._caller)
                self.cells[change.epoch] = cell
            cell.take_state(self._state.decode(change.body))
            self._of_record.take_claim(cell.epoch, cell.state.partitions)

    async def _take_answer(self, message: "Msg") -> None:
        cell = self.cells.get(message.subject.rpartition(".")[2])
        if cell is not None:
            cell.take_answer(unpacked(message.data))

    async def changes(self, topic: str) -> AsyncIterator[Change]:
        """Give the changes of all cells; those of their live messages are followed one by one."""
        async for body in self._connection.follow(changes_of("*", topic)):
            with contextlib.suppress(msgspec.DecodeError):
                yield self._change.decode(body)

    # ------------------------------------------------------------------ questions
    async def ask(self, command: Command[AnswerT], patience_s: float) -> AnswerT:
        """See `service.bus.interface.ReaderBus.ask`."""
        return cast(AnswerT, await self._ask(command, patience_s))

    async def _ask(self, command: Command[Any], patience_s: float) -> Any:
        how, of_fleet = command.call, self._of_fleet.get(type(command))
        if of_fleet is not None:
            return await of_fleet(command, patience_s)
        if how.merge is not None:
            return how.merge((await self._all(command, patience_s)).values())
        if how.of_any:
            return await self._any(command, patience_s)
        if "asset_id" in command.__struct_fields__:
            return await self._of(command.asset_id).ask(command, patience_s)  # type: ignore[attr-defined]
        raise CellUnavailableError(f"the fleet does not answer {type(command).__name__}")

    async def _asset_names(self, command: Command[Any], patience_s: float) -> dict[str, int]:
        if not self.alive():
            raise CellUnavailableError("no cell answers")
        return dict(self.assets.numbers)

    async def _apply(self, command: Command[Any], patience_s: float) -> dict[str, str]:
        wrong: dict[str, dict[str, str]] = await self._all(command, patience_s)
        await asyncio.gather(*(self._learn(cell) for cell in self.alive()))
        return {name: why for one in wrong.values() for name, why in one.items()}

    async def _any(self, command: Command[AnswerT], patience_s: float) -> AnswerT:
        """Ask one cell, whichever it is."""
        for cell in self.alive():
            return await cell.ask(command, patience_s)
        raise CellUnavailableError("no cell answers")

    def _of(self, asset: str) -> CellLink:
        owner = self._owner(asset)
        if owner is None:
            raise CellUnavailableError(f"no cell follows asset {asset!r} at the moment")
        return owner

    async def _all(self, command: Command[AnswerT], patience_s: float) -> dict[str, AnswerT]:
        """Ask every cell that lives; one that does not answer now is left out."""
        return await self._each(lambda cell: cell.ask(command, patience_s))

    async def _each(self, ask: Callable[[CellLink], Awaitable[AnswerT]]) -> dict[str, AnswerT]:
        cells = self.alive()
        if not cells:
            raise CellUnavailableError("no cell answers")
        answers = await asyncio.gather(*map(ask, cells), return_exceptions=True)
        found: dict[str, AnswerT] = {}
        for cell, answer in zip(cells, answers, strict=True):
            if isinstance(answer, CellUnavailableError):
                continue
            if isinstance(answer, BaseException):
                raise answer
            found[cell.epoch] = answer
        return found

    async def _documents(self, command: Any, patience_s: float) -> list[commands.PackedDocument]:
        places: dict[str, list[int]] = {}
        for place, wanted in enumerate(command.wanted):
            owner = self._owner(wanted.asset)
            if owner is not None:
                places.setdefault(owner.epoch, []).append(place)
        # A document without an answer gets old, and its age is shown.
        found = [commands.PackedDocument(b"", None) for _ in command.wanted]

        async def fill(token: str, mine: Sequence[int]) -> None:
            part = call(commands.Assets.documents, [command.wanted[place] for place in mine])
            with contextlib.suppress(CellUnavailableError):
                answer = await self.cells[token].ask(part, patience_s)
                for place, one in zip(mine, answer, strict=True):
                    found[place] = one

        await asyncio.gather(*(fill(token, mine) for token, mine in places.items()))
        return found

    async def _take_pushes(self, command: Any, patience_s: float) -> commands.Taken:
        """Have each cell take the pushes of its assets; what it does not take is left."""
        of_cell: dict[str, list[str]] = {}
        for asset in dict.fromkeys((*command.samples.assets, *command.too_old.assets)):
            owner = self._owner(asset)
            of_cell.setdefault("" if owner is None else owner.epoch, []).append(asset)
        left = of_cell.pop("", [])

        async def take(token: str, assets: list[str]) -> commands.Taken:
            mine = set(assets)
            parts = command.samples.part(mine), command.too_old.part(mine)
            part = call(commands.Pushes.take, command.received_us, command.patience_s, *parts)
            try:
                return await self.cells[token].ask(part, patience_s)
            except (CellUnavailableError, PushRefusedError):
                if len(of_cell) == 1 and not left:
                    raise
                return commands.Taken(0, 0, 0, assets)

        taken = await asyncio.gather(*(take(token, assets) for token, assets in of_cell.items()))
        if not taken:
            raise CellUnavailableError(f"no cell follows asset {left[0]!r} at the moment")
        return commands.Taken(
            sum(one.stored for one in taken),
            sum(one.duplicates for one in taken),
            max(one.kept_from_us for one in taken),
            [*left, *(name for one in taken for name in one.left)],
        )

    async def _listed_alarms(self, command: Any, patience_s: float) -> commands.AlarmsPart:
        return commands.AlarmsPart(await self._alarms(command, patience_s))

    async def _alarms(self, command: Any, patience_s: float) -> list[Alarm]:
        answers = await self._followed_alarms(command, patience_s)
        # Of two cells that claim an asset the one that has it.
        alarms = [
            alarm
            for token, parts in answers.items()
            for part in parts
            for alarm in part.alarms
            if self._is_owner(token, alarm.asset)
        ]
        if command.normal:
            return alarms
        unanswered = {
            name
            for name in self.assets.known()
            if not any(self._is_owner(token, name) for token in answers)
        }
        if not unanswered:
            return alarms
        # While a cell is being replaced its alarms are as they were.
        kept = await self._kept_alarms()
        return alarms + [alarm for alarm in kept if alarm.asset in unanswered]

    async def _followed_alarms(
        self, command: Any, patience_s: float
    ) -> dict[str, list[commands.AlarmsPart]]:
        """Ask until it is known of which assets the answers are: one may just change hands."""
        ends_s = time.monotonic() + patience_s
        while True:
            answers = await self._listed(command, patience_s)
            known = {token: self.assets.state_of(token) for token in answers}
            if all(
                (state := known[token]) is not None and part.followed == state[1]
                for token, parts in answers.items()
                for part in parts
            ):
                return answers
            if time.monotonic() > ends_s:
                raise CellUnavailableError("assets are changing hands")
            await asyncio.sleep(_LOOK_EVERY_S)

    async def _listed(
        self, command: Any, patience_s: float
    ) -> dict[str, list[commands.AlarmsPart]]:
        return await self._each(
            lambda cell: parts_of(partial(cell.ask, patience_s=patience_s), command)
        )

    async def _kept_alarms(self) -> Sequence[Alarm]:
        try:
            return await self._open_alarms()
        except StoreUnavailableError as error:
            raise CellUnavailableError("the cell of some alarms is being replaced") from error

    def _is_owner(self, token: str, asset: str) -> bool:
        owner = self._owner(asset)
        return owner is not None and owner.epoch == token

    async def _act(self, command: Any, patience_s: float) -> Alarm:
        for cell in self.alive():
            with contextlib.suppress(UnknownAlarmError):
                return await cell.ask(command, patience_s)
        await self._require_over([command.alarm])
        raise UnknownAlarmError(f"no open alarm {command.alarm!r}")

    async def _require_over(self, alarms: Collection[str]) -> None:
        """Refuse to call an alarm unknown while its asset has no cell that knows it."""
        if any(alarm.id in alarms for alarm in await self._kept_alarms()):
            raise CellUnavailableError("the cell of this alarm is being replaced")

    async def _acknowledge(self, command: Any, patience_s: float) -> commands.AcknowledgeResult:
        listed = await self._listed(call(commands.Alarms.listed), patience_s)
        cell_of = {
            alarm.id: token
            for token, parts in listed.items()
            for part in parts
            for alarm in part.alarms
        }
        ids_of: dict[str, list[str]] = {}
        unknown: list[tuple[str, str]] = []
        for alarm_id in command.ids:
            if alarm_id in cell_of:
                ids_of.setdefault(cell_of[alarm_id], []).append(alarm_id)
            else:
                unknown.append((alarm_id, f"no open alarm {alarm_id!r}"))
        if unknown:
            await self._require_over([id for id, _ in unknown])
        done = commands.AcknowledgeResult([], unknown)
        for token, ids in ids_of.items():
            # One call, one line of the audit trail.
            audit = None if done.alarms else command.audit
            part = call(commands.Alarms.acknowledge, ids, command.who, command.comment, audit)
            answer = await self.cells[token].ask(part, patience_s)
            done = commands.AcknowledgeResult(
                done.alarms + answer.alarms, done.failed + answer.failed
            )
        return done


def _kind(cell: CellLink) -> tuple[int, int]:
    """What changes when a cell follows other assets."""
    return cell.state.assets, cell.state.followed
