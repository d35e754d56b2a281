"""What became of the messages to a recipient."""

from typing import Final

import structlog

from service.clock import wall_us

#: Tries in a row that fail before the notification counts as failing.
FAILS_AFTER: Final = 3

_log = structlog.get_logger(__name__)


class DeliveryRecord:
    """What became of the last messages to a recipient.

    - ``tries``: how many have failed in a row.
    - ``error``: of the last one that failed, or what is wrong with some addresses.
    - ``given_up``: alarms of which a message was refused for good.
    """

    def __init__(self, id: str) -> None:
        self.tries = 0
        self.error = ""
        self.failing_since_us: int | None = None
        self.sent_us: int | None = None
        self.given_up = 0
        self._id = id

    def accept(self, error: str) -> None:
        """Note that a message was accepted; ``error``: what is wrong with some of its addresses."""
        if self.tries >= FAILS_AFTER:
            _log.info("notification_sent_again", notification=self._id)
        self.tries, self.failing_since_us, self.error = 0, None, error

    def fail(self, error: str) -> None:
        """Note that a message was not accepted."""
        self.tries += 1
        self.error = error
        if self.failing_since_us is None:
            self.failing_since_us = wall_us()
        if self.tries == FAILS_AFTER:
            _log.error("notification_fails", notification=self._id, reason=error)

    def give_up(self, error: str) -> None:
        """Note that what is said of an alarm is not sent any more."""
        self.given_up += 1
        self.error = error

    @property
    def problem(self) -> str | None:
        """What is wrong with it, if it has failed several times in a row."""
        return None if self.tries < FAILS_AFTER else f"notification {self._id} fails: {self.error}"
