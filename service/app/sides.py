"""The processes of a service, each of which does one side of its work.

A side is started by the supervisor (`service.app.supervisor`), or alone with
``bearing-twin serve --only SIDE`` where systemd or a container takes the supervisor's place.
"""

import asyncio
import contextlib
import ctypes
import logging
import multiprocessing
import os
import signal
import socket
import ssl
import stat
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import structlog

from service.app.exits import refusals
from service.domain.sides import SideName
from service.loading import loading
from service.logs import configure_logging
from service.plant.publishers import any_enabled
from service.security.tls import tls_context
from service.service_manager import ServiceManager
from service.signals import leave_tasks_behind, leave_threads_behind, stop_on_signals
from service.site.settings import Settings
from service.tasks import background
from service.waiting import LEAVE_S, Waiting
from service.web.listening import bind

_PR_SET_NAME = 15
#: Wall seconds for a clean end without a supervisor.
_LAST_S = 15.0
_LOOK_EVERY_S = 0.5


def sides_of(settings: Settings) -> tuple[SideName, ...]:
    """Return the sides that a configuration needs; the plant side only with something enabled."""
    plant: tuple[SideName, ...] = ("plant",) if any_enabled(settings) else ()
    return ("cell", "web", *plant)


async def run_side(
    side: SideName,
    settings: Settings,
    stop: asyncio.Event,
    listener: socket.socket | None = None,
    on_ready: Callable[[], None] = lambda: None,
) -> None:
    """Run one side until ``stop`` is set.

    Raises `ServiceError` or `SettingsError` if the side cannot start.

    - ``listener``: bound socket of the web side; without it the web side binds its own.
    - ``on_ready``: called when the side does its work.
    """
    manager = ServiceManager()

    def ready() -> None:
        manager.ready()
        on_ready()

    # Each side loads its own libraries only: the compiled twin belongs to the cell.
    if side == "cell":
        with loading():
            from service.cell.start import run_cell

        await run_cell(settings, stop=stop, ready=ready, status=manager.status, alive=manager.alive)
        return
    async with background(manager.watch(lambda: True), "signs of life", stop):
        if side == "web":
            with loading():
                from service.web.start import run_web

            listener = listener or await listen(settings, stop)
            await run_web(settings, listener=listener, tls=tls_of(settings), stop=stop, ready=ready)
        else:
            with loading():
                from service.plant.start import run_plant

            await run_plant(settings, stop=stop, ready=ready)


async def listen(
    settings: Settings,
    stop: asyncio.Event,
    waits: Callable[[str, str], None] = lambda what, why: None,
) -> socket.socket:
    """Bind the address of the web side, when it is free.

    Raises `SettingsError` if the address cannot be used; `TemporaryError` if another program did
    not leave the port in time; `StoppedError` if the service is to stop.
    """
    service = settings.service
    return await Waiting(stop, waits).until(
        "its port", partial(bind, service.host, service.port), LEAVE_S
    )


def address_of(settings: Settings, listener: socket.socket) -> str:
    """Give the address of the web side, as a browser takes it."""
    scheme = "http" if settings.tls is None else "https"
    host, port = settings.service.host, listener.getsockname()[1]
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}/"


def tls_of(settings: Settings) -> ssl.SSLContext | None:
    """Load the certificate of the web side, where it has one.

    Raises `SettingsError` if certificate or key cannot be used.
    """
    tls = settings.tls
    if tls is None:
        return None
    return tls_context(settings.path(tls.certificate), settings.path(tls.key))


def begin_process(
    work: Callable[..., None], arguments: tuple[object, ...], kept: Sequence[socket.socket]
) -> None:
    """Begin the process of a side, made by a fork of the supervisor, and do its work.

    Signals and sockets of the supervisor are not those of the side: a port that the supervisor
    gives up must be free.
    """
    signal.set_wakeup_fd(-1)
    for name in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, signal.SIG_DFL)
    numbers = {0, 1, 2, *(one.fileno() for one in kept)}
    nothing = os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC)
    for file in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # the one of this very look
            number = int(file.name)
            if number not in numbers and stat.S_ISSOCK(os.fstat(number).st_mode):
                # Not closed: objects that still know the number must not meet another file.
                os.dup2(nothing, number, inheritable=False)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    work(*arguments)


def side_process(
    side: SideName,
    settings: Settings,
    environment: Mapping[str, str],
    listener: socket.socket | None,
) -> None:
    """Be the process of one side; called in it by the supervisor.

    It ends with status 0 when it was asked to, else as `service.app.exits` says.
    """
    _name(side)
    _end_with_supervisor()
    # systemd expects signs of life of the supervisor, and the supervisor of its sides.
    os.environ.update(environment, WATCHDOG_PID=str(os.getpid()))
    # The terminal sends Ctrl-C and its own end to all processes; the supervisor ends its sides in
    # their order.
    for name in (signal.SIGINT, signal.SIGHUP):
        signal.signal(name, signal.SIG_IGN)
    configure_logging()
    structlog.contextvars.bind_contextvars(process=side)
    try:
        with refusals():
            asyncio.run(_until_stopped(side, settings, listener))
        leave_threads_behind()
    finally:
        logging.shutdown()  # a process that was forked has no end of the interpreter


async def _until_stopped(
    side: SideName, settings: Settings, listener: socket.socket | None
) -> None:
    stop = stop_on_signals((signal.SIGTERM,))
    await run_side(side, settings, stop, listener)
    await leave_tasks_behind()


def key_check_process(settings: Settings) -> None:
    """Be the process that refuses a service without a valid key before it is started.

    What else is wrong with the store the cell reports.
    """
    from service.security.keys import check_key
    from service.store import Store, StoreError

    _end_with_supervisor()
    configure_logging()
    service = settings.service
    try:
        with (
            refusals(),
            contextlib.suppress(StoreError),
            Store.open(service.database_url, settings.data_dir) as store,
        ):
            check_key(store, service.host)
    finally:
        logging.shutdown()


def _name(side: SideName) -> None:
    """Give the process a name that `ps` shows."""
    ctypes.CDLL(None).prctl(_PR_SET_NAME, f"twin-{side}".encode(), 0, 0, 0)


def _end_with_supervisor() -> None:
    """End as if asked to when the supervisor has died, so that a new service finds all free."""
    supervisor = multiprocessing.parent_process()
    if supervisor is None:
        return

    def follow() -> None:
        while os.getppid() == supervisor.pid:
            time.sleep(_LOOK_EVERY_S)
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(_LAST_S)
        os._exit(1)

    threading.Thread(target=follow, name="follows the supervisor", daemon=True).start()
