"""What the cell answers to those who ask over the bus: assets, live messages, pushes and alarms."""

import asyncio
from bisect import bisect_right
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Container, Mapping
from dataclasses import dataclass, field
from typing import Final, cast

import msgspec
from anyio import to_thread
from pydantic_core import to_json

from adapters.samples import Sample
from service.alarms import AlarmBook, AlarmState, NotAllowedError, UnknownAlarmError
from service.alarms.records import key_of
from service.bus import commands as ask
from service.bus.calls import answering
from service.bus.interface import Handlers
from service.bus.messages import encode
from service.bus.pushed_samples import PushedSamples
from service.bus.replica import digest
from service.bus.stream import LiveMessages
from service.documents.assets import GreaseRenewed
from service.domain.causes import source_of
from service.domain.errors import NotKeptError, PushRefusedError
from service.ingest import Ingest
from service.live.asset import AssetRuntime
from service.pauses import Steps
from service.store import Alarm, AuditEntry, Outbox, Store, StoreUnavailableError

#: Live messages in one answer.
STREAM_PART: Final = 200
#: Alarms in one answer, and those of one asset more.
ALARMS_PART: Final = 500
#: Pushed samples that are made in one go.
PORTION: Final = 250
_FLUSH_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class _Made:
    """A document as text, and what it was made of."""

    source: object
    text: bytes
    tag: bytes


@dataclass
class AssetAnswers:
    """The documents of the assets and what is done to these; see `service.bus.commands.Assets`."""

    assets: Mapping[str, AssetRuntime]
    apply_changes: Callable[[], Awaitable[dict[str, str]]] | None = None
    _made: dict[tuple[str, str], _Made] = field(default_factory=dict)

    async def names(self) -> dict[str, int]:
        """Give the ids of all assets, and which make each is."""
        return {name: asset.make_number for name, asset in self.assets.items()}

    async def apply(self) -> dict[str, str]:
        """Take up the assets that the store holds now."""
        return {} if self.apply_changes is None else await self.apply_changes()

    async def documents(self, wanted: list[ask.Wanted]) -> list[ask.PackedDocument]:
        """Give documents; a poll that is due comes between some of them."""
        steps, answer = Steps(), []
        for one in wanted:
            answer.append(await self._document(one, steps))
            await steps.pause()
        return answer

    async def _document(self, wanted: ask.Wanted, steps: Steps) -> ask.PackedDocument:
        twin = self.assets.get(wanted.asset)
        if twin is None:  # removed a moment ago, which who asks is about to hear
            return ask.PackedDocument(b"", None)
        asset = twin.documents
        make: Mapping[str, Callable[[], object]] = {
            "facts": asset.description,
            "summary": asset.summary,
            "snapshot": asset.snapshot,
            "state": asset.state,
            "verdict": asset.verdict,
            "forecast": asset.forecast,
            "machine": asset.machine,
            "asset_summary": asset.asset_summary,
        }
        # A process that has just begun asks for all there is, and knows nothing yet.
        if wanted.kind == "forecast" and wanted.tag:
            twin.look()
        source, key = make[wanted.kind](), (wanted.asset, wanted.kind)
        made = self._made.get(key)
        # An asset gives the same snapshot and forecast as long as nothing in it has changed.
        if made is None or made.source is not source or source is None:
            await steps.pause()
            text = to_json(source, inf_nan_mode="null")
            await steps.pause()
            # The others are made for each question.
            kept = source if wanted.kind in ("snapshot", "forecast") else None
            made = _Made(kept, text, digest(text))
            if wanted.asset in self.assets:
                self._made[key] = made
        return ask.PackedDocument(made.tag, None if made.tag == wanted.tag else made.text)

    def forget(self, assets: Collection[str]) -> None:
        """Keep no document of assets that are followed no longer."""
        gone = set(assets)
        for key in [key for key in self._made if key[0] in gone]:
            del self._made[key]

    async def renew_grease(
        self, asset_id: str, who: str, comment: str, audit: AuditEntry | None = None
    ) -> GreaseRenewed:
        """Count the revolutions of an asset's grease from zero again."""
        return await self.assets[asset_id].renew_grease(who, comment, audit)


@dataclass(frozen=True)
class StreamAnswers:
    """The live messages of the cell; see `service.bus.commands.LiveStream`."""

    stream: LiveMessages

    async def follow(self, assets: list[str] | None) -> ask.StreamMade:
        """Make the live messages of assets that somebody follows."""
        return ask.StreamMade(self.stream.epoch, self.stream.follow(assets))

    async def after(self, epoch: str, number: int) -> ask.StreamPart:
        """Give the live messages after a number."""
        stream = self.stream
        messages, forgotten = stream.after(number if epoch == stream.epoch else 0, STREAM_PART)
        parts = [ask.StreamMessage(one.seq, one.type, one.asset, one.text) for one in messages]
        return ask.StreamPart(stream.seq, forgotten, parts)


@dataclass
class PushAnswers:
    """The way of pushed samples into the cell; see `service.bus.commands.Pushes`."""

    ingest: Ingest
    store: Store
    assets: Collection[str]
    _pushing: asyncio.Lock = field(default_factory=asyncio.Lock)

    async def take(
        self, received_us: int, patience_s: float, samples: PushedSamples, too_old: PushedSamples
    ) -> ask.Taken:
        """Accept judged samples; the answer means that they are on the disk."""
        ingest, steps = self.ingest, Steps()
        unpacked: list[Sample] = []
        try:
            async with self._pushing:
                # Those that were removed, or are another cell's by now.
                left = {name: None for name in samples.assets if name not in self.assets}
                left |= {name: None for name in too_old.assets if name not in self.assets}
                async for some in _unpacked(too_old, received_us, left, steps):
                    ingest.refuse_too_old(some)
                async for some in _unpacked(samples, received_us, left, steps):
                    unpacked += some
                stored = await ingest.take_in(unpacked, patience_s)
            counts = await stored
            while unpacked:  # to forget all of them at once takes long, too
                del unpacked[-PORTION:]
                await steps.pause()
        except StoreUnavailableError as error:
            raise PushRefusedError(str(error), ingest.retry_after_s) from error
        return ask.Taken(
            counts.stored, counts.duplicates, self.store.samples.kept_from_us, list(left)
        )


