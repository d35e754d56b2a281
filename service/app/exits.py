"""How commands and processes end: 0 done, 1 a fault of ours, 2 to be corrected, 75 try again."""

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Final, NoReturn

from service.domain.errors import ServiceError, TemporaryError

#: Something that a person must correct, and trouble that passes by itself (EX_TEMPFAIL).
STATUS_REFUSED: Final = 2
STATUS_TEMPORARY: Final = os.EX_TEMPFAIL

_OURS = ("service", "adapters", "twin_core")


@contextlib.contextmanager
def refusals() -> Iterator[None]:
    """End the process with one line per error where its user or time can help.

    Our own kinds of ValueError and a store that cannot be used end with status 2. Trouble that
    passes by itself ends with status 75: whoever started the process may start it again. Any
    other exception is a fault of ours and keeps its traceback.
    """
    try:
        yield
    except ServiceError as error:
        passes = isinstance(error, TemporaryError) and error.passes
        refuse(str(error), status=STATUS_TEMPORARY if passes else STATUS_REFUSED)
    except ValueError as error:
        if type(error).__module__.partition(".")[0] not in _OURS:
            raise
        refuse(*getattr(error, "lines", (str(error),)))


def refuse(*messages: str, status: int = STATUS_REFUSED) -> NoReturn:
    """Write one line per message to standard error and exit."""
    for message in messages:
        sys.stderr.write(f"bearing-twin: {' '.join(message.split())}\n")
    sys.stderr.flush()
    sys.exit(status)
