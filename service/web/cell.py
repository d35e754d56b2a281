"""The cell as the web side sees it: everything that it must be asked over the bus."""

import asyncio
import contextlib
from collections.abc import Sequence
from itertools import groupby
from operator import attrgetter
from typing import Any, Final, TypeVar

from cachetools import TTLCache

from adapters.samples import Sample
from service.alarms.records import assets_of, urgency
from service.bus.alarm_lists import alarms_of
from service.bus.asking import caller_role
from service.bus.calls import call, proxy
from service.bus.commands import Alarms, Pushes, Taken
from service.bus.interface import ReaderBus
from service.bus.messages import SOON_S, WRITTEN_S, AnswerT, Command
from service.bus.pushed_samples import PackedSamples, PushedSamples
from service.domain.errors import CellUnavailableError, PushRefusedError
from service.store import Alarm, WriteCounts
from service.web.waiting_pushes import WaitingPushes

#: A push to a cell of a fleet waits so long for its turn, and for its answer; then it is kept here.
_TURN_S: Final = 3.0
_TAKEN_S: Final = 5.0
#: Wall seconds for which an answer is given to all who ask the same.
SHARED_S: Final = 0.1
#: So many answers are kept.
MOST_SHARED: Final = 256

InterfaceT = TypeVar("InterfaceT")


class AskedCell:
    """The parts of the cell, each by its interface: ``await cell(Identifications).jobs("a")``.

    What many callers want at the same time is asked for once, where the interface allows it.
    """

    def __init__(self, reader: ReaderBus, fresh_s: float = SHARED_S) -> None:
        self._reader = reader
        self._known: TTLCache[Command[Any], Any] = TTLCache(MOST_SHARED, fresh_s)
        self._asking: dict[Command[Any], asyncio.Task[Any]] = {}
        self._proxies: dict[type, Any] = {}

    def __call__(self, interface: type[InterfaceT]) -> InterfaceT:
        """Give a part of the cell."""
        if interface not in self._proxies:
            self._proxies[interface] = proxy(interface, self.ask)
        found: InterfaceT = self._proxies[interface]
        return found

    def forget(self) -> None:
        """Give no answer from before this moment: a caller has changed something."""
        self._known.clear()
        # Who asks from now on does not wait for questions that are under way.
        self._asking = {}

    async def ask(self, command: Command[AnswerT], patience_s: float | None = None) -> AnswerT:
        """Give the answer to a command; by default as long as it may take is waited for it."""
        patience_s = command.call.patience_s if patience_s is None else patience_s
        if not command.call.shared:
            return await self._reader.ask(command, patience_s)
        answer: AnswerT | None = self._known.get(command)
        if answer is not None:
            return answer
        asking = self._asking.get(command)
        if asking is None:
            asking = asyncio.create_task(self._ask(self._asking, command, patience_s))
            self._asking[command] = asking
            asking.add_done_callback(lambda done: done.cancelled() or done.exception())
        found: AnswerT = await asyncio.shield(asking)
        return found

    async def _ask(
        self,
        among: dict[Command[Any], "asyncio.Task[Any]"],
        command: Command[Any],
        patience_s: float,
    ) -> Any:
        try:
            answer = await self._reader.ask(command, patience_s)
            if among is self._asking:
                self._known[command] = answer
            return answer
        finally:
            del among[command]

    # ------------------------------------------------------------------ alarms
    async def open_alarms(self, asset: str | None = None) -> list[Alarm]:
        """All alarms that are not over, of one asset or of all: see `urgency` for their order."""
        alarms = await alarms_of(self.ask, call(Alarms.listed))
        some = alarms if asset is None else (one for one in alarms if asset in assets_of(one))
        return sorted(some, key=urgency)

    async def normal_alarms(self, asset: str | None = None) -> list[Alarm]:
        """All alarms that are normal."""
        return sorted(await alarms_of(self.ask, call(Alarms.listed, True, asset)), key=urgency)

    async def flush_alarms(self, patience_s: float) -> None:
        """Have the store take all changes, for a while; one that is away is not waited for."""
        with contextlib.suppress(CellUnavailableError):  # then the store has what it has
            await self.ask(call(Alarms.flush, patience_s), patience_s + SOON_S)


class CellIngest:
    """The way of pushed samples into the cell.

    ``kept_from_us``: the store takes no samples from before this time, as far as is known here.
    """

    def __init__(
        self, reader: ReaderBus, kept_from_us: int = 0, waiting: WaitingPushes | None = None
    ) -> None:
        self._reader = reader
        self._waiting = waiting
        self.kept_from_us = kept_from_us

    async def accept(
        self,
        asset: str,
        samples: Sequence[Sample],
        too_old: Sequence[Sample],
        received_us: int,
        patience_s: float,
    ) -> WriteCounts:
        """Take judged samples of an asset, as `accept_all`."""
        judged = PushedSamples.of(samples), PushedSamples.of(too_old)
        counts, left = await self.accept_all(*judged, received_us, patience_s)
        if left:
            raise CellUnavailableError(f"asset {asset!r} is not followed here now")
        return counts

    async def accept_all(
        self,
        samples: PushedSamples,
        too_old: PushedSamples,
        received_us: int,
        patience_s: float,
    ) -> tuple[WriteCounts, Sequence[str]]:
        """Take judged samples of any assets; at the end they are on the disk.

        That is the disk of this process where the cell of a fleet does not answer; all count as
        stored then. Sending the same again is harmless. Gives the counts, and the assets of which
        nothing was taken: they are not followed any more. Raises `PushRefusedError` if none of the
        samples was stored; in a fleet, if there is no room on this disk either. Raises
        `CellUnavailableError` if the cell of a single service does not answer: they may have been
        stored or not.
        """
        waiting = self._waiting
        if waiting is None:
            answer_s = patience_s + WRITTEN_S
            taken = await self._take(received_us, patience_s, answer_s, samples, too_old)
            return WriteCounts(taken.stored, taken.duplicates), taken.left
        assets = dict.fromkeys((*samples.assets, *too_old.assets))
        later = {name for name in assets if waiting.holds(name)}
        stored = duplicates = 0
        if left := assets.keys() - later:
            parts = samples.part(left), too_old.part(left)
            # Where a cell answers too late, or refuses, there is room on this disk.
            with contextlib.suppress(CellUnavailableError, PushRefusedError):
                taken = await self._take(received_us, _TURN_S, _TAKEN_S, *parts)
                stored, duplicates, left = taken.stored, taken.duplicates, set(taken.left)
            later |= left
        rest = samples.part(later)
        kept = groupby(rest.unpack(received_us, 0, len(rest)), attrgetter("asset"))
        await asyncio.gather(*(waiting.keep(name, list(some), received_us) for name, some in kept))
        return WriteCounts(stored + len(rest), duplicates), ()

    async def hand_over(self, asset: str, samples: PackedSamples, received_us: int) -> None:
        """Have the cell take samples that have waited; raises as `accept`."""
        caller_role.set("gateway")  # who pushed them was one, or an administrator
        push = PushedSamples.of_asset(asset, samples)
        if (await self._take(received_us, _TURN_S, WRITTEN_S, push, PushedSamples.of(()))).left:
            raise CellUnavailableError(f"asset {asset!r} is not followed here now")

    async def _take(
        self,
        received_us: int,
        patience_s: float,
        answer_s: float,
        samples: PushedSamples,
        too_old: PushedSamples,
    ) -> Taken:
        command = call(Pushes.take, received_us, patience_s, samples, too_old)
        taken = await self._reader.ask(command, answer_s)
        self.kept_from_us = max(self.kept_from_us, taken.kept_from_us)
        return taken
