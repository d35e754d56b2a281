"""Starts the sides of a service as processes, watches them, and stops them in their order.

A side that dies, or that shows no sign of life any more, is started again alone; the others go on.
The supervisor itself does no work. It has loaded what the sides share and makes each of them by a
fork, so that they share its memory. It holds the socket that the web side listens on, so that
callers of a web side that starts again wait instead of being refused.

Each side reports to the supervisor as a service reports to systemd (`service.service_manager`):
ready, its status, signs of life. The supervisor reports to the real service manager for all.
"""

import asyncio
import contextlib
import os
import socket
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Sequence
from functools import partial
from multiprocessing.context import ForkProcess
from typing import Any

import structlog

from service.app.exits import STATUS_REFUSED, STATUS_TEMPORARY
from service.app.forking import ended, preload, start
from service.app.hanging import HUNG_S, SilentTime, look_at
from service.app.sides import key_check_process, side_process, sides_of
from service.domain.errors import BearingTwinError
from service.domain.sides import SideName
from service.security.loopback import is_loopback
from service.service_manager import RELOAD, ServiceManager
from service.site.configuration import SettingsError
from service.site.examination import load_site
from service.site.settings import Settings

#: Wall seconds without a sign of life after which a side is killed, however busy the machine is;
#: one that hangs is known earlier (`service.app.hanging`).
SILENT_S = 30.0
#: A side that dies before it was ready is started again after so many wall seconds, at most.
RETRY_MOST_S = 10.0
#: Wall seconds that a side is given to end; callers first, then the cell: together less than the
#: fifteen seconds that the unit and the image give.
STOP_S: dict[SideName, float] = {"cell": 10.0, "web": 4.0, "plant": 4.0}
_RETRY_FIRST_S = 0.2
#: For `Side.run`: of a side whose process could not be made.
_STATUS_NOT_STARTED = 1
#: A store that does not answer within these wall seconds is asked for keys by the web side.
_KEY_CHECK_S = 10.0
_LOOK_EVERY_S = 0.5
#: A supervisor that is late itself by so many wall seconds is on a busy machine.
_LATE_S = 1.0
#: And after so many it was suspended, with all sides: their silence begins again.
_SUSPENDED_S = 5.0

_log = structlog.get_logger(__name__)


class SideEndedError(BearingTwinError):
    """A side ended with a status that ends the service; its own line says why."""

    def __init__(self, side: SideName, status: int) -> None:
        super().__init__(f"the {side} ended with status {status}")
        self.status = status


