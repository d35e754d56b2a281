"""From the drivers to the live twins and the store."""

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace
from operator import attrgetter

import structlog
from prometheus_client import CollectorRegistry, Counter

from adapters.backoff import Backoff
from adapters.protocol import Clock, Driver
from adapters.samples import Batch, Sample, is_good
from service.domain.requests import PUSH_SOURCE
from service.ingest.gaps import Gaps
from service.ingest.metrics import SampleLedger, SourceMetrics, watch_queues
from service.ingest.quality import QualityChecks
from service.ingest.source_clocks import Call, SourceClocks
from service.ingest.spool import Spool
from service.ingest.writer import SampleWriter
from service.store import Store, StoreUnavailableError, WriteCounts

#: Wall seconds before a driver that failed is started again: first, and at most.
RESTART_FIRST_S = 1.0
RESTART_LAST_S = 30.0
#: Pushed samples that are judged in one go, and those that the twins get in one go: half a ms each.
PORTION, BATCH = 500, 200
#: Wall seconds that a store which does not answer is given when the service stops.
DRAIN_S = 5.0
_BEAT_S = 0.25
#: Wall seconds after which a driver gives way to the one that replaces it in any case.
REPLACED_AFTER_S = 3.0
_LOOK_S = 0.02
_CANCEL_AGAIN_S = 1.0
#: Wall seconds after which a refused push may come again: after one refusal, and at most.
RETRY_PUSH_S = 5.0
RETRY_PUSH_LAST_S = 60.0

_log = structlog.get_logger(__name__)


