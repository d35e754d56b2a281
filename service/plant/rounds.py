"""Runs one publisher: opens it, gives it what changes, and opens it again when it is lost."""

import asyncio
import contextlib
import json
import math
import time
from collections.abc import Collection, Mapping
from datetime import UTC, datetime
from functools import partial
from typing import Final

import structlog
from prometheus_client import CollectorRegistry, Gauge

from adapters.backoff import Backoff
from adapters.samples import Quality
from service.bus.replica import AssetReplica
from service.bus.stream import LiveMessages
from service.bus.subscription import Message, Subscription, SubscriptionClosedError
from service.clock import rfc3339
from service.domain.channels import unit_of
from service.domain.errors import CellUnavailableError
from service.live.guard import Guard
from service.plant.kept_tags import KeptTags
from service.plant.protocol import Certified, Host, Keeping, Publisher, TagValue
from service.plant.publishers import enabled
from service.site.settings import Settings

#: Wall seconds between two rounds.
REOPEN_FIRST_S = 1.0
REOPEN_LAST_S = 30.0
#: Days before the end of a certificate from which on it is announced.
CERTIFICATE_NOTICE_DAYS: Final = 60.0
DAY_S: Final = 86_400.0
#: Alarms that wait for a publisher that is away.
_ALARMS_KEPT = 4096

_log = structlog.get_logger(__name__)


