"""Of which assets the alarms are not to be sent: the interface of planned silences."""


class Silencing:
    """Silences nothing; a feature may put another one in its place in the cell's `Core`."""

    def covers(self, asset: str, now_us: int) -> bool:
        """Whether the alarms of an asset are not to be sent at a process time."""
        return False

    def read(self) -> None:
        """Know what the store holds now.

        Raises `StoreUnavailableError` if the store does not answer; what was known still holds.
        """
