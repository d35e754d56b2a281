"""The HTTP server: uvicorn with limits on connections, heads, bodies and answers no one reads.

uvicorn bounds the time between two requests of a connection, but neither the time before the first
one nor that of a body, and it accepts connections until no descriptor is left for the store and
the field buses. All figures are wall time.
"""

import asyncio
import contextlib
import errno
import ipaddress
import os
import resource
import socket
import ssl
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Final

import h11
import structlog
import uvicorn
import websockets.http11
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

HEAD_S: Final = 10.0
BODY_S: Final = 60.0
#: For the application to accept or refuse a stream; those that catch up wait for their turn.
ACCEPT_S: Final = 60.0
#: For a client to read an answer that came before the end of its body.
REFUSED_BODY_S: Final = 5.0
REFUSED_BODY_BYTES: Final = 4 * 1024 * 1024
UNREAD_S: Final = 60.0
CONNECTIONS: Final = 2000
#: Descriptors for everything but the callers of the web side: store, field buses, OPC UA, files.
RESERVED_FILES: Final = 256
_LOG_EVERY_S = 60.0
_REFUSALS_AT_ONCE = 64
_ODD_HEAD = "expected a WebSocket handshake: a request without a body\n"
_SWEEP_TICKS = 10  # of 0.1 s
_OUT_OF_FILES = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)

# A log-in proxy adds cookies of more than 8 KiB. What REST takes is taken of a stream too: the head
# has come whole by then, within the bounds of h11.
websockets.http11.MAX_LINE_LENGTH = 64 * 1024
websockets.http11.MAX_NUM_HEADERS = 256
# What the library takes apart word by word.
_HANDSHAKE_HEADS = (
    *(b"connection", b"upgrade"),
    *(b"sec-websocket-protocol", b"sec-websocket-extensions"),
)
_HANDSHAKE_BYTES = 4096

_log = structlog.get_logger(__name__)


