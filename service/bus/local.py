"""A bus between the processes of one machine: ZeroMQ over local sockets.

Changes go from a PUB socket to any number of SUB sockets, commands from DEALER sockets to one
ROUTER. ZeroMQ drops a change silently for a reader whose queue is full: changes are numbered.
"""

import asyncio
import contextlib
import threading
import time
import uuid
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path
from typing import Any, Final

import msgspec
import structlog
import zmq
import zmq.asyncio

from service.bus.asking import Asking
from service.bus.dispatch import Dispatcher
from service.bus.interface import AWAY_AFTER_S, STATE_EVERY_S, STATE_TOPIC, Handlers
from service.bus.messages import AnswerT, CellState, Change, Command, encode
from service.bus.places import CHANGES, COMMANDS, bus_folder
from service.domain.errors import CellUnavailableError

#: Messages that wait for one reader, or of one caller.
QUEUE: Final = 1000
#: The longest message: 20,000 pushed samples take 0.4 MiB.
LONGEST_MESSAGE: Final = 16 * 1024 * 1024
#: Commands that are taken each second, and in a row after a pause: a caller that floods the bus
#: gets no more of the cell's time than that.
_RATE: Final = 4000.0
_ROW: Final = 64.0
_RECONNECT_MS: Final = (50, 500)

_log = structlog.get_logger(__name__)


class LocalCellBus:
    """The cell's end; see `service.bus.interface.CellBus`.

    Only who holds the data directory may make one: it takes the place of the sockets of an
    earlier run.

    Parameters
    ----------
    data_dir : pathlib.Path
        The service's directory.
    """

    def __init__(self, data_dir: Path) -> None:
        self.epoch = uuid.uuid4().hex[:12]
        self._state = CellState()
        self._reports = 0
        self._context = zmq.asyncio.Context()
        folder = bus_folder(data_dir)
        # Plain: a PUB socket never waits, and needs no event loop for it.
        self._changes: zmq.Socket[bytes] = zmq.Context(self._context).socket(zmq.PUB)
        self._commands = self._context.socket(zmq.ROUTER)
        self._lock = threading.Lock()
        with contextlib.ExitStack() as failing:
            failing.callback(self.close)
            for socket, name in ((self._changes, CHANGES), (self._commands, COMMANDS)):
                socket.linger = 0
                socket.sndhwm = socket.rcvhwm = QUEUE
                socket.maxmsgsize = LONGEST_MESSAGE
                path = folder / name
                path.unlink(missing_ok=True)
                socket.bind(f"ipc://{path}")
                path.chmod(0o600)
            failing.pop_all()

    def close(self) -> None:
        """Close the sockets."""
        self._changes.close()
        self._commands.close()
        self._context.term()

    def publish(self, topic: str, number: int, body: bytes) -> None:
        """See `service.bus.interface.CellBus.publish`."""
        frames = [topic.encode(), encode(Change(self.epoch, number, body))]
        with self._lock, contextlib.suppress(zmq.Again):
            if not self._changes.closed:
                self._changes.send_multipart(frames, zmq.NOBLOCK)

    def report(self, state: CellState) -> None:
        """See `service.bus.interface.CellBus.report`."""
        before, self._state = self._state, state
        if (before.waits_for, before.ready) != (state.waits_for, state.ready):
            self._report()

    def _report(self) -> None:
        self._reports += 1
        self.publish(STATE_TOPIC, self._reports, encode(self._state))

    async def serve(self, handlers: Handlers) -> None:
        """See `service.bus.interface.CellBus.serve`."""
        dispatcher = Dispatcher(handlers)
        reporting = asyncio.create_task(self._keep_reporting())
        left, seen_s = _ROW, time.monotonic()
        try:
            while True:
                frames = await self._commands.recv_multipart()
                if len(frames) == 2:
                    dispatcher.take(frames[0], frames[1], partial(self._send, frames[0]))
                now_s = time.monotonic()
                left, seen_s = min(left + _RATE * (now_s - seen_s), _ROW) - 1.0, now_s
                # What is there already is given at once: without a pause no one else had a turn.
                await asyncio.sleep(0.0 if left > 0.0 else _ROW / _RATE / 4.0)
        finally:
            reporting.cancel()
            await dispatcher.close()
            await asyncio.gather(reporting, return_exceptions=True)

    async def _keep_reporting(self) -> None:
        while True:
            self._report()
            await asyncio.sleep(STATE_EVERY_S)

    def _send(self, caller: bytes, body: bytes) -> None:
        # A ROUTER drops what is for a caller who is gone or does not read.
        _ended(self._commands.send_multipart([caller, body], zmq.NOBLOCK))


