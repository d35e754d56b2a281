"""What the outboxes of services have delivered, so that nothing is taken twice."""

from dataclasses import dataclass

from sqlalchemy import Connection, insert, select, update

from service.store.tables import DeliveryRow


@dataclass(frozen=True, slots=True)
class Delivery:
    """One change of an outbox; each run of a service is a sender, whose numbers ascend."""

    sender: str
    number: int

    @property
    def run(self) -> str:
        """Name of the run of a cell that recorded the change; see `Outbox.open`."""
        return self.sender.partition("/")[0]


def is_first(connection: Connection, delivery: Delivery) -> bool:
    """Record a delivery; False when it was made before."""
    row = DeliveryRow
    this_sender = row.sender == delivery.sender
    latest = connection.scalar(select(row.number).where(this_sender))
    if latest is None:
        connection.execute(insert(row).values(sender=delivery.sender, number=delivery.number))
        return True
    if delivery.number <= latest:
        return False
    connection.execute(update(row).where(this_sender).values(number=delivery.number))
    return True