class PublisherRounds:
    """One publisher and its rounds; see `Publisher` for what is promised to it.

    - ``period_s``: wall seconds between two looks for changed tags.
    - ``failure``: why it hands nothing on, or not everything; None while it does.
    - ``begun``: set once all tags have been handed on for the first time.
    """

    def __init__(
        self,
        name: str,
        publisher: Publisher,
        period_s: float,
        assets: Mapping[str, AssetReplica],
        bus: LiveMessages,
        host: Host,
    ) -> None:
        self.name = name
        self.failure: str | None = "not opened yet"
        self.begun = asyncio.Event()
        self.publisher = publisher
        self._period_s = period_s
        self._assets = assets
        self._bus = bus
        self._host = host
        self._guards: dict[str, Guard] = {}
        self._closing = Guard(f"{name}_close", "")
        # What was handed on last, also in earlier rounds; None where that has not been taken, or
        # was handed on by an earlier process.
        self._known: dict[str, dict[str, TagValue | None]] = {}
        self._kept = (
            KeptTags(host.data_dir / name, name, publisher.receiver)
            if isinstance(publisher, Keeping)
            else None
        )
        self._alarms: Subscription | None = None
        self._unsent: Message | None = None
        self._publishing = asyncio.Lock()
        self._announce_s = time.monotonic()

    def certificate_days(self) -> float | None:
        """Days until the publisher's certificate ends; None where it has none."""
        publisher = self.publisher
        ends_at = publisher.certificate_ends_at() if isinstance(publisher, Certified) else None
        return None if ends_at is None else (ends_at - datetime.now(UTC)).total_seconds() / DAY_S

    @property
    def problem(self) -> str | None:
        """Its failure, or what should be done before there is one; None while all is well."""
        return self.failure or self._notice()

    def _notice(self) -> str | None:
        days = self.certificate_days()
        if days is None or days > CERTIFICATE_NOTICE_DAYS:
            return None
        when = f"ends in {math.ceil(days)} days" if days > 0 else "has ended"
        return f"its certificate {when}: clients that check it end their connection then"

    async def run(self) -> None:
        """Publish until cancelled; open again, ever more slowly, whenever that fails."""
        self._alarms = self._subscribe()
        backoff = Backoff(REOPEN_FIRST_S, REOPEN_LAST_S)
        away = False
        while True:
            try:
                await self.publisher.open(self._host)
                await self._learn_kept()
                self._known = {asset: dict.fromkeys(tags) for asset, tags in self._known.items()}
                await self._note_all()
                await self.publish_tags()
                self.begun.set()
                backoff.reset()
                away = False
                async with asyncio.TaskGroup() as tasks:
                    tasks.create_task(self._run_publisher())
                    tasks.create_task(self._repeat_tags())
                    tasks.create_task(self._publish_alarms())
            except* Exception as group:
                # Whatever it was that the round ended with: the service goes on.
                self.failure = _reason(group)
                if not away:
                    _log.warning(f"{self.name}_away", reason=self.failure)
                away = True
            finally:
                with self._closing():
                    await self.publisher.close()
            await asyncio.sleep(backoff.next())

    async def publish_tags(self) -> None:
        """Hand on once what has changed since the last time, and take back what is gone.

        One look at a time: a second one waits for the first.
        """
        async with self._publishing:
            await self._learn_kept()
            await self._publish_changes()

    async def _learn_kept(self) -> None:
        """Take over what an earlier process has handed on, as soon as that can be read."""
        if self._kept is None or self._kept.is_read:
            return
        for asset, tags in (await self._kept.read()).items():
            self._known[asset] = dict.fromkeys(tags) | self._known.get(asset, {})

    async def _note_all(self) -> None:
        """Note the tags of all assets at once: one by one, thousands take long."""
        if self._kept is not None:
            shown = {asset: self._tags(asset, twin) for asset, twin in list(self._assets.items())}
            await self._kept.add({asset: tags for asset, tags in shown.items() if tags})

    async def _publish_changes(self) -> None:
        refused = 0
        # A copy: assets come and go while the publisher takes its time.
        for asset, twin in list(self._assets.items()):
            tags = self._tags(asset, twin)
            if tags is None:
                refused += await self._publish_waiting(asset)
                continue
            refused += await self._publish(asset, tags)
            await self._withdraw(asset, self._known[asset].keys() - tags.keys())
        for asset in self._known.keys() - self._assets.keys():
            if self._host.is_known(asset):
                refused += await self._publish_waiting(asset)
                continue
            await self._withdraw(asset, list(self._known[asset]))
            del self._known[asset]
            self._guards.pop(asset, None)
        self.failure = f"{refused} tags refused" if refused else None

    def _tags(self, asset: str, twin: AssetReplica) -> Mapping[str, TagValue] | None:
        guard = self._guards.setdefault(asset, Guard(f"{self.name}_tags", asset))
        tags: Mapping[str, TagValue] | None = None
        # An asset may be so new that its first snapshot is still under way.
        with guard(), contextlib.suppress(CellUnavailableError):
            tags = twin.snapshot()["tags"]
        return tags

    async def _publish(self, asset: str, tags: Mapping[str, TagValue]) -> int:
        """Hand on what has changed; returns how many tags were refused."""
        known = self._known.setdefault(asset, {})
        changed = {tag: shown for tag, shown in tags.items() if known.get(tag) != shown}
        if not changed:
            return 0
        if self._kept is not None:
            await self._kept.add({asset: changed})
        # Should the round end now, some may have been taken.
        known |= dict.fromkeys(changed)
        left = await self.publisher.publish_tags(asset, changed)
        known |= {tag: shown for tag, shown in changed.items() if tag not in left}
        return len(left)

    async def _publish_waiting(self, asset: str) -> int:
        """Show no value for what only earlier rounds have handed on, of an asset without an answer.

        It may be long gone, or have changed; returns how many tags were refused.
        """
        known = self._known.get(asset, {})
        waiting = Quality.WAITING_FOR_INITIAL_DATA
        tags = {tag: self._valueless(tag, waiting) for tag, shown in known.items() if shown is None}
        return await self._publish(asset, tags)

    async def _withdraw(self, asset: str, gone: Collection[str]) -> None:
        """Take tags back: a client that follows one sees first that it has no value any more."""
        if not gone:
            return
        known = self._known[asset]
        last = {tag: self._valueless(tag, Quality.OUT_OF_SERVICE, known[tag]) for tag in gone}
        await self.publisher.publish_tags(asset, last)
        await self.publisher.withdraw_tags(asset, gone)
        if self._kept is not None:
            await self._kept.remove(asset, gone)
        for tag in gone:
            del known[tag]

    def _valueless(self, tag: str, quality: Quality, last: TagValue | None = None) -> TagValue:
        """A tag without a value, of the time of its last one where that is known."""
        if last is not None:
            return {**last, "value": None, "quality": int(quality)}
        now = rfc3339(self._host.now_us())
        return {"value": None, "unit": unit_of(tag), "quality": int(quality), "time": now}

    async def _run_publisher(self) -> None:
        await self.publisher.run()
        raise ConnectionError("it has ended")

    async def _repeat_tags(self) -> None:
        while True:
            self._announce_certificate()
            await asyncio.sleep(self._period_s)
            await self.publish_tags()

    def _announce_certificate(self) -> None:
        """Write a line a day while the end of the certificate is near."""
        now_s = time.monotonic()
        if now_s < self._announce_s:
            return
        self._announce_s = now_s + DAY_S
        notice = self._notice()
        if notice is not None:
            _log.warning(f"{self.name}_certificate_ends", reason=notice)

    async def _publish_alarms(self) -> None:
        while True:
            if self._unsent is None:
                self._unsent = await self._next_alarm()
            alarm = json.loads(self._unsent.text)["data"]
            await self.publisher.publish_alarm(self._unsent.asset, alarm)
            self._unsent = None

    async def _next_alarm(self) -> Message:
        while True:
            if self._alarms is None:
                self._alarms = self._subscribe()
            try:
                return await self._alarms.get()
            except SubscriptionClosedError as error:
                if self._bus.closed:
                    await asyncio.Event().wait()  # the service stops, and this task with it
                _log.warning(f"{self.name}_alarms_lost", reason=str(error))
                self._alarms = None

    def _subscribe(self) -> Subscription:
        return self._bus.subscribe(types={"alarm"}, capacity=_ALARMS_KEPT)


def _reason(error: BaseException) -> str:
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return str(error) or type(error).__name__


def make_publishers(
    settings: Settings,
    assets: Mapping[str, AssetReplica],
    bus: LiveMessages,
    host: Host,
    registry: CollectorRegistry,
) -> list[PublisherRounds]:
    """Make what is enabled, each to be run next to the service."""
    publishers = [
        PublisherRounds(entry.name, entry.make(settings), entry.period_s, assets, bus, host)
        for entry in enabled(settings)
    ]
    days = Gauge(
        "bearing_twin_publisher_certificate_days",
        "Days until the certificate that a publisher shows its clients ends.",
        ["publisher"],
        registry=registry,
    )
    for one in publishers:
        if isinstance(one.publisher, Certified):
            days.labels(one.name).set_function(partial(_certificate_days, one))
    up = Gauge(
        "bearing_twin_publisher_up",
        "Whether a publisher has its connection, or listens, and hands everything on.",
        ["publisher"],
        registry=registry,
    )
    for one in publishers:
        up.labels(one.name).set_function(partial(_is_up, one))
    return publishers


def _certificate_days(publisher: PublisherRounds) -> float:
    days = publisher.certificate_days()
    return math.nan if days is None else days


def _is_up(publisher: PublisherRounds) -> float:
    return float(publisher.failure is None)
