"""The cell as the web side sees it: everything that it must be asked over the bus."""

import asyncio
from collections.abc import Sequence
from typing import Any, Final

from cachetools import TTLCache
from pydantic import TypeAdapter

from adapters.samples import Sample
from service.bus import commands as ask
from service.bus.interface import ReaderBus
from service.bus.messages import AnswerT, Command
from service.documents.identification import JobDocument
from service.documents.models import ModelDocument
from service.domain.errors import CellUnavailableError
from service.domain.requests import IdentificationRequest
from service.notifications.states import NotificationState
from service.store import Alarm, AuditEntry, WriteCounts

#: Wall seconds for what is in memory, for what is written, and for what may take a while.
SOON_S: Final = 2.0
WRITTEN_S: Final = 15.0
WHILE_S: Final = 60.0
#: Wall seconds for which an answer is given to all who ask the same.
SHARED_S: Final = 0.1
#: So many answers are kept.
MOST_SHARED: Final = 256
_JOB: Final[TypeAdapter[JobDocument | None]] = TypeAdapter(JobDocument | None)
_JOBS: Final = TypeAdapter(list[JobDocument])


class Shared:
    """Answers that many callers want at the same time: each is asked for once."""

    def __init__(self, reader: ReaderBus, fresh_s: float = SHARED_S) -> None:
        self._reader = reader
        self._known: TTLCache[Command[Any], Any] = TTLCache(MOST_SHARED, fresh_s)
        self._asking: dict[Command[Any], asyncio.Task[Any]] = {}

    def forget(self) -> None:
        """Give nobody an answer from before this moment: a caller has changed something."""
        self._known.clear()
        # Who asks from now on does not wait for questions that are under way.
        self._asking = {}

    async def ask(self, command: Command[AnswerT], patience_s: float = SOON_S) -> AnswerT:
        """Give the answer to a command that changes nothing."""
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


class CellAlarms:
    """The alarm book of the cell; what is done is on the disk when a method returns."""

    def __init__(self, reader: ReaderBus, shared: Shared) -> None:
        self._reader = reader
        self._shared = shared

    async def active(self, asset: str | None = None) -> list[Alarm]:
        """All alarms that are not over, of one asset or of all."""
        alarms = await self._shared.ask(ask.ListAlarms())
        return [one for one in alarms if asset is None or one.asset == asset]

    async def normal(self, asset: str | None = None) -> list[Alarm]:
        """All alarms that are normal."""
        alarms = await self._shared.ask(ask.ListAlarms(normal=True))
        return [one for one in alarms if asset is None or one.asset == asset]

    async def act(
        self,
        alarm_id: str,
        action: ask.AlarmAction,
        who: str,
        comment: str,
        duration_s: float = 0.0,
        audit: AuditEntry | None = None,
    ) -> Alarm:
        """Do something to an alarm; the line of the audit trail is written with it.

        Raises
        ------
        UnknownAlarmError
            If there is no alarm of this id.
        NotAllowedError
            If the alarm's state does not allow it.
        NotKeptError
            If neither the store nor the disk takes the change.
        """
        command = ask.ActOnAlarm(alarm_id, action, who, comment, duration_s, audit)
        return await self._reader.ask(command, WRITTEN_S)

    async def acknowledge(
        self, ids: Sequence[str], who: str, comment: str, audit: AuditEntry | None = None
    ) -> ask.AcknowledgedAlarms:
        """Acknowledge several alarms."""
        command = ask.AcknowledgeAlarms(list(ids), who, comment, audit)
        return await self._reader.ask(command, WRITTEN_S)

    async def flush(self, patience_s: float) -> None:
        """Have the store take all changes, for a while; one that is away is not waited for."""
        try:
            await self._reader.ask(ask.Flush(patience_s), patience_s + SOON_S)
        except CellUnavailableError:
            return  # then the store has what it has


