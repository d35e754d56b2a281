"""Assets that are not followed for a while: what their history says of it."""

from collections.abc import Collection, Mapping, Sequence
from typing import Final

from adapters.samples import Quality, Sample, is_bad
from service.alarms import AlarmBook
from service.ingest import Ingest
from service.store import Store

_NOT_FOLLOWED: Final = (
    "Not followed any more: the asset was removed, or its configuration does not fit"
)
_AGAIN: Final = "Followed again; meanwhile nobody watched the machine"


class Absences:
    """Marks in history and journal from when to when an asset is not followed.

    Without the mark a reader would draw a line from the last value before to the first one after.

    Parameters
    ----------
    store : Store
        Tells which assets have been followed before.
    ingest : Ingest
        The way of the marks to the store.
    alarms : AlarmBook
        Whose journal gets the events.
    """

    def __init__(self, store: Store, ingest: Ingest, alarms: AlarmBook) -> None:
        self._store = store
        self._ingest = ingest
        self._alarms = alarms
        # Newest sample of each channel, of assets that are not followed but may still be read.
        self._latest: dict[str, Mapping[str, Sample]] = {}

    def known(self, assets: Sequence[str]) -> set[str]:
        """Tell which of some new assets have a history; reads from the store."""
        return self._store.samples.with_history(assets) if assets else set()

    def note(self, gone: Mapping[str, Mapping[str, Sample]], again: Collection[str]) -> None:
        """Take note of assets that are followed no longer, and of those that are again.

        Parameters
        ----------
        gone
            Newest sample of each channel, by asset.
        again
            Assets with a history.
        """
        self._latest |= gone
        self._alarms.record_events(sorted(gone), "asset not followed", _NOT_FOLLOWED)
        self._alarms.record_events(sorted(again), "asset followed again", _AGAIN)

    def mark(self, assets: Collection[str], now_us: int) -> None:
        """Mark the end of each channel of assets that are not read any more either."""
        marks = [
            Sample(
                asset,
                channel,
                max(now_us, latest.time_us + 1),
                float("nan"),
                Quality.OUT_OF_SERVICE,
                now_us,
            )
            for asset in assets
            for channel, latest in self._latest.pop(asset, {}).items()
            if not is_bad(latest.quality)
        ]
        self._ingest.submit(marks)
