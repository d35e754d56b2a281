"""One service per PostgreSQL database, whatever its data directory."""

import contextlib
import os
import socket
import threading
import uuid
from collections.abc import Callable
from typing import Any

import psycopg
import structlog
from sqlalchemy.engine import URL

from service.store.addresses import shown
from service.store.closable import Closable
from service.store.errors import DatabaseInUseError
from service.store.postgresql_connection import (
    CONNECT_ARGS,
    PatientConnection,
    connection_error,
)

#: Wall seconds between two looks at the connection that holds the lock.
CHECK_S = 2.0
#: Wall seconds for an answer, of which ending an old connection may take five; and for the end.
_ANSWER_S = 8.0
_END_S = 1.0

#: Number of the advisory lock, with the schema's next to it; any that no one else uses.
SERVICE_LOCK = 0x42545773
_LOCK = f"pg_try_advisory_lock({SERVICE_LOCK}, hashtext(current_schema()))"
_HOLDER = f"""
SELECT pid, coalesce(application_name, '') FROM pg_locks JOIN pg_stat_activity USING (pid)
WHERE locktype = 'advisory' AND granted AND classid = {SERVICE_LOCK}
AND objid::bigint = hashtext(current_schema())::bigint & 4294967295
AND database = (SELECT oid FROM pg_database WHERE datname = current_database())
"""
# A machine that vanished with the lock gives it up within half a minute.
_NOTICE_LOSS = (
    "SET tcp_keepalives_idle = 10; SET tcp_keepalives_interval = 5; SET tcp_keepalives_count = 3"
)

_log = structlog.get_logger(__name__)


class DatabaseLock(Closable):
    """The right to run a service on a PostgreSQL database, until closed or the process ends.

    A connection of its own holds it. When the server was restarted the lock is taken again. Raises
    `DatabaseInUseError` if another service has it. Raises `StoreError` if there is no connection; a
    `StoreUnavailableError` if that is temporary.

    - ``on_lost``: called, from another thread, if another service took the database while the
      server was away.
    - ``lost``: why the right is lost, one line; empty while it is held.
    """

    def __init__(self, url: URL, on_lost: Callable[[], object]) -> None:
        self._url = url
        self._name = f"service.database_url = {shown(url)!r}"
        # The server's view of who holds the lock: unique, within its 63 characters.
        place = f"{socket.gethostname()[:30]} process {os.getpid()}"
        self._self = f"bearing-twin {place} {uuid.uuid4().hex[:6]}"
        self._on_lost = on_lost
        self._ended = threading.Event()
        self.lost = ""
        try:
            self._connection = self._connect()
        except psycopg.Error as error:
            raise connection_error(self._name, error, url) from error
        self._thread = threading.Thread(target=self._keep, name="database-lock", daemon=True)
        self._thread.start()

    def _connect(self) -> PatientConnection:
        """Connect and take the lock."""
        connection = PatientConnection.connect(
            self._url.set(drivername="postgresql").render_as_string(hide_password=False),
            autocommit=True,
            **{**CONNECT_ARGS, "application_name": self._self},
        )
        connection.answer_s = _ANSWER_S
        try:
            connection.execute(_NOTICE_LOSS)
            while not _first(connection.execute(f"SELECT {_LOCK}"))[0]:
                holder = _first(connection.execute(_HOLDER))
                if holder is None:
                    self._ended.wait(0.05)  # it ended this very moment
                    continue
                process, name = holder
                if name != self._self:
                    where = name.removeprefix("bearing-twin ").rpartition(" ")[0]
                    raise DatabaseInUseError(
                        f"{self._name}: another service is running on it"
                        f"{f' ({where})' if where else ''}; stop that one or give this one "
                        "another database"
                    )
                # Our own connection, which broke on our side only.
                connection.execute("SELECT pg_terminate_backend(%s, 5000)", (process,))
        except BaseException:
            connection.close()
            raise
        return connection

    def _keep(self) -> None:
        while not self._ended.wait(CHECK_S):
            try:
                self._connection.execute("SELECT 1")
            except psycopg.Error:
                self._connection.close()
                try:
                    self._connection = self._connect()
                except DatabaseInUseError as error:
                    self.lost = str(error)
                    _log.error("database_taken_over", error=self.lost)
                    self._on_lost()
                    return
                except psycopg.Error:
                    continue  # the server is away: no one else can take the lock either
                _log.info("database_locked_again")

    def close(self) -> None:
        """Release the database: another service may take it at once."""
        self._ended.set()
        self._thread.join(_END_S)
        if self._thread.is_alive():
            return  # the end of the process releases it
        # The server may take a while to see that the connection is closed.
        self._connection.answer_s = _END_S
        with contextlib.suppress(psycopg.Error):
            self._connection.execute("SELECT pg_advisory_unlock_all()")
        self._connection.close()


def _first(cursor: psycopg.Cursor[Any]) -> Any:
    return cursor.fetchone()
