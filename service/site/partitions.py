"""Which partition of a fleet each asset belongs to: assets of one source are never parted."""

import zlib
from collections.abc import Iterable

from service.site.asset_section import AssetSection
from service.site.asset_tables import wire_sources


def partitions_of(assets: Iterable[AssetSection], count: int) -> dict[str, int]:
    """Give the partition of each asset.

    A device is read by one cell only. So assets that are read from the same source belong together,
    and so do all sources of one asset, through as many steps as there are. An asset to which
    everything is pushed stands for itself. Partitions count from 0 and are the same on every
    machine.
    """
    sources = {asset.id: sorted(wire_sources(asset)) for asset in assets}
    first: dict[str, str] = {}

    def root(name: str) -> str:
        while first.setdefault(name, name) != name:
            first[name] = first[first[name]]
            name = first[name]
        return name

    for names in sources.values():
        for name in names[1:]:
            low, high = sorted((root(names[0]), root(name)))
            first[high] = low
    return {
        asset: partition_of(f"source {root(names[0])}" if names else f"asset {asset}", count)
        for asset, names in sources.items()
    }


def partition_of(key: str, count: int) -> int:
    """Give the partition of a key; the same in every process."""
    return zlib.crc32(key.encode()) % count