class Side:
    """One side of the service: its process, and what it reports.

    - ``listener``: gives the bound socket of the web side, when there is one.
    - ``work``: what its process does, with the arguments of `service.app.sides.side_process`.
    - ``silent_s``: wall seconds without a sign of life after which the side hangs.
    """

    def __init__(
        self,
        name: SideName,
        settings: Settings,
        listener: "asyncio.Future[socket.socket] | None" = None,
        work: Callable[..., None] = side_process,
        silent_s: float = SILENT_S,
    ) -> None:
        self.name = name
        self.silent_limit_s = silent_s
        self._work = work
        self.is_ready = asyncio.Event()
        self._settings = settings
        self._before: Settings | None = None  # until the side has started with the present ones
        self._changing = False
        self._listener = listener
        self._process: ForkProcess | None = None
        self._stopping = asyncio.Event()
        self._gone = asyncio.Event()
        self._gone.set()
        self._silence = SilentTime(time.monotonic())

    async def run(self, on_report: Callable[[SideName, str], None]) -> None:
        """Keep the side running, until it is stopped.

        Raises `SideEndedError` if it ends with a status that a new start does not cure;
        `ServiceError` if the web side's address cannot be listened on.
        """
        listener = None if self._listener is None else await asyncio.shield(self._listener)
        retry_s = 0.0
        with self._reports(on_report) as outlet:
            while not self._stopping.is_set():
                status = await self._run_once(listener, outlet)
                if self._stopping.is_set():
                    return
                if self._changing:
                    self._changing = False
                    self.is_ready.clear()
                    continue
                if status == STATUS_REFUSED and self._before is not None:
                    _log.error("configuration_refused", side=self.name, keeps="the one before")
                    self._settings, self._before = self._before, None
                    continue
                if status in (STATUS_REFUSED, STATUS_TEMPORARY):
                    raise SideEndedError(self.name, status)
                if self.is_ready.is_set():
                    retry_s = 0.0
                self.is_ready.clear()
                _log.error("side_died", side=self.name, status=status, starts_again_in_s=retry_s)
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(retry_s):
                        await self._stopping.wait()
                retry_s = min(2.0 * retry_s or _RETRY_FIRST_S, RETRY_MOST_S)

    async def stop(self) -> None:
        """Ask the side to end, and end it when it does not in time."""
        self._stopping.set()
        self.terminate()
        limit_s = STOP_S[self.name]
        try:
            async with asyncio.timeout(limit_s):
                await self._gone.wait()
        except TimeoutError:
            self.kill()
            await self._gone.wait()
            _log.error("side_killed", side=self.name, reason=f"did not end within {limit_s:g} s")

    def change(self, settings: Settings) -> None:
        """Start the side again with another configuration; one that it refuses is given up."""
        self._before, self._settings = self._settings, settings
        self._changing = not self._gone.is_set()
        self.terminate()

    def terminate(self) -> None:
        """Ask the process to end."""
        if self._process is not None and not self._gone.is_set():
            self._process.terminate()

    def kill(self) -> None:
        """End the process at once."""
        if self._process is not None and not self._gone.is_set():
            self._process.kill()

    def kill_if_it_hangs(self, machine_is_busy: bool) -> None:
        """Look at the process, and end it when it hangs; it is then started again."""
        if self._process is None or self._gone.is_set() or not self.is_ready.is_set():
            return
        now_s = time.monotonic()
        look = look_at(self._process.pid or 0)
        if machine_is_busy:
            self._silence.excuse()
        if self._silence.is_hanging(look, now_s, self.silent_limit_s):
            silent_s = round(self._silence.lasts_s(now_s), 1)
            self.kill()
            self.listen_from_now()
            _log.error("side_hangs", side=self.name, silent_s=silent_s)

    def listen_from_now(self) -> None:
        """Let its silence begin now: what it said before may not have been heard."""
        self._silence = SilentTime(time.monotonic())

    async def _run_once(self, listener: socket.socket | None, outlet: socket.socket) -> int:
        environment = {
            "NOTIFY_SOCKET": f"fd:{outlet.fileno()}",
            "WATCHDOG_USEC": str(round(min(HUNG_S, self.silent_limit_s) * 1e6)),
        }
        preload()
        self.listen_from_now()
        self._gone.clear()
        try:
            try:
                process = self._process = start(
                    self._work,
                    (self.name, self._settings, environment, listener),
                    [outlet] if listener is None else [outlet, listener],
                )
            except OSError as error:  # no room for a process now; the other sides go on
                _log.error("side_not_started", side=self.name, error=str(error))
                return _STATUS_NOT_STARTED
            await ended(process)
            process.join()
        finally:
            self._gone.set()
        return process.exitcode or 0

    @contextlib.contextmanager
    def _reports(self, on_report: Callable[[SideName, str], None]) -> Iterator[socket.socket]:
        """Listen for what the side reports; gives the socket that its process reports by."""
        loop = asyncio.get_running_loop()

        def take() -> None:
            with contextlib.suppress(BlockingIOError):
                while True:
                    report = inbox.recv(4096).decode(errors="replace")
                    self.listen_from_now()
                    if report == "READY=1":
                        self.is_ready.set()
                        self._before = None
                    on_report(self.name, report)

        # Who does not listen must not hold up who reports.
        kind = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK
        inbox, outlet = socket.socketpair(socket.AF_UNIX, kind)
        with inbox, outlet:
            loop.add_reader(inbox, take)
            try:
                yield outlet
            finally:
                loop.remove_reader(inbox)


async def supervise(
    settings: Settings,
    *,
    listen: Callable[[asyncio.Event], Coroutine[Any, Any, socket.socket]],
    manager: ServiceManager,
    on_ready: Callable[[], None],
    stop: asyncio.Event,
) -> None:
    """Run all sides of a service until ``stop`` is set, then end them: callers first, cell last.

    Raises `SideEndedError` if a side ends with a status that a new start does not cure;
    `ServiceError` if the web side's address cannot be listened on.

    - ``listen``: gives the bound socket for the web side, which alone waits for it; is called with
      the event that the cell is ready.
    - ``manager``: hears of the service as a whole.
    - ``on_ready``: called once, when every side is ready.
    """
    # Many small matrices: threads would only wait for each other. Also for those to come.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if not is_loopback(settings.service.host):
        await _refuse_without_key(settings)
    cell, web, *plant = sides_of(settings)
    sides = [Side(cell, settings)]
    listening = asyncio.ensure_future(listen(sides[0].is_ready))
    sides.append(Side(web, settings, listening))
    sides += [Side(name, settings) for name in plant]
    try:
        await run_sides(
            sides,
            manager=manager,
            on_ready=on_ready,
            stop=stop,
            reload=partial(_read_again, settings, sides),
        )
    finally:
        listening.cancel()
        await asyncio.gather(listening, return_exceptions=True)


