"""Which cell owns which partition of a fleet, for those who only ask."""

from sqlalchemy import select

from service.store.part import StorePart
from service.store.tables import PartitionRow


class PartitionOwners(StorePart):
    """What the database says of the partitions, whatever cells say of themselves."""

    def load(self) -> dict[int, tuple[int, str]]:
        """Epoch and name of the owner by partition; the name is empty while it has none."""
        query = select(PartitionRow.id, PartitionRow.epoch, PartitionRow.owner)
        with self._database.reading() as connection:
            return {number: (epoch, owner) for number, epoch, owner in connection.execute(query)}
