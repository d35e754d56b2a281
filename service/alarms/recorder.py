"""Writes what happens to the alarms into the store, in order, without making anybody wait."""

import threading
import time
from collections import deque

import structlog

from service.store import Alarm, AlarmTransition, Store, StoreUnavailableError

_RETRY_S = 0.5

_log = structlog.get_logger(__name__)


class AlarmRecorder:
    """A queue in front of the store with a thread of its own.

    While the store does not answer, the changes wait and nothing else does.

    Parameters
    ----------
    store : Store
        Where the alarms and their journal go.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._changes: deque[tuple[Alarm | None, tuple[AlarmTransition, ...]]] = deque()
        self._condition = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="alarm-journal", daemon=True)
        self._thread.start()

    def record(self, alarm: Alarm | None, *lines: AlarmTransition) -> None:
        """Have an alarm written as it is now, with lines for the journal; returns at once.

        Parameters
        ----------
        alarm : Alarm or None
            None for lines that belong to no alarm.
        *lines : AlarmTransition
            What happened.
        """
        with self._condition:
            self._changes.append((alarm, lines))
            self._condition.notify_all()

    def flush(self, timeout_s: float) -> bool:
        """Wait until all is written that was recorded so far; False when that took too long."""
        with self._condition:
            return self._condition.wait_for(lambda: not self._changes, timeout_s)

    def close(self, timeout_s: float) -> None:
        """Write what is left, for at most so many wall seconds, and stop."""
        written = self.flush(timeout_s)
        with self._condition:
            self._closing = True
            self._condition.notify_all()
        if not written:
            _log.error("alarm_changes_lost", count=len(self._changes), waited_s=timeout_s)
        self._thread.join(_RETRY_S)

    def _run(self) -> None:
        failing = False
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._changes or self._closing)
                if self._closing:
                    return
                alarm, lines = self._changes[0]
            try:
                self._store.save_alarm(alarm, lines)
            except StoreUnavailableError as error:
                if not failing:
                    _log.warning("alarm_journal_waits", error=str(error))
                failing = True
                time.sleep(_RETRY_S)
                continue
            except Exception:
                # A change that the store refuses must not hold up the ones behind it.
                _log.exception("alarm_change_refused", alarm=alarm, lines=lines)
            if failing:
                failing = False
                _log.info("alarm_journal_written_again")
            with self._condition:
                self._changes.popleft()
                self._condition.notify_all()
