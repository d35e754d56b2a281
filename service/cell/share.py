"""The part of a fleet's assets that this cell follows, as long as it owns their partitions."""

import asyncio
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Final

from sqlalchemy import Connection

from service.site.asset_section import AssetSection
from service.site.partitions import partition_of, partitions_of
from service.store.fences import ClosedFence

if TYPE_CHECKING:
    from service.store.ownership import Ownership

#: The owner of this partition also does what is done once for the whole store.
HOUSEKEEPING: Final = 0


class Share:
    """Knows which assets are this cell's; also the fence of its store.

    Its methods may be called from any thread, but for `arrange`.

    Parameters
    ----------
    ownership : Ownership
        Which partitions this cell owns.

    Attributes
    ----------
    changed : asyncio.Event
        Set when assets are to be taken up or given up.
    """

    def __init__(self, ownership: "Ownership", changed: asyncio.Event) -> None:
        self.ownership = ownership
        self.changed = changed
        self._partitions: Mapping[str, int] = {}
        # Assets that came into another partition with a revision of the assets.
        self._moved: Mapping[str, int] = {}

    def arrange(self, assets: Iterable[AssetSection], revision: int) -> None:
        """Record all assets of the fleet as they are with a revision."""
        count = self.ownership.count
        partitions = partitions_of(assets, count)
        before = self._partitions
        self._moved = dict(self._moved) | {
            name: revision
            for name, partition in partitions.items()
            if before.get(name, partition) != partition
        }
        self._partitions = {**before, **partitions}  # of removed ones something may wait still
        self.ownership.assets = Counter(partitions.values())

    def owns(self, asset: str) -> bool:
        """Return whether this cell is to follow an asset.

        One that came from another partition only once every cell knows that: until then the cell
        that owned it may follow it.
        """
        ownership = self.ownership
        if self._moved.get(asset, 0) > ownership.least_revision:
            return False
        partition = self.partition(asset)
        return partition in ownership.owned and partition not in ownership.leaving

    def settle(self, revision: int) -> None:
        """Record that exactly the assets that `owns` named are followed."""
        self.ownership.assets_revision = revision
        self.ownership.leave(self.ownership.leaving)

    def partition(self, asset: str) -> int:
        """Partition of an asset."""
        known = self._partitions.get(asset)
        return partition_of(f"asset {asset}", self.ownership.count) if known is None else known

    @property
    def is_maintenance_leader(self) -> bool:
        """Whether this cell does what is done once for the whole store."""
        return HOUSEKEEPING in self.ownership.owned

    # ------------------------------------------------------------------ the fence
    def held(self, connection: Connection, assets: Collection[str]) -> Collection[str]:
        """See `service.store.database.Fence.held`."""
        partitions = {asset: self.partition(asset) for asset in assets}
        held = self.ownership.held(connection, set(partitions.values()))
        return [asset for asset, partition in partitions.items() if partition in held]

    def deliverable(
        self, connection: Connection, assets: Collection[str], run: str
    ) -> Collection[str]:
        """See `service.store.database.Fence.deliverable`."""
        return _of_run(connection, {asset: self.partition(asset) for asset in assets}, run)


class EarlierRuns(ClosedFence):
    """The fence of a cell that owns nothing yet: it delivers what earlier runs of it left.

    Each change is compared with the present owner of its partition. This run writes nothing.

    Parameters
    ----------
    assets : iterable of AssetSection
        All assets of the fleet.
    count : int
        Number of partitions.
    """

    def __init__(self, assets: Iterable[AssetSection], count: int) -> None:
        self._partitions = partitions_of(assets, count)
        self._count = count

    def deliverable(
        self, connection: Connection, assets: Collection[str], run: str
    ) -> Collection[str]:
        """See `service.store.database.Fence.deliverable`."""
        known, count = self._partitions, self._count
        partitions = {
            asset: known.get(asset, partition_of(f"asset {asset}", count)) for asset in assets
        }
        return _of_run(connection, partitions, run)


def _of_run(connection: Connection, partitions: Mapping[str, int], run: str) -> list[str]:
    # SQLAlchemy's part for PostgreSQL is loaded only where there is a fleet.
    from service.store.ownership import owned_by

    owned = owned_by(connection, set(partitions.values()), run)
    return [asset for asset, partition in partitions.items() if partition in owned]
