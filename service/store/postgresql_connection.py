"""Connections to PostgreSQL that give up on a server which does not answer."""

import re
import time
from typing import Any, TypeVar

import psycopg
from psycopg.abc import PQGen
from sqlalchemy.engine import URL

from service.store.addresses import without_secrets
from service.store.errors import StoreError, StoreUnavailableError

#: Wall seconds for a new connection; a server that hangs takes it, but says nothing.
CONNECT_S = 3
#: Wall seconds that a statement is given, unless the caller says otherwise.
ANSWER_S = 30.0
#: How every connection is made.
CONNECT_ARGS: dict[str, Any] = {
    "connect_timeout": CONNECT_S,
    "application_name": "bearing-twin",
    # A server that vanished from the network is noticed within seconds.
    "keepalives_idle": 5,
    "keepalives_interval": 2,
    "keepalives_count": 3,
    "tcp_user_timeout": 15_000,
}

#: What a server says that will say the same tomorrow. While the connection is being made its
#: status code is not to be had, only this text.
_PERMANENT = re.compile(
    r"authentication failed|no password supplied|database \".*\" does not exist"
    r"|role \".*\" does not exist|no pg_hba\.conf entry|permission denied|not permitted to log in"
    r"|does not support SSL|certificate|invalid connection option|invalid port number"
    r"|invalid integer value|invalid (sslmode|channel_binding)"
)

_Answer = TypeVar("_Answer")


class PatientConnection(psycopg.Connection[Any]):
    """A connection on which no statement takes longer than `answer_s` wall seconds.

    A server that hangs (stopped, out of memory, a storage that is gone) keeps its connections
    open, so that no timeout of the network ends a wait for it, and it does not look at its own
    `statement_timeout` either. What is not answered in time ends with an `OperationalError`, and
    the connection is closed: the server, should it come back, drops what was not committed.
    """

    answer_s: float | None = CONNECT_S

    def wait(self, gen: PQGen[_Answer], *arguments: Any, **options: Any) -> _Answer:
        """Wait for the server; see `psycopg.Connection.wait`."""
        if self.answer_s is None:
            return super().wait(gen, *arguments, **options)
        try:
            return super().wait(_within(gen, self.answer_s), *arguments, **options)
        except _SilenceError:
            self.pgconn.finish()
            raise


class _SilenceError(psycopg.OperationalError):
    """The server did not answer in time."""


def _within(gen: PQGen[_Answer], answer_s: float) -> PQGen[_Answer]:
    """Pass a wait on until the time is over; the waiting thread looks in ten times a second."""
    ends_s = time.monotonic() + answer_s
    try:
        wanted = next(gen)
        while True:
            ready = yield wanted
            if not ready and time.monotonic() > ends_s:
                gen.close()
                raise _SilenceError(f"no answer within {answer_s:g} s")
            wanted = gen.send(ready)
    except StopIteration as ended:
        answer: _Answer = ended.value
        return answer


def connection_error(name: str, cause: BaseException | None, url: URL) -> StoreError:
    """Make the error of a connection: one line, of the kind that its cause is.

    ``url``: the database's; its passwords are taken out. Returns a `StoreUnavailableError` unless a
    person must mend it (wrong password, unknown database).
    """
    reason = without_secrets(str(cause), url)
    state = getattr(cause, "sqlstate", None) or ""
    # Classes of status codes: 28 a wrong user or password, 3D an unknown database, 42 a missing
    # right or table.
    permanent = state[:2] in ("28", "3D", "42") or bool(_PERMANENT.search(reason))
    return (StoreError if permanent else StoreUnavailableError)(f"{name}: {reason}")