async def _unpacked(
    samples: PushedSamples, received_us: int, left: Container[str], steps: Steps
) -> AsyncIterator[list[Sample]]:
    for begin in range(0, len(samples), PORTION):
        some = samples.unpack(received_us, begin, begin + PORTION)
        yield [one for one in some if one.asset not in left] if left else some
        await steps.pause()


class _PackedPart(msgspec.Struct, frozen=True, array_like=True):
    """`service.bus.commands.AlarmsPart` with alarms that are packed already."""

    alarms: list[msgspec.Raw]
    followed: int
    next: str = ""


@dataclass(frozen=True)
class AlarmAnswers:
    """The alarm book of the cell; see `service.bus.commands.Alarms`."""

    book: AlarmBook
    outbox: Outbox
    is_fleet: bool = False
    followed: Callable[[], int] = int

    async def listed(
        self, normal: bool = False, asset: str | None = None, after: str = ""
    ) -> ask.AlarmsPart:
        """Give the alarms that are open, or the normal ones: those of some assets."""
        book, steps, packed, following = self.book, Steps(), list[msgspec.Raw](), ""
        names = [asset] if asset is not None else []
        if asset is None:
            of_all = book.assets(normal=normal)
            # Alarms that assets share come last, and once.
            names = [*of_all[bisect_right(of_all, after) :], ""]
        for number, name in enumerate(names):
            if len(packed) >= ALARMS_PART:
                following = names[number - 1]
                break
            for watched in book.watched(name, normal=normal):
                alarm = watched.shown
                if asset is None and key_of(alarm)[0] != name:
                    continue
                if (alarm.state == AlarmState.NORM) == normal:  # else it has just changed
                    packed.append(msgspec.Raw(encode(alarm)))
                await steps.pause()
        return cast(ask.AlarmsPart, _PackedPart(packed, self.followed(), following))

    async def act(
        self,
        alarm: str,
        action: ask.AlarmAction,
        who: str,
        comment: str,
        duration_s: float = 0.0,
        audit: AuditEntry | None = None,
    ) -> Alarm:
        """Do something to an alarm."""
        book = self.book
        acts: Mapping[str, Callable[[str, str, str, AuditEntry | None], Alarm]] = {
            "acknowledge": book.acknowledge,
            "comment": book.comment,
            "reset": book.reset,
            "return_to_service": book.return_to_service,
            "take_out_of_service": book.take_out_of_service,
            "unshelve": book.unshelve,
        }
        if action == "shelve":
            changed = book.shelve(alarm, duration_s, who, comment, audit)
        else:
            changed = acts[action](alarm, who, comment, audit)
        await self._written()
        return changed

    async def acknowledge(
        self, ids: list[str], who: str, comment: str, audit: AuditEntry | None = None
    ) -> ask.AcknowledgeResult:
        """Acknowledge several alarms."""
        alarms: list[Alarm] = []
        failed: list[tuple[str, str]] = []
        steps = Steps()
        # An alarm of a source acknowledges those of its channels: each of them is taken first.
        ordered: dict[bool, list[str]] = {False: [], True: []}
        for alarm_id in dict.fromkeys(ids):
            ordered[self._is_of_source(alarm_id)].append(alarm_id)
            await steps.pause()
        for alarm_id in ordered[False] + ordered[True]:
            await steps.pause()
            # One call, one line: written with the first change, so that none is without it.
            line = None if alarms else audit
            try:
                alarms.append(self.book.acknowledge(alarm_id, who, comment, line))
            except (UnknownAlarmError, NotAllowedError) as error:
                failed.append((alarm_id, str(error.args[0])))
        await self._written()
        return ask.AcknowledgeResult(alarms, failed)

    def _is_of_source(self, alarm_id: str) -> bool:
        try:
            return bool(source_of(self.book.alarm(alarm_id).channel))
        except UnknownAlarmError:
            return False

    async def flush(self, patience_s: float) -> bool:
        """Wait until the store has every change, for a while."""
        return await to_thread.run_sync(self.outbox.flush, patience_s, abandon_on_cancel=True)

    async def _written(self) -> None:
        """Wait until a change is kept.

        Raises
        ------
        NotKeptError
            When neither the store nor the disk takes it.
        """
        outbox = self.outbox
        written = await to_thread.run_sync(outbox.flush, _FLUSH_S)
        if written or not (outbox.unkept or self.is_fleet):
            return
        if not outbox.unkept:
            raise NotKeptError(
                "the change is made and waits on the disk of one cell: the database does not "
                "answer, and another cell that takes over before it does would not know of it"
            )
        raise NotKeptError(
            "the change is made, but neither the store nor the disk takes it "
            f"({outbox.disk_problem or 'the disk is slow'}): it is lost if the service stops "
            "before one of them does"
        )


def handlers_of(
    assets: AssetAnswers, stream: StreamAnswers, pushes: PushAnswers, alarms: AlarmAnswers
) -> Handlers:
    """What answers the commands of the core."""
    return {
        **answering(ask.Assets)(assets),
        **answering(ask.LiveStream)(stream),
        **answering(ask.Pushes)(pushes),
        **answering(ask.Alarms)(alarms),
    }
