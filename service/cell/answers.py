"""What the cell answers to those who ask over the bus."""

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from anyio import to_thread
from prometheus_client import CollectorRegistry, Gauge
from prometheus_client.exposition import generate_latest
from pydantic_core import to_json

from adapters.protocol import Clock, SourceHealth
from adapters.samples import is_good
from service.alarms import AlarmBook, NotAllowedError, UnknownAlarmError
from service.bus import commands as ask
from service.bus.interface import Handler
from service.bus.messages import Command
from service.bus.presence import resident_bytes
from service.bus.replica import digest
from service.bus.stream import Bus
from service.domain.errors import CellUnavailableError, NotKeptError, PushRefusedError
from service.domain.requests import IdentificationRequest
from service.ingest import Ingest
from service.jobs.manager import IdentificationJobs
from service.live.asset import AssetRuntime
from service.live.asset_documents import TWIN_SOURCE, AssetDocuments
from service.notifications.notifier import Notifier
from service.notifications.states import NotificationState
from service.store import Alarm, AuditEntry, Outbox, Store, StoreUnavailableError

#: Live messages in one answer.
STREAM_PART: Final = 200
#: Pushed samples that are made in one go.
PORTION: Final = 250
#: Documents that are made in one go.
DOCUMENTS: Final = 8
#: Wall seconds in which the store must answer: whoever probes does not wait for long.
STORE_ANSWERS_S: Final = 1.5
#: Wall seconds without a word of a process after which it counts as gone.
PRESENT_S: Final = 10.0
_FLUSH_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class Parts:
    """What the answers are made from."""

    clock: Clock
    store: Store
    outbox: Outbox
    stream: Bus
    ingest: Ingest
    alarms: AlarmBook
    notifier: Notifier
    assets: Mapping[str, AssetRuntime]
    jobs: IdentificationJobs
    registry: CollectorRegistry
    sources: Callable[[], Sequence[SourceHealth]]
    problems: Callable[[], Mapping[str, str | None]] = dict
    apply_assets: Callable[[], Awaitable[dict[str, str]]] | None = None
    is_fleet: bool = False
    followed: Callable[[], int] = int


@dataclass(slots=True)
class _Made:
    """A document as text, and what it was made of."""

    source: object = None
    text: bytes = b""
    tag: bytes = b""


@dataclass(slots=True)
class _Process:
    """When a process last said that it is there, and how much memory it has."""

    seen_s: float = -math.inf
    resident_bytes: int = 0
    metrics: bytes = b""