class LocalReaderBus:
    """The end of the web side or of the plant side; see `service.bus.interface.ReaderBus`.

    Parameters
    ----------
    data_dir : pathlib.Path
        The service's directory.
    """

    def __init__(self, data_dir: Path) -> None:
        self.epoch = ""
        self.state = CellState()
        self._heard_s = time.monotonic() - AWAY_AFTER_S
        self._folder = bus_folder(data_dir)
        self._context = zmq.asyncio.Context()
        self._commands = self._socket(zmq.DEALER, COMMANDS)
        self._asking = Asking(self._send)
        self._state_decoder = msgspec.msgpack.Decoder(CellState)
        self._change_decoder = msgspec.msgpack.Decoder(Change)

    def close(self) -> None:
        """Close the sockets."""
        self._context.destroy(linger=0)

    @property
    def away_s(self) -> float:
        """See `service.bus.interface.ReaderBus.away_s`."""
        return time.monotonic() - self._heard_s

    async def run(self) -> None:
        """See `service.bus.interface.ReaderBus.run`."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._take_answers())
            tasks.create_task(self._follow_state())

    async def changes(self, topic: str) -> AsyncIterator[Change]:
        """See `service.bus.interface.ReaderBus.changes`."""
        socket = self._socket(zmq.SUB, CHANGES)
        socket.subscribe(topic.encode())
        try:
            while True:
                _, body = await socket.recv_multipart()
                yield self._change_decoder.decode(body)
        finally:
            socket.close()

    async def ask(self, command: Command[AnswerT], patience_s: float) -> AnswerT:
        """See `service.bus.interface.ReaderBus.ask`."""
        if self.away_s > AWAY_AFTER_S:
            raise CellUnavailableError(f"no sign of the cell for {self.away_s:.0f} s")
        return await self._asking.ask(command, patience_s)

    def _socket(self, kind: int, name: str) -> "zmq.asyncio.Socket":
        socket = self._context.socket(kind)
        socket.linger = 0
        socket.sndhwm = socket.rcvhwm = QUEUE
        socket.maxmsgsize = LONGEST_MESSAGE
        socket.reconnect_ivl, socket.reconnect_ivl_max = _RECONNECT_MS
        socket.connect(f"ipc://{self._folder / name}")
        return socket

    def _send(self, request: bytes, patience_s: float) -> None:
        if _ended(self._commands.send(request, zmq.NOBLOCK)) is not None:
            raise CellUnavailableError("the cell takes no more commands")

    async def _take_answers(self) -> None:
        while True:
            self._asking.take(await self._commands.recv())

    async def _follow_state(self) -> None:
        async for change in self.changes(STATE_TOPIC):
            self._heard_s = time.monotonic()
            self.state = self._state_decoder.decode(change.body)
            if change.epoch != self.epoch:
                if self.epoch:
                    _log.warning("cell_started_again", epoch=change.epoch)
                    self._asking.give_up("the cell has started again")
                self.epoch = change.epoch


def _ended(sending: Any) -> BaseException | None:
    """How a send ended that must not wait: it is over when it returns."""
    error: BaseException | None = sending.exception()
    return error
