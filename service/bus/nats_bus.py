"""A bus between the processes of several machines: NATS.

What goes over it may be lost: changes are numbered, commands are answered or not. Nothing is kept
for a server that is unreachable: old changes are worth nothing, and the client has gone.
"""

import asyncio
import contextlib
import ssl
import struct
import threading
import time
import zlib
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import partial
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

import msgspec
import structlog

from service.bus.asking import Asking
from service.bus.dispatch import Dispatcher
from service.bus.interface import AWAY_AFTER_S, STATE_EVERY_S, Handlers
from service.bus.messages import AnswerT, CellState, Change, Command, encode
from service.domain.errors import CellUnavailableError

if TYPE_CHECKING:
    from nats.aio.client import Client
    from nats.aio.msg import Msg

#: Messages that wait for the server, or for one reader.
QUEUE: Final = 4000
#: Longer messages go compressed: the server takes none above one MiB.
_COMPRESSED_FROM: Final = 8192
#: No message is longer once it is unpacked; a few kB could stand for gigabytes.
UNPACKED_MAX: Final = 16 * 2**20
_PLAIN, _COMPRESSED = b"\0", b"\1"
_RECONNECT_S: Final = 1
_PING_S: Final = 5
#: Before a command: who asks, and how many seconds the answer may take.
_ASKED: Final = struct.Struct("<8sd")
STATES: Final = "bearing-twin.state"
_CELLS: Final = "bearing-twin.cell"

_log = structlog.get_logger(__name__)

Take = Callable[["Msg"], Awaitable[None]]


class NatsConnection:
    """One connection to the server, made again as often as it is lost.

    Parameters
    ----------
    url : str
        Of the server, with token or password.
    tls : ssl.SSLContext, optional
        Where the address begins with ``tls://``.
    name : str
        Of this process, for the server's lists.
    """

    def __init__(self, url: str, tls: ssl.SSLContext | None, name: str) -> None:
        self._url, self._tls, self._name = url, tls, name
        self._client: Client | None = None
        self._wanted: list[tuple[str, Take]] = []
        self._outgoing: deque[tuple[str, str, bytes]] = deque(maxlen=QUEUE)
        self._something = asyncio.Event()
        self._ready = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self._thread = threading.get_ident()

    @property
    def connected(self) -> bool:
        """Whether the server is there."""
        return self._client is not None and self._client.is_connected

    def listen(self, subject: str, take: Take) -> None:
        """Have messages of a subject given to a function; to be called before `run`."""
        self._wanted.append((subject, take))

    async def follow(self, subject: str) -> AsyncIterator[bytes]:
        """Give the messages of a subject as they come; some may be missing."""
        queue: asyncio.Queue[bytes] = asyncio.Queue(QUEUE)

        async def take(message: "Msg") -> None:
            if not queue.full():
                queue.put_nowait(message.data)

        await self._ready.wait()
        if self._client is None:
            raise CellUnavailableError("the bus has ended")
        subscription = await self._client.subscribe(subject, cb=take)
        try:
            while True:
                yield unpacked(await queue.get())
        finally:
            with contextlib.suppress(Exception):  # the connection may be gone
                await subscription.unsubscribe()

    def send(self, subject: str, body: bytes, reply: str = "") -> None:
        """Send a message, if the server is there; may be called from any thread."""
        if not self.connected:
            return
        self._outgoing.append((subject, reply, body))
        if threading.get_ident() == self._thread:
            self._something.set()
        elif not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._something.set)

    async def run(self) -> None:
        """Keep the connection until cancelled."""
        from nats.aio.client import Client

        reported = ""

        async def on_error(error: Exception) -> None:
            nonlocal reported
            reason = f"{type(error).__name__}: {error}".strip()
            if reason != reported:
                reported = reason
                _log.warning("nats_error", reason=reason)

        async def on_change(what: str) -> None:
            _log.info(what)

        client = self._client = Client()
        place = urlsplit(self._url)
        connecting = client.connect(
            self._url,
            name=self._name,
            tls=self._tls,
            # Also for the other servers of a cluster, which the first one names without them.
            user=place.username if place.password is not None else None,
            password=place.password,
            token=place.username if place.password is None else None,
            allow_reconnect=True,
            max_reconnect_attempts=-1,
            reconnect_time_wait=_RECONNECT_S,
            connect_timeout=5,
            ping_interval=_PING_S,
            max_outstanding_pings=2,
            error_cb=on_error,
            disconnected_cb=partial(on_change, "nats_away"),
            reconnected_cb=partial(on_change, "nats_there_again"),
        )
        try:
            await connecting
            for subject, take in self._wanted:
                await client.subscribe(subject, cb=take)
            self._ready.set()
            while True:
                await self._something.wait()
                self._something.clear()
                await self._send_waiting(client)
        finally:
            with contextlib.suppress(Exception):
                await client.close()

    async def _send_waiting(self, client: "Client") -> None:
        from nats.errors import Error

        while self._outgoing:
            subject, reply, body = self._outgoing.popleft()
            if not client.is_connected:
                continue
            if len(body) > client.max_payload:
                _log.error("bus_message_too_long", subject=subject, bytes=len(body))
                continue
            try:
                await client.publish(subject, body, reply=reply)
            except (Error, OSError) as error:
                _log.debug("nats_message_lost", reason=str(error))


def packed(body: bytes) -> bytes:
    """Write a message, compressed where that pays."""
    if len(body) < _COMPRESSED_FROM:
        return _PLAIN + body
    return _COMPRESSED + zlib.compress(body, 1)


