"""What works before the store is there: drivers, checks and the queue in front of the store."""

import math
import time
from collections.abc import Callable, Mapping

from prometheus_client import CollectorRegistry

from adapters.protocol import Clock, Driver, SourceHealth
from adapters.samples import Batch, PlannedProfile, Sample
from service.ingest import Ingest, QualityChecks, Spool
from service.site.wiring import Wiring

#: Wall seconds for which the word of a source on its channels holds.
ASK_AGAIN_S = 0.1


class Acquisition:
    """Reads all sources; until the store is attached to `ingest`, samples go on the spool.

    Parameters
    ----------
    wiring : Wiring
        The configuration's sources and channels, from `service.site.wiring.wire`.
    clock : Clock
        Process time.
    spool : Spool
        Where samples wait.

    Attributes
    ----------
    registry : prometheus_client.CollectorRegistry
        Its metrics.
    checks : QualityChecks
        What every sample must stand to be taken for good.
    ingest : Ingest
        The way of all samples to the store.
    drivers : list of Driver
        One for each source.
    spool : Spool
        Where samples wait.
    """

    def __init__(self, wiring: Wiring, clock: Clock, spool: Spool) -> None:
        self.registry = CollectorRegistry()
        self.spool = spool
        self.checks = QualityChecks(wiring.check_limits, self.registry)
        self.ingest = Ingest(
            None, spool, clock, self._hand_on, registry=self.registry, checks=self.checks
        )
        self.drivers: list[Driver] = [source.create(clock) for source in wiring.sources]
        self._by_name = {driver.name: driver for driver in self.drivers}
        self._problems: dict[str, tuple[float, Mapping[str, str]]] = {}
        self._take: Callable[[Batch], None] | None = None
        # What the twins begin with, bounded by the number of channels.
        self._samples: dict[tuple[str, str], Sample] = {}
        self._plans: dict[str, PlannedProfile] = {}

    def hand_to(self, take: Callable[[Batch], None]) -> None:
        """Give every batch to the twins from now on, and first the newest of each channel."""
        samples = sorted(self._samples.values(), key=lambda sample: sample.time_us)
        take(Batch(samples, list(self._plans.values())))
        self._samples, self._plans = {}, {}
        self._take = take

    def health(self) -> list[SourceHealth]:
        """Health of every source, from memory."""
        return [driver.health() for driver in self.drivers]

    def problem(self, source: str, asset: str, channel: str) -> str:
        """Why a channel's latest sample is not good, as its source says; empty where it is.

        A source is asked ten times a second at most: whoever shows a thousand bad channels asks
        for each of them.
        """
        driver = self._by_name.get(source)
        if driver is None:
            return ""
        now_s = time.monotonic()
        asked_s, problems = self._problems.get(source, (-math.inf, {}))
        if now_s - asked_s > ASK_AGAIN_S:
            problems = driver.health().problems
            self._problems[source] = now_s, problems
        return problems.get(f"{asset}/{channel}", "")

    def _hand_on(self, batch: Batch) -> None:
        if self._take is not None:
            self._take(batch)
            return
        for sample in batch.samples:
            self._samples[sample.asset, sample.channel] = sample
        for plan in batch.plans:
            self._plans[plan.asset] = plan