def allow_open_files() -> int:
    """Raise the limit on open files as far as the system lets us; return it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
            soft = hard
    return soft if soft != resource.RLIM_INFINITY else 1 << 20


class Doorway(socket.socket):
    """A listening socket that lets in this many connections in all, and of one address.

    It takes over the descriptor of a bound socket. A client beyond the limits is hung up on
    at once: that costs a few microseconds and no descriptor.

    - ``most``: connections in all. An address may have as many as it leaves free, so that there is
      always one for the next; another machine an eighth at most. On this machine a proxy may stand.
    """

    def __init__(self, listener: socket.socket, most: int) -> None:
        super().__init__(listener.family, listener.type, listener.proto, fileno=listener.detach())
        self.most = most
        self._here: Counter[str] = Counter()
        self._spare = os.open(os.devnull, os.O_RDONLY)
        self._quiet_until_s: dict[str, float] = {}

    @property
    def connections(self) -> int:
        """How many are in."""
        return self._here.total()

    def accept(self) -> tuple[socket.socket, Any]:
        """Give the next connection that is within the limits."""
        for _ in range(_REFUSALS_AT_ONCE):
            try:
                connection, address = super().accept()
            except OSError as error:
                if error.errno not in _OUT_OF_FILES:
                    raise
                self._say("no_file_for_a_connection", error=str(error))
                self._hang_up_on_one()
                continue
            who = _network_of(str(address[0]))
            if self._here[who] >= self._most_of(who):
                self._say("too_many_connections", address=who, connections=self._here.total())
                connection.close()
                continue
            self._here[who] += 1
            return _Counted(connection, partial(self._leave, who)), address
        raise BlockingIOError  # the rest of the queue waits for the others' turn

    def close(self) -> None:
        """Listen no more."""
        super().close()
        if self._spare >= 0:
            os.close(self._spare)
            self._spare = -1

    def _most_of(self, who: str) -> int:
        free = self.most - self._here.total()
        return free if ipaddress.ip_network(who).is_loopback else min(free, self.most // 8)

    def _leave(self, who: str) -> None:
        self._here[who] -= 1
        if not self._here[who]:
            del self._here[who]

    def _hang_up_on_one(self) -> None:
        """Make the queue of connections shorter with the spare descriptor.

        A connection that stays in the queue would wake the event loop without end.
        """
        os.close(self._spare)
        try:
            with contextlib.suppress(OSError):
                super().accept()[0].close()
        finally:
            self._spare = os.open(os.devnull, os.O_RDONLY)

    def _say(self, event: str, **facts: object) -> None:
        now_s = time.monotonic()
        if now_s >= self._quiet_until_s.get(event, 0.0):
            self._quiet_until_s[event] = now_s + _LOG_EVERY_S
            _log.warning(event, **facts)


class _Counted(socket.socket):
    """A connection that says when it is closed."""

    def __init__(self, connection: socket.socket, leave: Callable[[], None]) -> None:
        super().__init__(
            connection.family, connection.type, connection.proto, fileno=connection.detach()
        )
        self._leave: Callable[[], None] | None = leave

    def close(self) -> None:
        super().close()
        leave, self._leave = self._leave, None
        if leave is not None:
            leave()


def _network_of(address: str) -> str:
    """Whom an address belongs to: an IPv4 address, or the 64 bits that an IPv6 host is given."""
    ip = ipaddress.ip_address(address.partition("%")[0])
    mapped = getattr(ip, "ipv4_mapped", None)
    if ip.version == 4 or mapped is not None or ip.is_loopback:
        return str(mapped or ip)
    return str(ipaddress.ip_network((ip, 64), strict=False))


class _Protocol(H11Protocol):
    """A connection that may not keep the server waiting."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._waits_for: tuple[object, ...] = ()
        self._since_s = 0.0
        self._refused_bytes = 0

    def data_received(self, data: bytes) -> None:
        """Read on, but not without end behind an answer that refused the body."""
        if self._is_refused_body():
            self._refused_bytes += len(data)
            if self._refused_bytes > REFUSED_BODY_BYTES:
                self.transport.abort()
                return
        super().data_received(data)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Pass a stream on, unless its head would keep the event loop busy."""
        asked = sum(len(value) for name, value in self.headers if name in _HANDSHAKE_HEADS)
        if asked > _HANDSHAKE_BYTES:
            self.send_400_response("Too long a WebSocket handshake.")
        else:
            super().handle_websocket_upgrade(event)

    def limit(self, now_s: float) -> None:
        """Hang up when what this connection waits for has not come in time."""
        limit_s: float | None = None
        waits_for: tuple[object, ...] = (self.cycle,)
        if self.flow.write_paused:
            limit_s, waits_for = UNREAD_S, ("reader", self.transport.get_write_buffer_size())
        elif self._is_refused_body():
            limit_s, waits_for = REFUSED_BODY_S, ("refused body", self.cycle)
        elif self.conn.their_state is h11.SEND_BODY:
            limit_s, waits_for = BODY_S, ("body", self.cycle)
        elif self.conn.their_state is h11.IDLE:
            limit_s, waits_for = HEAD_S, ("head", self.cycle)
        if waits_for != self._waits_for:
            self._waits_for, self._since_s = waits_for, now_s
        elif limit_s is not None and now_s - self._since_s > limit_s:
            self.transport.abort()

    def _is_refused_body(self) -> bool:
        return self.conn.their_state is h11.SEND_BODY and self.conn.our_state is h11.DONE


class _StreamProtocol(WebSocketsSansIOProtocol):
    """A connection that has asked for a WebSocket and is always answered, or hung up on."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._since_s = time.monotonic()
        self._closing_since_s: float | None = None

    def data_received(self, data: bytes) -> None:
        """Read on; refuse a head that the library cannot read, which it would not answer."""
        if self.transport.is_closing():
            return
        super().data_received(data)
        if self.conn.handshake_exc is not None and not self.handshake_initiated:
            # Of a head that is too long the library has made its answer, of one that is odd none.
            answer = b"".join(self.conn.data_to_send())
            self.transport.write(answer or self.conn.reject(400, _ODD_HEAD).serialize())
            self.handshake_complete = self.close_sent = True
            self.transport.close()

    def limit(self, now_s: float) -> None:
        """Hang up when a stream was not answered in time, or its end was not read."""
        if self.transport.is_closing():
            self._closing_since_s = self._closing_since_s or now_s
            is_over = now_s - self._closing_since_s > UNREAD_S
        else:
            is_over = not self.handshake_complete and now_s - self._since_s > ACCEPT_S
        if is_over:
            self.transport.abort()


class WebServer(uvicorn.Server):
    """uvicorn without its signal handling, as the service stops as one whole, and with limits.

    ``most_connections``: more are hung up on; of the last eighth of them requests are answered with
    status 503.
    """

    def __init__(self, app: ASGIApp, most_connections: int, tls: ssl.SSLContext | None) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                http=_Protocol,
                ws=_StreamProtocol,
                limit_concurrency=most_connections - most_connections // 8,
                log_config=None,
                access_log=False,
                proxy_headers=False,  # the application knows which proxies to believe
                timeout_graceful_shutdown=2,
                server_header=False,
                ws_per_message_deflate=False,
                ws_max_size=64 * 1024,
                ssl_context_factory=None if tls is None else lambda config, default: tls,
            )
        )

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave the signals to the service."""
        yield

    async def on_tick(self, counter: int) -> bool:
        """Look after the connections once a second."""
        if counter % _SWEEP_TICKS == 0:
            now_s = time.monotonic()
            for connection in list(self.server_state.connections):
                if isinstance(connection, _Protocol | _StreamProtocol):
                    connection.limit(now_s)
        return await super().on_tick(counter)


def serve_web(
    app: ASGIApp, listener: socket.socket, tls: ssl.SSLContext | None
) -> tuple[WebServer, Doorway]:
    """Put a server before an application, with as many connections as the system has files for."""
    most = max(min(CONNECTIONS, allow_open_files() - RESERVED_FILES), 16)
    return WebServer(app, most, tls), Doorway(listener, most)