def unpacked(body: bytes) -> bytes:
    """Read a message; an empty one where it cannot be, or would be longer than any of ours."""
    if body[:1] == _PLAIN:
        return body[1:]
    unpacking = zlib.decompressobj()
    try:
        message = unpacking.decompress(body[1:], UNPACKED_MAX)
    except zlib.error:
        return b""
    if not unpacking.eof:
        _log.warning("bus_message_not_unpacked", bytes=len(body), unpacked_max=UNPACKED_MAX)
        return b""
    return message


class NatsCellBus:
    """The cell's end; see `service.bus.interface.CellBus`.

    Parameters
    ----------
    connection : NatsConnection
        Not running yet.
    run : str
        Name of this run of the cell.
    """

    def __init__(self, connection: NatsConnection, run: str) -> None:
        self.epoch = token_of(run)
        self._connection = connection
        self._state = CellState()
        self._reports = 0
        self._place = f"{_CELLS}.{self.epoch}"
        self._dispatcher: Dispatcher | None = None
        connection.listen(f"{self._place}.ask", self._take)

    def publish(self, topic: str, number: int, body: bytes) -> None:
        """See `service.bus.interface.CellBus.publish`."""
        change = packed(encode(Change(self.epoch, number, body)))
        self._connection.send(changes_of(self.epoch, topic), change)

    def report(self, state: CellState) -> None:
        """See `service.bus.interface.CellBus.report`."""
        before, self._state = self._state, state
        known = before.waits_for, before.ready, before.partitions, before.followed
        if known != (state.waits_for, state.ready, state.partitions, state.followed):
            self._report()

    def _report(self) -> None:
        self._reports += 1
        change = encode(Change(self.epoch, self._reports, encode(self._state)))
        self._connection.send(f"{STATES}.{self.epoch}", packed(change))

    async def serve(self, handlers: Handlers) -> None:
        """See `service.bus.interface.CellBus.serve`."""
        self._dispatcher = Dispatcher(handlers)
        try:
            while True:
                self._report()
                await asyncio.sleep(STATE_EVERY_S)
        finally:
            dispatcher, self._dispatcher = self._dispatcher, None
            await dispatcher.close()

    async def _take(self, message: "Msg") -> None:
        body = unpacked(message.data)
        if self._dispatcher is None or len(body) < _ASKED.size:
            return
        caller, patience_s = _ASKED.unpack_from(body)
        answer = partial(self._answer, message.reply)
        self._dispatcher.take(caller, body[_ASKED.size :], answer, patience_s)
        # What is there already is given at once: without a pause no one else had a turn.
        await asyncio.sleep(0)

    def _answer(self, reply: str, body: bytes) -> None:
        self._connection.send(reply, packed(body))


class CellLink:
    """One cell of a fleet, for a web or plant side; see `service.bus.interface.ReaderBus`.

    Parameters
    ----------
    connection : NatsConnection
        Of this process.
    token : str
        Names the run of the cell.
    caller : bytes
        Names this process.
    """

    def __init__(self, connection: NatsConnection, token: str, caller: bytes) -> None:
        self.epoch = token
        self.state = CellState()
        self._connection = connection
        self._caller = caller
        self._heard_s = time.monotonic()
        self._asking = Asking(self._send)
        self._inbox = f"{inbox(caller)}.{token}"

    @property
    def away_s(self) -> float:
        """See `service.bus.interface.ReaderBus.away_s`."""
        return time.monotonic() - self._heard_s

    @property
    def alive(self) -> bool:
        """Whether it takes commands."""
        return self.state.ready and self.away_s < AWAY_AFTER_S

    def take_state(self, state: CellState) -> None:
        """Record a sign of life."""
        self._heard_s = time.monotonic()
        self.state = state

    def lose(self) -> None:
        """End what waits for an answer: the cell is gone."""
        self._asking.give_up("the cell is gone")

    def take_answer(self, answer: bytes) -> None:
        """Bring an answer to who waits for it."""
        self._asking.take(answer)

    async def run(self) -> None:
        """See `service.bus.interface.ReaderBus.run`: the connection of all cells is one."""
        await asyncio.Event().wait()

    async def changes(self, topic: str) -> AsyncIterator[Change]:
        """See `service.bus.interface.ReaderBus.changes`."""
        decoder = msgspec.msgpack.Decoder(Change)
        async for body in self._connection.follow(changes_of(self.epoch, topic)):
            with contextlib.suppress(msgspec.DecodeError):
                yield decoder.decode(body)

    async def ask(self, command: Command[AnswerT], patience_s: float) -> AnswerT:
        """See `service.bus.interface.ReaderBus.ask`."""
        if self.away_s > AWAY_AFTER_S:
            raise CellUnavailableError(f"no sign of the cell for {self.away_s:.0f} s")
        return await self._asking.ask(command, patience_s)

    def _send(self, request: bytes, patience_s: float) -> None:
        if not self._connection.connected:
            raise CellUnavailableError("the bus to the cells is away")
        body = packed(_ASKED.pack(self._caller, patience_s) + request)
        self._connection.send(f"{_CELLS}.{self.epoch}.ask", body, self._inbox)


def changes_of(cell: str, topic: str) -> str:
    """Subject of the changes of a topic that a cell reports; ``*`` stands for every cell."""
    return f"{_CELLS}.{cell}.change.{topic}"


def inbox(caller: bytes) -> str:
    """Subject that answers for a process come under; the last part names the cell."""
    return f"bearing-twin.answers.{caller.hex()}"


def token_of(run: str) -> str:
    """Name a run of a cell as a part of a subject."""
    return run.rpartition(" ")[2]