async def run_sides(
    sides: Sequence[Side],
    *,
    manager: ServiceManager,
    on_ready: Callable[[], None],
    stop: asyncio.Event,
    reload: Callable[[], Coroutine[Any, Any, None]] | None = None,
) -> None:
    """Run sides, the cell first, until ``stop`` is set; see `supervise`."""
    reloading: set[asyncio.Task[None]] = set()

    def report(side: SideName, text: str) -> None:
        if text == RELOAD and reload is not None:
            task = asyncio.create_task(reload())
            reloading.add(task)
            task.add_done_callback(reloading.discard)
        if side != "cell":
            return
        # Devices are read and kept from when the cell is ready, whatever the others do.
        if text == "READY=1":
            manager.ready()
        elif text.startswith("STATUS="):
            manager.status(text.removeprefix("STATUS="))

    async with _running(sides, report) as running:
        stopping: asyncio.Task[Any] = asyncio.create_task(stop.wait())
        beside: list[asyncio.Task[Any]] = [
            asyncio.create_task(_all_ready(sides, on_ready)),
            asyncio.create_task(_watch(sides)),
            # A side that hangs is dealt with here: the service manager need not do it.
            asyncio.create_task(manager.watch(lambda: True)),
        ]
        try:
            ends: set[asyncio.Task[Any]] = {stopping, *running}
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            for side in running:
                if side.done():
                    side.result()
        finally:
            for task in (*beside, *reloading, stopping):
                task.cancel()
            await asyncio.gather(*beside, *reloading, stopping, return_exceptions=True)
            manager.stopping()


async def _read_again(settings: Settings, sides: Sequence[Side]) -> None:
    """Start all sides again with what the configuration file holds now.

    Where the service listens and keeps its data is fixed at its start.
    """
    try:
        fresh, _ = await asyncio.to_thread(load_site, settings.file)
    except SettingsError as error:
        _log.error("configuration_refused", detail=error.lines[0], keeps="the one before")
        return
    if fresh.service != settings.service:
        _log.warning("configuration", detail="service: takes effect after a restart of the service")
    fresh = fresh.model_copy(update={"service": settings.service})
    _log.info("configuration_changed", file=str(settings.file))
    for side in sides:
        side.change(fresh)


@contextlib.asynccontextmanager
async def _running(
    sides: Sequence[Side], report: Callable[[SideName, str], None]
) -> AsyncIterator[list["asyncio.Task[None]"]]:
    """Run the sides beside the rest; at the end those that answer callers end before the cell."""
    tasks = [asyncio.create_task(side.run(report), name=f"side {side.name}") for side in sides]
    try:
        yield tasks
    finally:
        cell, *others = sides
        await asyncio.gather(*(side.stop() for side in others))
        await cell.stop()
        for task in tasks:  # one that waits for its port has no process yet
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _all_ready(sides: Sequence[Side], on_ready: Callable[[], None]) -> None:
    for side in sides:
        await side.is_ready.wait()
    on_ready()


async def _watch(sides: Sequence[Side]) -> None:
    """Kill what hangs; it is then started again."""
    looked_s = time.monotonic()
    while True:
        await asyncio.sleep(_LOOK_EVERY_S)
        now_s = time.monotonic()
        late_s, looked_s = now_s - looked_s - _LOOK_EVERY_S, now_s
        for side in sides:
            if late_s > _SUSPENDED_S:
                side.listen_from_now()
            else:
                side.kill_if_it_hangs(machine_is_busy=late_s > _LATE_S)


async def _refuse_without_key(settings: Settings) -> None:
    """Refuse at once what the web side would refuse only after the cell is ready.

    Raises `SideEndedError` if no key is valid.
    """
    process = start(key_check_process, (settings,))
    try:
        async with asyncio.timeout(_KEY_CHECK_S):
            await ended(process)
    except TimeoutError:
        process.kill()
        await ended(process)
    process.join()
    if process.exitcode == STATUS_REFUSED:
        raise SideEndedError("web", STATUS_REFUSED)
