"""Reports the state of the service to systemd: ready, alive, stopping (`sd_notify`).

The protocol is one datagram of text, so no library is needed: the small ones have not been kept
for years, and systemd's own has to be compiled.
"""

import asyncio
import contextlib
import os
import socket
from collections.abc import Callable, Mapping

#: What a side sends to have the configuration file read again; systemd takes no notice of it.
RELOAD = "X_RELOAD=1"
#: A sign of life is sent this many times within the watchdog's time.
_SIGNS_PER_WATCHDOG = 4
_MICROSECONDS = 1e6


class ServiceManager:
    """The service manager that started this process; without one nothing is sent.

    Parameters
    ----------
    environment : mapping of str to str
        ``NOTIFY_SOCKET``, and ``WATCHDOG_USEC`` where signs of life are expected. An address
        ``fd:NUMBER`` is an open socket of this process: so the supervisor hears its sides, which
        needs no folder, and no other process can speak for them.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        number = address.removeprefix("fd:")
        self._descriptor = int(number) if number != address and number.isdigit() else None
        # An address that begins with @ is an abstract one, which the kernel writes with a NUL.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        meant_for = environment.get("WATCHDOG_PID", str(os.getpid()))
        usec = environment.get("WATCHDOG_USEC", "") if meant_for == str(os.getpid()) else ""
        self._watchdog_s = int(usec) / _MICROSECONDS if usec.isdigit() else 0.0

    def ready(self) -> None:
        """Say that the service has started: devices are read, samples are kept."""
        self._send("READY=1")

    def status(self, text: str) -> None:
        """Say in one line what the service does; ``systemctl status`` shows it."""
        self._send(f"STATUS={' '.join(text.split())}")

    def stopping(self) -> None:
        """Say that the service is about to end."""
        self._send("STOPPING=1")

    def reload(self) -> None:
        """Have the supervisor read the configuration file again."""
        self._send(RELOAD)

    def alive(self) -> None:
        """Give a sign of life, where they are expected."""
        if self._watchdog_s:
            self._send("WATCHDOG=1")

    async def watch(self, is_alive: Callable[[], bool]) -> None:
        """Give signs of life, until cancelled, as long as the event loop and the work go on.

        Parameters
        ----------
        is_alive : callable
            Whether the work has made progress since it was asked last.
        """
        while True:
            await asyncio.sleep((self._watchdog_s or 60.0) / _SIGNS_PER_WATCHDOG)
            if self._watchdog_s and is_alive():
                self.alive()

    def _send(self, text: str) -> None:
        if self._descriptor is not None:
            with contextlib.suppress(OSError):
                os.write(self._descriptor, text.encode())
            return
        if not self._address:
            return
        # A manager that does not listen must not hold up the service.
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as outlet,
        ):
            outlet.setblocking(False)
            outlet.sendto(text.encode(), self._address)
