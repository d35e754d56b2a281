"""Growing waits between tries, for everything that is tried again."""


class Backoff:
    """Waits in seconds: each twice the one before, up to a limit."""

    def __init__(self, first_s: float, last_s: float) -> None:
        self._first_s = first_s
        self._last_s = last_s
        self.wait_s = first_s

    def next(self) -> float:
        """Return the next wait, and double the one after."""
        wait_s, self.wait_s = self.wait_s, min(2.0 * self.wait_s, self._last_s)
        return wait_s

    def reset(self) -> None:
        """Begin with the first wait again."""
        self.wait_s = self._first_s
