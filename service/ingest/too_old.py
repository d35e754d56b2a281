"""Samples from before the time from which the store keeps them: reported, never silent."""

import threading
import time
from collections.abc import Collection

import structlog

from adapters.samples import Sample
from adapters.times import EARLIEST_US, POSSIBLE
from service.clock import rfc3339

#: Wall seconds for which such a sample is worth an alarm, and between two log lines.
REPORTED_S = 600.0
_LOG_EVERY_S = 60.0

_log = structlog.get_logger(__name__)


class TooOld:
    """Remembers which assets sent samples that were too old to be stored, and when."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seen: dict[str, tuple[float, str]] = {}
        self._count = 0
        self._logged_at_s = float("-inf")

    def add(self, samples: Collection[Sample], kept_from_us: int) -> None:
        """Record samples, at least one, that the store did not take."""
        now_s = time.monotonic()
        with self._lock:
            self._count += len(samples)
            for one in {sample.asset: sample for sample in samples}.values():
                why = f"history before {rfc3339(kept_from_us)} has been removed"
                if one.time_us < EARLIEST_US:
                    why = f"expected {POSSIBLE}"
                text = f"Samples of {rfc3339(one.time_us)} are not stored: {why}. Check the clock"
                self._seen[one.asset] = now_s, text
            if now_s < self._logged_at_s + _LOG_EVERY_S:
                return
            self._logged_at_s = now_s
            count, self._count = self._count, 0
        _log.error(
            "samples_too_old",
            count=count,
            oldest=rfc3339(min(sample.time_us for sample in samples)),
            kept_from=rfc3339(kept_from_us),
            hint="check the clock; 'bearing-twin db horizon' shows and lowers this time",
        )

    @property
    def problem(self) -> str | None:
        """What was too old in the last minutes; None when nothing was."""
        with self._lock:
            assets = list(self._seen)
        found = (self.of(asset) for asset in assets)
        return next(filter(None, found), None)

    def of(self, asset: str) -> str | None:
        """What of an asset was too old in the last minutes; "" when it is over, None if never."""
        with self._lock:
            seen = self._seen.get(asset)
        if seen is None:
            return None
        at_s, text = seen
        return text if time.monotonic() < at_s + REPORTED_S else ""
