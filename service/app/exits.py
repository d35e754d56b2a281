"""How commands and processes end: 0 done, 1 a fault of ours, 2 to be corrected, 75 try again."""

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Final, NoReturn

from service.domain.errors import ServiceError, TemporaryError
from service.logs import say_last

#: Something that a person must correct, and temporary trouble (EX_TEMPFAIL).
STATUS_REFUSED: Final = 2
STATUS_TEMPORARY: Final = os.EX_TEMPFAIL

_OURS = ("service", "adapters", "twin_core")


@contextlib.contextmanager
def refusals() -> Iterator[None]:
    """End the process with one line per error where its user or time can help.

    Our own kinds of ValueError and a store that cannot be used end with status 2. Temporary trouble
    ends with status 75: the command may be started again. Any other exception is a fault of ours
    and keeps its traceback.
    """
    try:
        yield
    except ServiceError as error:
        passes = isinstance(error, TemporaryError) and error.passes
        refuse(str(error), status=STATUS_TEMPORARY if passes else STATUS_REFUSED)
    except ValueError as error:
        kinds = type(error).__mro__  # of other packages too, when they derive from ours
        if all(kind.__module__.partition(".")[0] not in _OURS for kind in kinds):
            raise
        refuse(*getattr(error, "lines", (str(error),)))


def refuse(*messages: str, status: int = STATUS_REFUSED) -> NoReturn:
    """Write one line per message to standard error and exit."""
    say_last([f"bearing-twin: {' '.join(message.split())}" for message in messages])
    sys.exit(status)
