"""What works before the store is there: drivers, checks and the queue in front of the store."""

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from operator import itemgetter
from types import MappingProxyType

import structlog
from anyio import to_thread
from prometheus_client import CollectorRegistry

from adapters.protocol import Clock, Driver, SourceHealth
from adapters.samples import Batch, PlannedProfile, Sample
from adapters.times import clock_ahead
from service.domain.requests import PUSH_SOURCE
from service.ingest import Ingest, QualityChecks, Spool
from service.site.check_limits import CheckLimits
from service.site.wiring import SourceWiring, Wiring, with_assets

#: Wall seconds for which the word of a source on its channels holds.
ASK_AGAIN_S = 0.1

_log = structlog.get_logger(__name__)


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
    others : mapping of str to Wiring, optional
        What is read for assets that are not in the configuration file.

    Attributes
    ----------
    registry : prometheus_client.CollectorRegistry
        Its metrics.
    checks : QualityChecks
        What every sample must stand to be taken for good.
    ingest : Ingest
        The way of all samples to the store.
    spool : Spool
        Where samples wait.
    refused : dict of str to str
        Sources that could not be changed as the assets ask, and why.
    """

    def __init__(
        self,
        wiring: Wiring,
        clock: Clock,
        spool: Spool,
        others: Mapping[str, Wiring] = MappingProxyType({}),
    ) -> None:
        self.registry = CollectorRegistry()
        self.spool = spool
        self.checks = QualityChecks(wiring.check_limits, self.registry)
        for asset, one in others.items():
            self.checks.set_limits(asset, _limits(asset, one))
        self.ingest = Ingest(
            None, spool, clock, self._hand_on, registry=self.registry, checks=self.checks
        )
        self._clock = clock
        of_file = {source.name: source for source in wiring.sources}
        self._others = set(others)
        self.refused: dict[str, str] = {}
        self._sources: dict[str, SourceWiring] = {}
        self._by_name: dict[str, Driver] = {}
        for name, wanted in with_assets(of_file, others).items():
            source, driver = wanted, self._created(wanted)
            if driver is None and name in of_file:
                source = of_file[name]
                driver = source.create(clock)
            if driver is not None:
                self._sources[name], self._by_name[name] = source, driver
        self._changing = asyncio.Lock()
        self._said: dict[str, tuple[float, SourceHealth]] = {}
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

    @property
    def drivers(self) -> list[Driver]:
        """One for each source that something is read from."""
        return list(self._by_name.values())

    async def read_for(self, assets: Mapping[str, Wiring | None]) -> None:
        """Read for exactly these assets besides those of the configuration file."""
        gone: dict[str, Wiring | None] = dict.fromkeys(self._others)
        await self.change(gone | dict(assets))

    async def change(self, assets: Mapping[str, Wiring | None]) -> None:
        """Read other channels of some assets while all others are read on.

        Parameters
        ----------
        assets
            What is read for each of them from now on; None: nothing.
        """
        async with self._changing:
            for asset, wiring in assets.items():
                self.checks.set_limits(asset, _limits(asset, wiring))
                if wiring is None:
                    self._others.discard(asset)
                else:
                    self._others.add(asset)
            wanted = with_assets(self._sources, assets)
            changed = [
                name
                for name in self._sources.keys() | wanted.keys()
                if wanted.get(name) is not self._sources.get(name)
            ]
            for name in self.refused.keys() - changed:
                del self.refused[name]
            # Side by side: one that does not answer holds up no other.
            await asyncio.gather(*(self._change(name, wanted.get(name)) for name in changed))
            # Also what a driver that ended meanwhile has sent last.
            for asset in assets:
                self.ingest.clocks.forget(asset)

    def _created(self, source: SourceWiring) -> Driver | None:
        """Make the driver of a source; None where it cannot be, which is noted.

        Each channel is right alone, but two may not go together, or a file may be gone. What
        is read is read on then, and the next change tries again.
        """
        try:
            return source.create(self._clock)
        except Exception as error:
            if source.name not in self.refused:
                _log.exception("source_not_changed", source=source.name)
            self.refused[source.name] = " ".join(str(error).split())
            return None

    async def _change(self, name: str, source: SourceWiring | None) -> None:
        driver = None if source is None else await to_thread.run_sync(self._created, source)
        if source is not None and driver is None:
            return
        self.refused.pop(name, None)
        await self.ingest.replace(name, driver)
        self._said.pop(name, None)
        if source is None or driver is None:
            self._by_name.pop(name, None)
            self._sources.pop(name, None)
        else:
            self._by_name[name] = driver
            self._sources[name] = source

    def health(self) -> list[SourceHealth]:
        """Health of every source, from memory; of pushes only while a clock of theirs is ahead."""
        found = [driver.health() for driver in self.drivers]
        ahead_s = self.ingest.clocks.by_source(self._clock.now_us())
        if not ahead_s:
            return found
        if PUSH_SOURCE in ahead_s:
            found.append(SourceHealth(PUSH_SOURCE, PUSH_SOURCE, up=True, detail="ok"))
        return [_with_clocks(one, ahead_s.get(one.name, {})) for one in found]

    def problem(self, source: str, asset: str, channel: str) -> str:
        """Why a channel's latest sample is not good, as its source says; empty where it is."""
        said = self._says(source)
        return "" if said is None else said.problems.get(f"{asset}/{channel}", "")

    def clock_ahead_s(self, source: str, asset: str, channel: str) -> float | None:
        """By how many seconds the clock of a channel is ahead, as its source says."""
        said = self._says(source)
        return None if said is None else said.clocks_ahead_s.get(f"{asset}/{channel}")

    def _says(self, source: str) -> SourceHealth | None:
        """Give the health of a source; None where nothing is read from it.

        It is asked ten times a second at most: a page of a thousand bad channels asks for each
        of them.
        """
        driver = self._by_name.get(source)
        if driver is None:
            return None
        now_s = time.monotonic()
        known = self._said.get(source)
        if known is None or now_s - known[0] > ASK_AGAIN_S:
            known = self._said[source] = now_s, driver.health()
        return known[1]

    def _hand_on(self, batch: Batch) -> None:
        if self._take is not None:
            self._take(batch)
            return
        for sample in batch.samples:
            self._samples[sample.asset, sample.channel] = sample
        for plan in batch.plans:
            self._plans[plan.asset] = plan


def _limits(asset: str, wiring: Wiring | None) -> dict[str, CheckLimits]:
    channels = {} if wiring is None else wiring.channels.get(asset, {})
    return {name: facts.limits for name, facts in channels.items()}


def _with_clocks(health: SourceHealth, ahead_s: Mapping[str, float]) -> SourceHealth:
    """Add the clocks that are ahead, as their samples show."""
    if not ahead_s:
        return health
    first, by_s = max(ahead_s.items(), key=itemgetter(1))
    others = f" and {len(ahead_s) - 1} more" if len(ahead_s) > 1 else ""
    text = f"{first}{others}: {clock_ahead(by_s)}"
    detail = f"{health.detail}; {text}" if health.detail != "ok" else text
    return replace(health, detail=detail, clocks_ahead_s={**health.clocks_ahead_s, **ahead_s})
