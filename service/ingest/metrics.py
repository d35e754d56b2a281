"""Metrics of ingest for Prometheus."""

import math
import threading
from collections.abc import Callable, Iterable, Mapping
from functools import partial

from prometheus_client import CollectorRegistry, Gauge, Histogram
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from adapters.protocol import Clock, Driver
from service.ingest.spool import Spool
from service.store import Mended, QueueUnavailableError

#: Why an accepted sample may not reach the store.
SKIP_REASONS = (
    "damaged",
    "queue_full",
    "refused",
    "spool_full",
    "store_unavailable",
    "too_old",
    "withdrawn",
)

_PREFIX = "bearing_twin_samples"

_SOURCE_COUNTS = {
    "polls": "Completed polls of a source, or frames that it received.",
    "samples": "Samples received from a source.",
    "skipped": "Polls skipped because they were late, samples that were not accepted.",
    "reconnects": "Reconnections of a source after a loss.",
}


class SampleLedger:
    """Where every accepted sample is now: stored, known already, skipped or waiting.

    The four always add up to the accepted ones, also in the middle of a scrape: that is why these
    are not separate counters.
    """

    def __init__(self, registry: CollectorRegistry) -> None:
        self._lock = threading.Lock()
        self._stored = 0
        self._duplicate = 0
        self._waiting = 0
        self._skipped = dict.fromkeys(SKIP_REASONS, 0)
        self.write_seconds = Histogram(
            "bearing_twin_store_write_seconds",
            "Wall seconds that one transaction with samples took, from the first row to the disk.",
            registry=registry,
            buckets=(0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10),
        )
        registry.register(self)

    def accept(self, count: int) -> None:
        """Count samples that came and wait for the store."""
        with self._lock:
            self._waiting += count

    def settle(self, *, stored: int, duplicates: int) -> None:
        """Count waiting samples that are in the store now, or were there before."""
        with self._lock:
            self._waiting -= stored + duplicates
            self._stored += stored
            self._duplicate += duplicates

    def skip(self, count: int, reason: str) -> None:
        """Count waiting samples that will never be stored."""
        with self._lock:
            self._waiting -= count
            self._skipped[reason] += count

    def counts(self) -> Mapping[str, int]:
        """All figures of one moment: accepted, stored, duplicate, skipped and waiting."""
        with self._lock:
            return self._counts()

    def _counts(self) -> dict[str, int]:
        skipped = sum(self._skipped.values())
        return {
            "accepted": self._stored + self._duplicate + skipped + self._waiting,
            "stored": self._stored,
            "duplicate": self._duplicate,
            "skipped": skipped,
            "waiting": self._waiting,
        }

    def describe(self) -> Iterable[Metric]:
        """Name the figures, so that the registry refuses a second ledger."""
        return self.collect()

    def collect(self) -> Iterable[Metric]:
        """Show the figures to Prometheus."""
        with self._lock:
            counts = self._counts()
            skipped_by_reason = dict(self._skipped)
        skipped = CounterMetricFamily(
            f"{_PREFIX}_skipped", "Accepted samples that were not stored.", labels=["reason"]
        )
        for reason, count in skipped_by_reason.items():
            skipped.add_metric([reason], count)
        return [
            CounterMetricFamily(
                f"{_PREFIX}_accepted",
                "Samples taken from sources, pushes and the twins.",
                counts["accepted"],
            ),
            CounterMetricFamily(f"{_PREFIX}_stored", "Samples stored.", counts["stored"]),
            CounterMetricFamily(
                f"{_PREFIX}_duplicate", "Samples that were stored already.", counts["duplicate"]
            ),
            skipped,
            GaugeMetricFamily(
                "bearing_twin_spool_samples",
                "Accepted samples that wait to be stored, in memory or on the disk.",
                counts["waiting"],
            ),
        ]


def watch_queues(
    queued: Callable[[], int], spool: Spool, clock: Clock, registry: CollectorRegistry
) -> None:
    """Show how much waits in memory and on the spool, and how long its oldest sample has waited."""

    def age_s() -> float:
        try:
            oldest_us = spool.oldest_received_us() if len(spool) else None
        except QueueUnavailableError:
            return math.nan
        return 0.0 if oldest_us is None else max(clock.now_us() - oldest_us, 0) / 1e6

    def size_bytes() -> float:
        try:
            return float(spool.size_bytes if len(spool) else 0)
        except QueueUnavailableError:
            return math.nan

    Gauge(
        "bearing_twin_queue_samples",
        "Samples in memory that wait for the store.",
        registry=registry,
    ).set_function(queued)
    Gauge(
        "bearing_twin_spool_bytes",
        "Size of the samples on the disk that wait for the store.",
        registry=registry,
    ).set_function(size_bytes)
    Gauge(
        "bearing_twin_spool_age_seconds",
        "Process seconds since the oldest sample of the spool was received.",
        registry=registry,
    ).set_function(age_s)