@dataclass
class Answers:
    """Answers commands from what the cell has in memory.

    Parameters
    ----------
    parts : Parts
        What there is.
    """

    parts: Parts
    _made: dict[tuple[str, str], _Made] = field(default_factory=dict)
    _pushing: asyncio.Lock = field(default_factory=asyncio.Lock)
    _processes: dict[str, _Process] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._up = Gauge(
            "bearing_twin_process_up",
            "1 while a process of the service reports to the cell.",
            ["process"],
            registry=self.parts.registry,
        )
        self._memory = Gauge(
            "bearing_twin_process_resident_bytes",
            "Memory of a process of the service, workers not included, as it last reported.",
            ["process"],
            registry=self.parts.registry,
        )
        self._up.labels("cell").set(1.0)
        self._memory.labels("cell").set_function(resident_bytes)

    def handlers(self) -> Mapping[type[Command[Any]], Handler]:
        """What answers which command."""
        return {
            ask.AssetNames: self.asset_names,
            ask.ApplyAssets: self.apply_assets,
            ask.GetDocuments: self.documents,
            ask.RenewGrease: self.renew_grease,
            ask.StreamAfter: self.stream_after,
            ask.FollowStream: self.follow_stream,
            ask.TakeSamples: self.take_samples,
            ask.ListAlarms: self.list_alarms,
            ask.ListFollowedAlarms: self.list_followed_alarms,
            ask.ActOnAlarm: self.act_on_alarm,
            ask.AcknowledgeAlarms: self.acknowledge_alarms,
            ask.GetNotifications: self.get_notifications,
            ask.TestNotification: self.test_notification,
            ask.Flush: self.flush,
            ask.CreateJob: self.create_job,
            ask.GetJobs: self.get_jobs,
            ask.CancelJob: self.cancel_job,
            ask.ActivateModel: self.activate_model,
            ask.CheckHealth: self.check_health,
            ask.GetMetrics: self.get_metrics,
            ask.Present: self.present,
        }

    # ------------------------------------------------------------------ assets
    async def asset_names(self, command: ask.AssetNames) -> dict[str, int]:
        """Give the ids of all assets, and which make each is."""
        return {name: asset.make_number for name, asset in self.parts.assets.items()}

    async def apply_assets(self, command: ask.ApplyAssets) -> dict[str, str]:
        """Take up the assets that the store holds now."""
        apply = self.parts.apply_assets
        return {} if apply is None else await apply()

    async def documents(self, command: ask.GetDocuments) -> list[ask.Document]:
        """Give documents; a poll that is due comes between some of them."""
        answer = []
        for number, wanted in enumerate(command.wanted):
            if number and number % DOCUMENTS == 0:
                await asyncio.sleep(0)
            answer.append(self._document(wanted))
        return answer

    def _document(self, wanted: ask.Wanted) -> ask.Document:
        twin = self.parts.assets.get(wanted.asset)
        if twin is None:  # removed a moment ago, which who asks is about to hear
            return ask.Document(b"", None)
        asset = twin.documents
        make: Mapping[str, Callable[[], object]] = {
            "facts": asset.description,
            "summary": asset.summary,
            "snapshot": asset.snapshot,
            "state": asset.state,
            "verdict": asset.verdict,
            "forecast": asset.forecast,
            "machine": asset.machine,
            "glance": asset.glance,
        }
        # A process that has just begun asks for all there is, and knows nothing yet.
        if wanted.kind == "forecast" and wanted.tag:
            twin.look()
        source = make[wanted.kind]()
        made = self._made.setdefault((wanted.asset, wanted.kind), _Made())
        # An asset gives the same snapshot as long as nothing in it has changed.
        if made.source is not source or source is None:
            text = to_json(source, inf_nan_mode="null")
            made.text, made.tag = text, digest(text)
            # The others are made for each question, and are large.
            made.source = source if wanted.kind == "snapshot" else None
        return ask.Document(made.tag, None if made.tag == wanted.tag else made.text)

    def forget(self, assets: Collection[str]) -> None:
        """Keep no document of assets that are followed no longer."""
        gone = set(assets)
        for key in [key for key in self._made if key[0] in gone]:
            del self._made[key]

    async def renew_grease(self, command: ask.RenewGrease) -> bytes:
        """Count the revolutions of an asset's grease from zero again."""
        asset = self.parts.assets[command.asset]
        return to_json(await asset.renew_grease(command.who, command.comment, command.audit))

    # ------------------------------------------------------------------ live messages
    async def follow_stream(self, command: ask.FollowStream) -> ask.StreamMade:
        """Make the live messages of assets that somebody follows."""
        stream = self.parts.stream
        return ask.StreamMade(stream.epoch, stream.follow(command.assets))

    async def stream_after(self, command: ask.StreamAfter) -> ask.StreamPart:
        """Give the live messages after a number."""
        stream = self.parts.stream
        after = command.number if command.epoch == stream.epoch else 0
        number = stream.seq
        messages, forgotten = stream.after(after, STREAM_PART)
        return ask.StreamPart(
            number,
            forgotten,
            [ask.StreamMessage(one.seq, one.type, one.asset, one.text) for one in messages],
        )

    # ------------------------------------------------------------------ pushes
    async def take_samples(self, command: ask.TakeSamples) -> ask.Taken:
        """Take judged samples in; the answer means that they are on the disk."""
        ingest, store = self.parts.ingest, self.parts.store
        asset, received_us = command.asset, command.received_us
        if asset not in self.parts.assets:  # removed, or another cell's, since who asks looked
            raise CellUnavailableError(f"asset {asset!r} is not followed here now")
        try:
            async with self._pushing:
                if len(command.too_old):
                    too_old = await self._unpacked(command.too_old, asset, received_us)
                    ingest.refuse_too_old(too_old)
                samples = await self._unpacked(command.samples, asset, received_us)
                stored = await ingest.take_in(samples, command.patience_s)
            counts = await stored
        except StoreUnavailableError as error:
            raise PushRefusedError(str(error), ingest.retry_after_s) from error
        return ask.Taken(counts.stored, counts.duplicates, store.samples.kept_from_us)

    async def _unpacked(self, samples: ask.Samples, asset: str, received_us: int) -> list[Any]:
        unpacked: list[Any] = []
        for begin in range(0, len(samples), PORTION):
            unpacked += samples.unpack(asset, received_us, begin, begin + PORTION)
            await asyncio.sleep(0)
        return unpacked

    # ------------------------------------------------------------------ alarms
    async def list_alarms(self, command: ask.ListAlarms) -> list[Alarm]:
        """Give the alarms that are not over, or the normal ones."""
        book = self.parts.alarms
        return book.normal() if command.normal else book.active()

    async def list_followed_alarms(self, command: ask.ListFollowedAlarms) -> ask.FollowedAlarms:
        """Give the alarms, and which assets they are of."""
        alarms = await self.list_alarms(ask.ListAlarms(command.normal))
        return ask.FollowedAlarms(alarms, self.parts.followed())

    async def act_on_alarm(self, command: ask.ActOnAlarm) -> Alarm:
        """Do something to an alarm."""
        book, who, comment, audit = self.parts.alarms, command.who, command.comment, command.audit
        acts: Mapping[str, Callable[[str, str, str, AuditEntry | None], Alarm]] = {
            "acknowledge": book.acknowledge,
            "comment": book.comment,
            "reset": book.reset,
            "return_to_service": book.return_to_service,
            "take_out_of_service": book.take_out_of_service,
            "unshelve": book.unshelve,
        }
        if command.action == "shelve":
            alarm = book.shelve(command.alarm, command.duration_s, who, comment, audit)
        else:
            alarm = acts[command.action](command.alarm, who, comment, audit)
        await self._written()
        return alarm

    async def acknowledge_alarms(self, command: ask.AcknowledgeAlarms) -> ask.AcknowledgedAlarms:
        """Acknowledge several alarms."""
        book = self.parts.alarms
        alarms: list[Alarm] = []
        failed: list[tuple[str, str]] = []
        # An alarm of a source acknowledges those of its channels: each of them is taken first.
        sources = {one.id for one in book.active() if one.channel.startswith("source:")}
        for alarm_id in sorted(dict.fromkeys(command.ids), key=sources.__contains__):
            # One call, one line: written with the first change, so that none is without it.
            audit = None if alarms else command.audit
            try:
                alarms.append(book.acknowledge(alarm_id, command.who, command.comment, audit))
            except (UnknownAlarmError, NotAllowedError) as error:
                failed.append((alarm_id, str(error.args[0])))
        await self._written()
        return ask.AcknowledgedAlarms(alarms, failed)

    async def get_notifications(self, command: ask.GetNotifications) -> list[NotificationState]:
        """Say how each notification is."""
        return self.parts.notifier.states()

    async def test_notification(self, command: ask.TestNotification) -> tuple[bool, str]:
        """Send a test message."""
        return await self.parts.notifier.test(command.notification, command.who, command.audit)

    async def flush(self, command: ask.Flush) -> bool:
        """Wait until the store has every change, for a while."""
        flush = self.parts.outbox.flush
        return await to_thread.run_sync(flush, command.patience_s, abandon_on_cancel=True)

    async def _written(self) -> None:
        """Wait until a change is kept.

        Raises
        ------
        NotKeptError
            When neither the store nor the disk takes it.
        """
        outbox = self.parts.outbox
        written = await to_thread.run_sync(outbox.flush, _FLUSH_S)
        if written or not (outbox.unkept or self.parts.is_fleet):
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

    # ------------------------------------------------------------------ jobs
    async def create_job(self, command: ask.CreateJob) -> tuple[bytes, bool]:
        """Queue an identification."""
        request = IdentificationRequest.model_validate_json(command.request, strict=False)
        # Once begun it ends, whoever waits: what is queued must run.
        creating = asyncio.ensure_future(
            self.parts.jobs.create(
                command.asset, request, command.idempotency_key, command.who, command.audit
            )
        )
        job, created = await asyncio.shield(creating)
        return to_json(job, inf_nan_mode="null"), created

    async def get_jobs(self, command: ask.GetJobs) -> bytes:
        """Give one job, or all of an asset."""
        jobs = self.parts.jobs
        found: object
        if command.job is None:
            found = await jobs.jobs(command.asset)
        else:
            found = await jobs.job(command.asset, command.job)
        return to_json(found, inf_nan_mode="null")

    async def cancel_job(self, command: ask.CancelJob) -> bytes:
        """Stop a job."""
        cancelling = asyncio.ensure_future(
            self.parts.jobs.cancel(command.asset, command.job, command.audit)
        )
        job = await asyncio.shield(cancelling)
        return to_json(job, inf_nan_mode="null")

    async def activate_model(self, command: ask.ActivateModel) -> bytes:
        """Make a model version the active one."""
        # Once begun it ends, whoever waits: store and twin must agree.
        activating = asyncio.ensure_future(
            self.parts.jobs.activate(
                command.asset,
                command.version,
                command.who,
                command.comment,
                command.force,
                command.audit,
            )
        )
        return to_json(await asyncio.shield(activating), inf_nan_mode="null")

    # ------------------------------------------------------------------ health
    async def check_health(self, command: ask.CheckHealth) -> list[ask.HealthCheck]:
        """Give all checks."""
        return [
            await self._store(),
            *self._problems(),
            *self._twins(),
            *self._sources(),
            *self._others(),
        ]

    async def get_metrics(self, command: ask.GetMetrics) -> bytes:
        """Give the metrics."""
        own = await to_thread.run_sync(generate_latest, self.parts.registry)
        return own + b"".join(one.metrics for one in self._processes.values() if _is_there(one))

    async def present(self, command: ask.Present) -> bool:
        """Take note that a process is there."""
        name = command.process
        process = self._processes.get(name)
        if process is None:
            process = self._processes[name] = _Process()
            self._up.labels(name).set_function(partial(_up, process))
            self._memory.labels(name).set_function(partial(_memory, process))
        process.seen_s = time.monotonic()
        process.resident_bytes, process.metrics = command.resident_bytes, command.metrics
        return True

    async def _store(self) -> ask.HealthCheck:
        ingest = self.parts.ingest
        problem = ingest.problem
        if problem is None:  # else it was asked a moment ago
            try:
                async with asyncio.timeout(STORE_ANSWERS_S):
                    unfinished = self.parts.store.jobs.unfinished
                    await to_thread.run_sync(unfinished, abandon_on_cancel=True)
            except TimeoutError:
                problem = f"no answer within {STORE_ANSWERS_S:g} s"
            except StoreUnavailableError as error:
                problem = str(error)
        if problem is None:
            return ask.HealthCheck("store", "ok", "reads and writes")
        if ingest.spool_problem is not None:
            return ask.HealthCheck("store", "failed", f"{problem}; spool: {ingest.spool_problem}")
        waiting = f"{ingest.spooled} samples wait on the spool"
        return ask.HealthCheck("store", "degraded", f"{problem}; {waiting}")

    def _problems(self) -> list[ask.HealthCheck]:
        return [
            ask.HealthCheck(name, "degraded" if problem else "ok", problem or "as it should be")
            for name, problem in self.parts.problems().items()
        ]

    def _twins(self) -> list[ask.HealthCheck]:
        checks = []
        for asset in list(self.parts.assets.values()):
            name = f"twin:{asset.id}"
            if not asset.documents.running:
                checks.append(ask.HealthCheck(name, "failed", "the live twin is not running"))
                continue
            bad = _channels_without_good_data(asset.documents)
            if bad:
                detail = f"no good data: {', '.join(bad)}"
                checks.append(ask.HealthCheck(name, "degraded", detail))
            else:
                checks.append(ask.HealthCheck(name, "ok", "follows the machine"))
        return checks

    def _sources(self) -> list[ask.HealthCheck]:
        return [
            ask.HealthCheck(
                f"source:{health.name}", "ok" if health.up else "degraded", health.detail
            )
            for health in self.parts.sources()
        ]

    def _others(self) -> list[ask.HealthCheck]:
        return [
            ask.HealthCheck(f"process:{name}", "degraded", "does not report to the cell")
            for name, process in self._processes.items()
            if not _is_there(process)
        ]


def _is_there(process: _Process) -> bool:
    return time.monotonic() - process.seen_s < PRESENT_S


def _up(process: _Process) -> float:
    return float(_is_there(process))


def _memory(process: _Process) -> float:
    return float(process.resident_bytes)


def _channels_without_good_data(asset: AssetDocuments) -> list[str]:
    tags = asset.snapshot()["tags"]
    return sorted(
        channel
        for channel, source in asset.channels.items()
        if source != TWIN_SOURCE and channel in tags and not is_good(tags[channel]["quality"])
    )
