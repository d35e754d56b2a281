"""Measurements as columns, for plots and tables."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime

from bearing_twin_client.documents import BucketItem, ReceivedSampleItem, SampleItem

Row = SampleItem | ReceivedSampleItem | BucketItem


@dataclass
class Columns:
    """One channel, ascending by time; the lists are equally long."""

    time: list[datetime] = field(default_factory=list)  # UTC; of a bucket its start
    #: In the channel's unit; of a bucket its mean. None where no good value is.
    value: list[float | None] = field(default_factory=list)
    #: OPC DA byte: below 64 bad, 64 to 191 uncertain, 192 and above good.
    quality: list[int] = field(default_factory=list)


def columns(rows: Iterable[Row]) -> dict[str, Columns]:
    """Sort measurements by channel, in the order in which the channels first come."""
    found: dict[str, Columns] = {}
    for row in rows:
        one = found.setdefault(row.channel, Columns())
        one.time.append(row.time)
        one.value.append(row.mean if isinstance(row, BucketItem) else row.value)
        one.quality.append(row.quality)
    return found
