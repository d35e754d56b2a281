"""All cells of a fleet as one, for a web or plant side: each question goes to who can answer it."""

import asyncio
import contextlib
import math
import os
import time
import zlib
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, cast

import msgspec
import structlog

from service.alarms import UnknownAlarmError
from service.bus import commands
from service.bus.exposition import merged
from service.bus.interface import AWAY_AFTER_S
from service.bus.messages import AnswerT, Change, Command, State
from service.bus.nats_bus import STATES, CellLink, NatsConnection, inbox, unpacked
from service.domain.errors import CellUnavailableError
from service.notifications.states import merged as merged_states
from service.store import Alarm, StoreUnavailableError

if TYPE_CHECKING:
    from nats.aio.msg import Msg

#: Wall seconds for the names of a cell's assets.
_NAMES_S: Final = 5.0
_LOOK_EVERY_S: Final = 0.1
#: A cell that was silent for so long is forgotten: another one has its assets.
_FORGET_AFTER_S: Final = 10.0

_log = structlog.get_logger(__name__)

_OF_ASSET: Final = (
    commands.RenewGrease,
    commands.TakeSamples,
    commands.CreateJob,
    commands.GetJobs,
    commands.CancelJob,
    commands.ActivateModel,
)


class Fleet:
    """All cells of a fleet; see `service.bus.interface.ReaderBus`.

    Parameters
    ----------
    connection : NatsConnection
        Of this process; not running yet.
    partitions : int
        How many there are.
    known : callable
        Gives the ids of all assets of the fleet, whoever follows them now.
    open_alarms : callable
        Reads the alarms that are not over from the store.

    Attributes
    ----------
    epoch : str
        Names this process: its live messages have numbers of its own.
    cells : dict of str to CellLink
        Those that were heard in the last seconds.
    """

    def __init__(
        self,
        connection: NatsConnection,
        partitions: int,
        known: Callable[[], Collection[str]],
        open_alarms: Callable[[], Awaitable[Sequence[Alarm]]],
    ) -> None:
        caller = os.urandom(8)
        self.epoch = caller.hex()
        self.cells: dict[str, CellLink] = {}
        self._connection = connection
        self._caller = caller
        self._partitions = partitions
        self._known = known
        self._open_alarms = open_alarms
        # Which assets each cell follows, and of which state of it that is known.
        self._names: dict[str, dict[str, int]] = {}
        self._named: dict[str, tuple[int, int]] = {}
        self._last_names: dict[str, int] = {}
        # Cells that claim an asset, the one that has it last.
        self._owners: dict[str, list[str]] = {}
        self._revision = 0
        self._whole_s = -math.inf
        self._change = msgspec.msgpack.Decoder(Change)
        self._state = msgspec.msgpack.Decoder(State)
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
    def state(self) -> State:
        """What all cells report together."""
        alive = self.alive()
        return State(
            waits_for="" if alive else "a cell",
            ready=bool(alive) and all(cell.epoch in self._named for cell in alive),
            assets=self._revision,
        )

    def alive(self) -> list[CellLink]:
        """Cells that take commands."""
        return [cell for cell in self.cells.values() if cell.alive]

    def owners(self) -> dict[int, str]:
        """Cell by partition; the newest owner where two claim it."""
        newest: dict[int, tuple[int, str]] = {}
        for cell in self.alive():
            for partition, epoch in cell.state.partitions.items():
                newest[partition] = max(newest.get(partition, (-1, "")), (epoch, cell.epoch))
        return {partition: cell for partition, (_, cell) in newest.items()}

    def missing(self) -> list[int]:
        """Partitions that no living cell owns."""
        owners = self.owners()
        return [one for one in range(self._partitions) if one not in owners]

    def is_known(self, asset: str) -> bool:
        """Whether an asset belongs to the fleet, whoever follows it now."""
        return asset in self._known()

    def _owner(self, asset: str) -> CellLink | None:
        """The cell that follows an asset."""
        for token in reversed(self._owners.get(asset, ())):
            cell = self.cells.get(token)
            if cell is not None and cell.alive:
                return cell
        return None

    def _is_replaced(self, cell: CellLink) -> bool:
        """Whether another cell has taken over what this one still takes for its own."""
        return any(
            other.state.partitions.get(partition, epoch) > epoch
            for other in self.alive()
            for partition, epoch in cell.state.partitions.items()
        )

    def of_cell(self, token: str, assets: Collection[str] | None) -> Collection[str] | None:
        """Those of some assets that a cell follows; None for all."""
        if assets is None:
            return None
        names = self._names.get(token, {})
        return [name for name in assets if name in names]

    async def run(self) -> None:
        """Keep the connection and the knowledge of the cells until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._connection.run())
            while True:
                await asyncio.sleep(_LOOK_EVERY_S)
                for token, cell in list(self.cells.items()):
                    if cell.away_s > _FORGET_AFTER_S:
                        self._forget(token)
                    elif cell.away_s > AWAY_AFTER_S:
                        cell.lose()  # who waits may ask again, and is answered by another cell
                due = [cell for cell in self.alive() if self._named.get(cell.epoch) != _kind(cell)]
                await asyncio.gather(*(self._learn(cell) for cell in due))

    async def _learn(self, cell: CellLink) -> None:
        """Ask a cell for the names of its assets."""
        kind = _kind(cell)
        try:
            names = await cell.ask(commands.AssetNames(), _NAMES_S)
        except CellUnavailableError:
            return
        # Last in order: of two that claim an asset, the one that said so later has it.
        self._names.pop(cell.epoch, None)
        self._names[cell.epoch], self._named[cell.epoch] = names, kind
        self._count_assets()

    def _forget(self, token: str) -> None:
        _log.warning("cell_gone", cell=token)
        self.cells.pop(token).lose()
        self._names.pop(token, None)
        self._named.pop(token, None)
        self._count_assets()

    def _count_assets(self) -> None:
        """Note who follows what now."""
        owners: dict[str, list[str]] = {}
        found: dict[str, int] = {}
        replaced = {token for token, cell in self.cells.items() if self._is_replaced(cell)}
        for token in sorted(self._names, key=lambda one: one not in replaced):
            for name, number in self._names[token].items():
                owners.setdefault(name, []).append(token)
                # Of another cell it is another object, whatever its number there.
                found[name] = zlib.crc32(f"{token} {number}".encode())
        # What nobody follows at the moment stays as it was: its cell is being replaced.
        everything = {
            name: number for name, number in self._last_names.items() if name in self._known()
        } | found
        known = {name: place for place, name in enumerate(self._known())}
        ordered = sorted(everything, key=lambda name: (known.get(name, len(known)), name))
        numbers = {name: everything[name] for name in ordered}
        self._owners = owners
        if numbers != self._last_names:
            self._last_names = numbers
            self._revision += 1

    async def _take_state(self, message: "Msg") -> None:
        with contextlib.suppress(msgspec.DecodeError):
            change = self._change.decode(unpacked(message.data))
            cell = self.cells.get(change.epoch)
            if cell is None:
                cell = CellLink(self._connection, change.epoch, self._caller)
                self.cells[change.epoch] = cell
            cell.take_state(self._state.decode(change.body))

    async def _take_answer(self, message: "Msg") -> None:
        cell = self.cells.get(message.subject.rpartition(".")[2])
        if cell is not None:
            cell.take_answer(unpacked(message.data))

    async def changes(self, topic: str) -> AsyncIterator[Change]:
        """Nothing: the live messages of several cells are followed one by one."""
        await asyncio.Event().wait()
        yield Change(self.epoch, 0, b"")

    # ------------------------------------------------------------------ questions
    async def ask(self, command: Command[AnswerT], patience_s: float) -> AnswerT:
        """See `service.bus.interface.ReaderBus.ask`."""
        answer = await self._ask(command, patience_s)
        return cast(AnswerT, answer)

    async def _ask(self, command: Command[Any], patience_s: float) -> object:
        if isinstance(command, _OF_ASSET):
            owner: Any = self._of(command.asset)
            return await owner.ask(command, patience_s)
        match command:
            case commands.AssetNames():
                if not self.alive():
                    raise CellUnavailableError("no cell answers")
                return dict(self._last_names)
            case commands.GetDocuments():
                return await self._documents(command, patience_s)
            case commands.ListAlarms():
                return await self._alarms(command, patience_s)
            case commands.ActOnAlarm():
                return await self._act(command, patience_s)
            case commands.AcknowledgeAlarms():
                return await self._acknowledge(command, patience_s)
            case commands.GetNotifications():
                return merged_states((await self._all(command, patience_s)).values())
            case commands.TestNotification():
                return await self._any(command, patience_s)
            case commands.CheckHealth():
                return await self._health(patience_s)
            case commands.GetMetrics():
                answers = await self._all(command, patience_s)
                return merged({f"cell-{token}": text for token, text in answers.items()}) + (
                    self._partition_metrics()
                )
            case commands.ApplyAssets():
                wrong = await self._all(command, patience_s)
                await self._learn_all()
                return {name: why for one in wrong.values() for name, why in one.items()}
            case commands.Flush():
                return all((await self._all(command, patience_s)).values())
            case commands.Present():
                await self._all(command, patience_s)
                return True
        raise CellUnavailableError(f"the fleet does not answer {type(command).__name__}")

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
        cells = self.alive()
        if not cells:
            raise CellUnavailableError("no cell answers")
        answers = await asyncio.gather(
            *(cell.ask(command, patience_s) for cell in cells), return_exceptions=True
        )
        found: dict[str, AnswerT] = {}
        for cell, answer in zip(cells, answers, strict=True):
            if isinstance(answer, CellUnavailableError):
                continue
            if isinstance(answer, BaseException):
                raise answer
            found[cell.epoch] = answer
        return found

    async def _documents(
        self, command: commands.GetDocuments, patience_s: float
    ) -> list[commands.Document]:
        places: dict[str, list[int]] = {}
        for place, wanted in enumerate(command.wanted):
            owner = self._owner(wanted.asset)
            if owner is not None:
                places.setdefault(owner.epoch, []).append(place)
        # What nobody answers for gets old, and says so.
        found = [commands.Document(b"", None) for _ in command.wanted]

        async def fill(token: str, mine: Sequence[int]) -> None:
            part = commands.GetDocuments([command.wanted[place] for place in mine])
            with contextlib.suppress(CellUnavailableError):
                answer: list[commands.Document] = await self.cells[token].ask(part, patience_s)
                for place, one in zip(mine, answer, strict=True):
                    found[place] = one

        await asyncio.gather(*(fill(token, mine) for token, mine in places.items()))
        return found

    async def _alarms(self, command: commands.ListAlarms, patience_s: float) -> list[Alarm]:
        answers = await self._followed_alarms(command, patience_s)
        # Of two cells that claim an asset the one that has it.
        alarms = [
            alarm
            for token, answer in answers.items()
            for alarm in answer.alarms
            if self._is_owner(token, alarm.asset)
        ]
        if command.normal:
            return alarms
        unanswered = {
            name
            for name in self._known()
            if not any(self._is_owner(token, name) for token in answers)
        }
        if not unanswered:
            return alarms
        # While a cell is being replaced its alarms are as they were.
        kept = await self._kept_alarms()
        return alarms + [alarm for alarm in kept if alarm.asset in unanswered]

    async def _followed_alarms(
        self, command: commands.ListAlarms, patience_s: float
    ) -> dict[str, commands.FollowedAlarms]:
        """Ask until it is known of which assets the answers are: one may just change hands."""
        ends_s = time.monotonic() + patience_s
        while True:
            answers = await self._all(commands.ListFollowedAlarms(command.normal), patience_s)
            known = {token: kind[1] for token, kind in self._named.items()}
            if all(answer.followed == known.get(token) for token, answer in answers.items()):
                return answers
            if time.monotonic() > ends_s:
                raise CellUnavailableError("assets are changing hands")
            await asyncio.sleep(_LOOK_EVERY_S)

    async def _kept_alarms(self) -> Sequence[Alarm]:
        try:
            return await self._open_alarms()
        except StoreUnavailableError as error:
            raise CellUnavailableError("the cell of some alarms is being replaced") from error

    def _is_owner(self, token: str, asset: str) -> bool:
        owner = self._owner(asset)
        return owner is not None and owner.epoch == token

    async def _act(self, command: commands.ActOnAlarm, patience_s: float) -> Alarm:
        for cell in self.alive():
            with contextlib.suppress(UnknownAlarmError):
                return await cell.ask(command, patience_s)
        await self._require_over([command.alarm])
        raise UnknownAlarmError(f"no open alarm {command.alarm!r}")

    async def _require_over(self, alarms: Collection[str]) -> None:
        """Refuse to call an alarm unknown while its asset has no cell that knows it."""
        if any(alarm.id in alarms for alarm in await self._kept_alarms()):
            raise CellUnavailableError("the cell of this alarm is being replaced")

    async def _acknowledge(
        self, command: commands.AcknowledgeAlarms, patience_s: float
    ) -> commands.AcknowledgedAlarms:
        listed = await self._all(commands.ListAlarms(), patience_s)
        cell_of = {alarm.id: token for token, alarms in listed.items() for alarm in alarms}
        ids_of: dict[str, list[str]] = {}
        unknown: list[tuple[str, str]] = []
        for alarm_id in command.ids:
            if alarm_id in cell_of:
                ids_of.setdefault(cell_of[alarm_id], []).append(alarm_id)
            else:
                unknown.append((alarm_id, f"no open alarm {alarm_id!r}"))
        if unknown:
            await self._require_over([id for id, _ in unknown])
        done = commands.AcknowledgedAlarms([], unknown)
        for token, ids in ids_of.items():
            # One call, one line of the audit trail.
            audit = None if done.alarms else command.audit
            part = commands.AcknowledgeAlarms(ids, command.who, command.comment, audit)
            answer = await self.cells[token].ask(part, patience_s)
            done = commands.AcknowledgedAlarms(
                done.alarms + answer.alarms, done.failed + answer.failed
            )
        return done

    async def _health(self, patience_s: float) -> list[commands.HealthCheck]:
        answers = await self._all(commands.CheckHealth(), patience_s)
        missing = len(self.missing())
        shares = f"{len(self.alive())} cells own all {self._partitions} partitions"
        checks = [
            commands.HealthCheck("partitions", "degraded", f"{missing} partitions have no owner")
            if missing
            else commands.HealthCheck("partitions", "ok", shares)
        ]
        # What every cell says of itself is said once: the worst of it.
        worst: dict[str, commands.HealthCheck] = {}
        for check in (check for one in answers.values() for check in one):
            known = worst.get(check.name)
            if known is None or _RANK[check.status] > _RANK[known.status]:
                worst[check.name] = check
        return checks + list(worst.values())

    def _partition_metrics(self) -> bytes:
        owners = self.owners()
        name = "bearing_twin_partition_owner"
        lines = [
            f"# HELP {name} 1 while a living cell owns the partition.",
            f"# TYPE {name} gauge",
            *(
                f'{name}{{partition="{one}"}} {1.0 if one in owners else 0.0}'
                for one in range(self._partitions)
            ),
        ]
        return ("\n".join(lines) + "\n").encode()

    async def _learn_all(self) -> None:
        """Know the names of all cells as they are after a change."""
        await asyncio.gather(*(self._learn(cell) for cell in self.alive()))


_RANK: Final[Mapping[str, int]] = {"ok": 0, "degraded": 1, "failed": 2}


def _kind(cell: CellLink) -> tuple[int, int]:
    """What changes when a cell follows other assets."""
    return cell.state.assets, cell.state.followed
