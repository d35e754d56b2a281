"""Lets a part of the live twin fail without ending the rest."""

import contextlib
from collections.abc import Iterator

import structlog

_log = structlog.get_logger(__name__)


class Guard:
    """Stands around work that is done again and again: a failure is logged, not passed on.

    Only the first of a row of failures is logged, and the first success after them.

    Parameters
    ----------
    what : str
        What is guarded, as it appears in the log.
    asset : str
        Whose.
    """

    def __init__(self, what: str, asset: str) -> None:
        self.failing = False
        self._what = what
        self._asset = asset

    @contextlib.contextmanager
    def __call__(self) -> Iterator[None]:
        """Guard the work of a ``with`` block; `failing` says how it went."""
        try:
            yield
        except Exception:
            # Whatever it was that one round stumbled over: the machine runs on, so must its twin.
            if not self.failing:
                _log.exception(f"{self._what}_failed", asset=self._asset)
            self.failing = True
        else:
            if self.failing:
                _log.info(f"{self._what}_works_again", asset=self._asset)
            self.failing = False