class CellNotifications:
    """The notifications of the cell."""

    def __init__(self, reader: ReaderBus, shared: Shared) -> None:
        self._reader = reader
        self._shared = shared

    async def states(self) -> dict[str, NotificationState]:
        """How each notification is, by its id."""
        found = await self._shared.ask(ask.GetNotifications())
        return {state.id: state for state in found}

    async def test(
        self, notification: str, who: str, audit: AuditEntry | None = None
    ) -> tuple[bool, str]:
        """Send a test message; gives whether it was taken, and why not or by whom not."""
        return await self._reader.ask(ask.TestNotification(notification, who, audit), WHILE_S)


class CellIngest:
    """The way of pushed samples into the cell.

    Attributes
    ----------
    kept_from_us : int
        The store takes no samples from before this time, as far as is known here.
    """

    def __init__(self, reader: ReaderBus, kept_from_us: int = 0) -> None:
        self._reader = reader
        self.kept_from_us = kept_from_us

    async def accept(
        self,
        asset: str,
        samples: Sequence[Sample],
        too_old: Sequence[Sample],
        received_us: int,
        patience_s: float,
    ) -> WriteCounts:
        """Take judged samples of an asset in; at the end they are on the disk.

        Sending the same again is harmless.

        Raises
        ------
        PushRefusedError
            If none of them was stored.
        CellUnavailableError
            If the cell does not answer: they may have been stored or not.
        """
        taken = await self._reader.ask(
            ask.TakeSamples(
                asset,
                received_us,
                patience_s,
                ask.Samples.pack(samples),
                ask.Samples.pack(too_old),
            ),
            patience_s + WRITTEN_S,
        )
        self.kept_from_us = taken.kept_from_us
        return WriteCounts(taken.stored, taken.duplicates)


class CellJobs:
    """The jobs of the cell; see `service.jobs.manager.IdentificationJobs`."""

    def __init__(self, reader: ReaderBus, shared: Shared) -> None:
        self._reader = reader
        self._shared = shared

    async def create(
        self,
        asset_id: str,
        request: IdentificationRequest,
        idempotency_key: str | None,
        who: str,
        audit: AuditEntry | None = None,
    ) -> tuple[JobDocument, bool]:
        """Queue a job."""
        text = request.model_dump_json().encode()
        command = ask.CreateJob(asset_id, text, idempotency_key, who, audit)
        job, created = await self._reader.ask(command, WHILE_S)
        return JobDocument.model_validate_json(job), created

    async def job(self, asset_id: str, job_id: str) -> JobDocument | None:
        """Return one job."""
        text = await self._shared.ask(ask.GetJobs(asset_id, job_id), WRITTEN_S)
        return _JOB.validate_json(text)

    async def jobs(self, asset_id: str) -> Sequence[JobDocument]:
        """Return the jobs of an asset."""
        text = await self._shared.ask(ask.GetJobs(asset_id), WRITTEN_S)
        return _JOBS.validate_json(text)

    async def cancel(
        self, asset_id: str, job_id: str, audit: AuditEntry | None = None
    ) -> JobDocument | None:
        """Stop a job."""
        text = await self._reader.ask(ask.CancelJob(asset_id, job_id, audit), WHILE_S)
        return _JOB.validate_json(text)

    async def activate(
        self,
        asset_id: str,
        version: int,
        who: str,
        comment: str | None,
        force: bool,
        audit: AuditEntry | None = None,
    ) -> ModelDocument:
        """Make a model version the active one."""
        command = ask.ActivateModel(asset_id, version, who, comment, force, audit)
        text = await self._reader.ask(command, WHILE_S)
        return ModelDocument.model_validate_json(text)


class CellHealth:
    """What the cell says of itself, for probes and metrics."""

    def __init__(self, shared: Shared) -> None:
        self._shared = shared

    async def checks(self) -> list[ask.HealthCheck]:
        """All checks; one that failed where the cell does not answer."""
        try:
            return await self._shared.ask(ask.CheckHealth())
        except CellUnavailableError as error:
            return [ask.HealthCheck("cell", "failed", str(error))]

    async def metrics(self) -> bytes:
        """The cell's metrics; empty where it does not answer."""
        try:
            return await self._shared.ask(ask.GetMetrics())
        except CellUnavailableError:
            return b""
