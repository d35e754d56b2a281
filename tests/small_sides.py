"""Small processes that behave as sides of a service do, well or badly."""

import asyncio
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path

from service.service_manager import ServiceManager
from service.signals import stop_on_signals
from service.site.settings import Settings


def _note(settings: Settings, side: str, event: str) -> None:
    with (settings.service.data_dir / f"{side}.log").open("a") as log:
        log.write(f"{event} {os.getpid()} {time.monotonic_ns()}\n")


def events(folder: Path, side: str) -> list[tuple[str, int, int]]:
    """What a side has noted: event, process, time."""
    file = folder / f"{side}.log"
    lines = file.read_text().splitlines() if file.exists() else []
    return [(event, int(pid), int(when)) for event, pid, when in map(str.split, lines)]


def behaves(
    side: str,
    settings: Settings,
    environment: Mapping[str, str],
    listener: socket.socket | None,
) -> None:
    """Work until SIGTERM, give signs of life, answer whoever connects."""
    os.environ.update(environment)
    if listener is not None:

        def answer() -> None:
            while True:
                connection, _ = listener.accept()
                connection.sendall(str(os.getpid()).encode())
                connection.close()

        threading.Thread(target=answer, daemon=True).start()

    async def work() -> None:
        stop = stop_on_signals((signal.SIGTERM,))
        manager = ServiceManager()
        watching = asyncio.create_task(manager.watch(lambda: True))
        manager.ready()
        _note(settings, side, "ready")
        await stop.wait()
        watching.cancel()
        _note(settings, side, "ended")

    asyncio.run(work())


def refuses(
    side: str,
    settings: Settings,
    environment: Mapping[str, str],
    listener: socket.socket | None,
) -> None:
    """End with the status of trouble that passes."""
    _note(settings, side, "refused")
    sys.exit(os.EX_TEMPFAIL)


def never_ends(
    side: str,
    settings: Settings,
    environment: Mapping[str, str],
    listener: socket.socket | None,
) -> None:
    """Take no notice of SIGTERM."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    os.environ.update(environment)
    ServiceManager().ready()
    _note(settings, side, "ready")
    while True:
        signal.pause()


def spins(
    side: str,
    settings: Settings,
    environment: Mapping[str, str],
    listener: socket.socket | None,
) -> None:
    """Get into a loop without an end, the first time; then behave."""
    if events(settings.service.data_dir, side):
        behaves(side, settings, environment, listener)
        return
    os.environ.update(environment)
    ServiceManager().ready()
    _note(settings, side, "ready")
    while True:
        pass
