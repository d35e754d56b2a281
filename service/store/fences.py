"""Who may write into the store of a fleet, from the first moment of a connection on."""

from collections.abc import Collection

from sqlalchemy import Connection

from service.store.errors import StoreUnavailableError


class ClosedFence:
    """Refuses everything, for as long as the connection has no other fence.

    What is delivered meanwhile waits in its outbox.
    """

    def held(self, connection: Connection, assets: Collection[str]) -> Collection[str]:
        """See `service.store.database.Fence.held`."""
        raise StoreUnavailableError("this cell does not own any partition yet")

    def deliverable(
        self, connection: Connection, assets: Collection[str], run: str
    ) -> Collection[str]:
        """See `service.store.database.Fence.deliverable`."""
        raise StoreUnavailableError("it is not known yet who owns the partitions")