def watch_late(late: Callable[[], Mapping[str, int]], registry: CollectorRegistry) -> None:
    """Show how many samples of each asset came when newer ones were known; they are stored too."""
    text = "Samples that came out of order, after newer ones."
    registry.register(_ByAsset(CounterMetricFamily, f"{_PREFIX}_late", text, late))


def watch_outbox(waiting: Callable[[], int], registry: CollectorRegistry) -> None:
    """Show how much waits for the store."""
    Gauge(
        "bearing_twin_outbox_changes",
        "Alarm changes and audit lines that wait for the store, in memory or on the disk.",
        registry=registry,
    ).set_function(waiting)


def watch_damage(
    files: Mapping[str, Callable[[], Mended | None]],
    changes_lost: Callable[[], int],
    registry: CollectorRegistry,
) -> None:
    """Show which files were found damaged in this run, and what that has cost."""
    salvaged = Gauge(
        "bearing_twin_damaged_file_rows_salvaged",
        "Rows that were read from a file when it was last found damaged.",
        ["file"],
        registry=registry,
    )
    lost = Gauge(
        "bearing_twin_damaged_file_rows_lost",
        "Rows that were lost when a file was last found damaged.",
        ["file"],
        registry=registry,
    )
    for name, mended in files.items():
        salvaged.labels(name).set_function(partial(_rows, mended, "salvaged"))
        lost.labels(name).set_function(partial(_rows, mended, "lost"))
    Gauge(
        "bearing_twin_outbox_changes_lost",
        "Alarm changes and audit lines lost by damage of the outbox in this run.",
        registry=registry,
    ).set_function(changes_lost)


def _rows(mended: Callable[[], Mended | None], what: str) -> float:
    return float(getattr(mended(), what, 0))


def watch_forecasts(ages_s: Callable[[], Mapping[str, float]], registry: CollectorRegistry) -> None:
    """Show how old the live forecast of each asset is."""
    text = "Process seconds since the state that the live forecast starts from; NaN before it."
    registry.register(
        _ByAsset(GaugeMetricFamily, "bearing_twin_forecast_age_seconds", text, ages_s)
    )


class _ByAsset:
    """One figure of each asset, asked for at each scrape."""

    def __init__(
        self,
        family: type[CounterMetricFamily] | type[GaugeMetricFamily],
        name: str,
        text: str,
        figures: Callable[[], Mapping[str, float]],
    ) -> None:
        self._new = partial(family, name, text, labels=["asset"])
        self._figures = figures

    def describe(self) -> Iterable[Metric]:
        return [self._new()]

    def collect(self) -> Iterable[Metric]:
        family = self._new()
        for asset, figure in self._figures().items():
            family.add_metric([asset], figure)
        return [family]


class SourceMetrics:
    """Poll times, state and counts of the sources, as their drivers see them at each scrape."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self.poll_seconds = Histogram(
            "bearing_twin_poll_seconds",
            "Wall seconds that one poll of a source took.",
            ["source"],
            registry=registry,
            buckets=(0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5),
        )
        self._drivers: dict[str, Driver] = {}
        registry.register(self)

    def watch(self, driver: Driver) -> None:
        """Show this source too, in the place of one with its name."""
        self._drivers[driver.name] = driver

    def forget(self, name: str) -> None:
        """Show a source no more."""
        self._drivers.pop(name, None)

    def describe(self) -> Iterable[Metric]:
        """Name the figures, so that the registry refuses them twice."""
        return self.collect()

    def collect(self) -> Iterable[Metric]:
        """Show the figures to Prometheus."""
        up = GaugeMetricFamily(
            "bearing_twin_source_up",
            "1 while a source answers, 0 while it does not.",
            labels=["source"],
        )
        counters = {
            name: CounterMetricFamily(f"bearing_twin_source_{name}", text, labels=["source"])
            for name, text in _SOURCE_COUNTS.items()
        }
        errors = CounterMetricFamily(
            "bearing_twin_source_errors", "Errors of a source by kind.", labels=["source", "kind"]
        )
        for driver in list(self._drivers.values()):
            health = driver.health()
            up.add_metric([health.name], float(health.up))
            for name, counter in counters.items():
                counter.add_metric([health.name], getattr(health, name))
            # The first one is seen as an increase, whatever the driver.
            for kind, count in ({"connect": 0} | health.errors).items():
                errors.add_metric([health.name, kind], count)
        return [up, *counters.values(), errors]