class Ingest:
    """Takes samples from everywhere, hands them to the live twins and stores them.

    Storing happens in a thread of its own behind a bounded queue, so a slow disk delays neither
    the drivers nor the twins. While the store is away samples wait in the spool on the disk.
    Every accepted sample is accounted for, see `counts`.

    - ``on_batch``: gets every batch of a driver, and pushed samples as a batch, in the event loop.
      It must return quickly; what it raises is logged and does not hold up the samples.
    - ``checks``: what every sample from outside must stand to be taken for good.
    - ``clocks``: whose samples came from the future.
    """

    def __init__(
        self,
        store: Store | None,
        spool: Spool,
        clock: Clock,
        on_batch: Callable[[Batch], None],
        *,
        registry: CollectorRegistry,
        checks: QualityChecks | None = None,
    ) -> None:
        self._store = store
        self._checks = checks or QualityChecks({}, registry)
        self._clock = clock
        self._ahead = Counter(
            "bearing_twin_samples_ahead",
            "Samples that are uncertain, as the clock of their source is ahead.",
            registry=registry,
        )
        self.clocks = SourceClocks(clock.rate, self._ahead.inc)
        self._on_batch = on_batch
        self._ledger = SampleLedger(registry)
        self._source_metrics = SourceMetrics(registry)
        self._writer = SampleWriter(None, spool, self._ledger)
        watch_queues(lambda: self._writer.queued, spool, clock, registry)
        self._accepting = asyncio.Lock()
        self._push_backoff = Backoff(RETRY_PUSH_S, RETRY_PUSH_LAST_S)
        self._retry_after_s = RETRY_PUSH_S
        self._went_on = False
        self._pumps: dict[str, asyncio.Task[None]] = {}
        # Drivers that replace one which still reads.
        self._beginning: set[Driver] = set()
        self._gaps = Gaps(spool.newest())

    @property
    def problem(self) -> str | None:
        """Why the store takes no samples at the moment; None while all is well."""
        return self._writer.problem

    @property
    def spool_problem(self) -> str | None:
        """Why the spool takes none either while the store is away; None while all is well."""
        return self._writer.spool_problem

    @property
    def too_old_problem(self) -> str | None:
        """Which samples were recently too old to be stored; None when there were none."""
        return self._writer.too_old.problem

    def too_old(self, asset: str) -> str | None:
        """As `too_old_problem`, of one asset; "" when it is over, None when it never was."""
        return self._writer.too_old.of(asset)

    @property
    def spooled(self) -> int:
        """Samples that wait in the spool."""
        return self._writer.spooled

    def counts(self) -> Mapping[str, int]:
        """Count the samples accepted, and of those the stored, duplicate, skipped and waiting."""
        return self._ledger.counts()

    async def run(self, drivers: Sequence[Driver]) -> None:
        """Pump every driver until cancelled; then stop them and store everything accepted.

        A driver that fails is logged and entered again after a growing wait; it must allow that.
        May be empty when samples are only pushed.
        """
        if self._store is not None:
            self.attach(self._store, await asyncio.to_thread(self._store.samples.open_ends))
        self._writer.start()
        try:
            async with asyncio.TaskGroup() as self._group:
                for driver in drivers:
                    self._start(driver)
                while True:  # the group ends when it is cancelled
                    self._went_on = self._writer.is_running
                    await asyncio.sleep(_BEAT_S)
        finally:
            await asyncio.to_thread(self._writer.close, DRAIN_S)

    def _start(self, driver: Driver) -> None:
        self._source_metrics.watch(driver)
        self._pumps[driver.name] = self._group.create_task(
            self._pump(driver), name=f"source {driver.name}"
        )

    async def replace(self, name: str, driver: Driver | None) -> None:
        """Pump another driver of a source, or none any more, while `run` runs.

        The new one reads before the old one ends, so that no poll is missing; a device that takes
        one connection only gets that of the new one a moment later. Until then what the new one
        cannot read is no loss: the old one reads it.
        """
        old = self._pumps.pop(name, None)
        if driver is None:
            self._source_metrics.forget(name)
        else:
            if old is not None:
                self._beginning.add(driver)
            self._start(driver)
            if old is not None:
                await _until_read(driver)
        # A library may swallow a cancellation: two drivers of one source store everything twice.
        while old is not None and not old.done():
            old.cancel()
            await asyncio.wait({old}, timeout=_CANCEL_AGAIN_S)
        if driver is not None:
            self._beginning.discard(driver)

    @property
    def retry_after_s(self) -> int:
        """Wall seconds after which a refused push may be sent again; grows while all are."""
        return int(self._retry_after_s)

    async def accept(self, samples: Sequence[Sample]) -> WriteCounts:
        """Take pushed samples: the live twins get them, and they are on the disk at the end.

        Sending the same again is harmless. Raises `StoreUnavailableError` if none of them was
        stored, or is going to be; send them again later.
        """
        # The checks compare each sample with the one before; a gateway may send them in any order.
        return await (await self.take_in(sorted(samples, key=attrgetter("time_us"))))

    async def take_in(
        self, samples: Sequence[Sample], patience_s: float = math.inf
    ) -> Awaitable[WriteCounts]:
        """Take pushed samples: the live twins have them, and they are on their way to the store.

        Those of a channel come in the order of their times.
        ``patience_s``: wall seconds that they may wait for their turn; once they are being written
        the end of that is waited for. The awaitable is done when they are on the disk; it fails as
        `accept` does.
        """
        if not samples:
            return _nothing()
        judged: list[Sample] = []
        call = Call(self.clocks, PUSH_SOURCE)
        async with self._accepting:
            # In portions: a poll that is due meanwhile comes between two of them.
            for some in _portions(samples):
                call.look(some)
                await asyncio.sleep(0)
            for some in _portions(samples if call.is_odd else ()):
                call.collect(some)
                await asyncio.sleep(0)
            for some in _portions(samples):
                judged += self._checks.judge(call.put_right(some))
                await asyncio.sleep(0)
            try:
                written = self._writer.put_with_result(judged)
            except StoreUnavailableError:
                self._retry_after_s = self._push_backoff.next()
                raise
            stored = asyncio.ensure_future(self._await(written, patience_s))
            # No one may be there any more to hear that it failed.
            stored.add_done_callback(lambda done: done.cancelled() or done.exception())
            # What is stored reaches the twins, also when the caller has gone meanwhile.
            await asyncio.shield(asyncio.ensure_future(self._hand_over_portions(judged)))
        return asyncio.shield(stored)

    async def _await(self, written: "Future[WriteCounts]", patience_s: float) -> WriteCounts:
        """Wait until samples are on the disk; while their turn has not come they are taken back."""
        ends = asyncio.wrap_future(written)
        await asyncio.wait({ends}, timeout=None if math.isinf(patience_s) else patience_s)
        try:
            if not ends.done() and self._writer.withdraw(written):
                raise StoreUnavailableError(f"their turn did not come within {patience_s:g} s")
            counts = await ends
        except StoreUnavailableError:
            self._retry_after_s = self._push_backoff.next()
            raise
        self._push_backoff.reset()
        self._retry_after_s = RETRY_PUSH_S
        return counts

    async def _hand_over_portions(self, samples: Sequence[Sample]) -> None:
        for begin in range(0, len(samples), BATCH):
            self._hand_over(Batch(list(samples[begin : begin + BATCH])))
            await asyncio.sleep(0)

    def has_gone_on(self) -> bool:
        """Whether pumping and writing have gone on since this was asked last."""
        went_on, self._went_on = self._went_on, False
        return went_on

    def refuse_too_old(self, samples: Sequence[Sample]) -> None:
        """Count and report samples from before the time from which the store keeps them."""
        self._writer.refuse_too_old(samples)

    def submit(self, samples: Sequence[Sample]) -> None:
        """Have the twins' own samples stored; returns at once."""
        if samples:
            self._writer.put(samples)

    def attach(self, store: Store, ends: Mapping[tuple[str, str], int]) -> None:
        """Store samples from now on, those on the spool first.

        ``ends``: its `open_ends`, read before anything of this run is stored.
        """
        self.submit(self._gaps.closed_by_store(ends, self._clock.now_us()))
        self._writer.attach(store)

    def expect(self, ends: Mapping[tuple[str, str], int]) -> None:
        """Mark the gap behind these last times of channels when their next samples come."""
        self._gaps.expect(ends)

    def expect_no_more(self, assets: Collection[str] | None = None) -> None:
        """Mark no gaps of these assets, or of any: somebody else reads them."""
        self._gaps.forget(assets)

    async def _pump(self, driver: Driver) -> None:
        backoff = Backoff(RESTART_FIRST_S, RESTART_LAST_S)
        poll_seconds = self._source_metrics.poll_seconds.labels(driver.name)
        while True:
            try:
                async with driver:
                    async for batch in driver.batches():
                        backoff.reset()
                        if driver in self._beginning and not _has_good(batch):
                            continue
                        if batch.poll_s is not None:
                            poll_seconds.observe(batch.poll_s)
                        self._take(batch, driver.name)
                _log.warning("source_ended", source=driver.name, restart_in_s=backoff.wait_s)
            except Exception:
                # Whatever a driver stumbles over must not end the other sources, nor itself.
                _log.exception("source_failed", source=driver.name, restart_in_s=backoff.wait_s)
            await asyncio.sleep(backoff.next())

    def _take(self, batch: Batch, source: str) -> None:
        if batch.samples:
            timed = self.clocks.put_right(batch.samples, source)
            if self._gaps.may_close:
                self.submit(self._gaps.closed_by(timed, self._clock.now_us()))
            judged = self._checks.judge(timed)
            if judged is not batch.samples:
                batch = replace(batch, samples=list(judged))
            self._writer.put(batch.samples)
        self._hand_over(batch)

    def _hand_over(self, batch: Batch) -> None:
        try:
            self._on_batch(batch)
        except Exception:
            # A fault in a twin must not cost the samples that the next poll would bring.
            _log.exception("batch_not_taken", samples=len(batch.samples), plans=len(batch.plans))


def _portions(samples: Sequence[Sample]) -> Iterator[Sequence[Sample]]:
    return (samples[begin : begin + PORTION] for begin in range(0, len(samples), PORTION))


def _has_good(batch: Batch) -> bool:
    return any(is_good(sample.quality) for sample in batch.samples)


async def _until_read(driver: Driver) -> None:
    """Wait until a driver has read something good, for a while."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(REPLACED_AFTER_S):
            while True:
                await asyncio.sleep(_LOOK_S)
                if driver.health().last_good_us is not None:
                    return


async def _nothing() -> WriteCounts:
    return WriteCounts(0, 0)
