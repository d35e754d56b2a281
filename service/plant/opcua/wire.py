"""The OPC UA server's connections: limited in number and size, encrypted where keys are needed."""

import asyncio
from typing import Any, Final

import structlog
from asyncua import Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import Buffer, ServiceError
from asyncua.crypto.permission_rules import ADMIN_TYPES, USER_TYPES
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import struct_from_binary

from service.security.sites import site_of

KIB = 1024
#: Of a message in pieces; the announced size of a piece is at most 64 KiB.
MOST_MESSAGE_BYTES = 1024 * KIB
MOST_BYTES_BEFORE_ACTIVATION = 64 * KIB
MOST_MESSAGES_BEFORE_ACTIVATION = 32
MOST_CONNECTIONS = 50
#: Connections of one address that have not shown a key yet.
MOST_STRANGERS = 10
ACTIVATION_S = 30.0
_MOST_WAITING = 64
_CHUNK_HEAD = 8

_DISCOVERY: Final = tuple(
    ua.NodeId(number)
    for number in (
        ua.ObjectIds.GetEndpointsRequest_Encoding_DefaultBinary,
        ua.ObjectIds.FindServersRequest_Encoding_DefaultBinary,
        ua.ObjectIds.CloseSecureChannelRequest_Encoding_DefaultBinary,
    )
)
_CREATE_SESSION = ua.NodeId(ua.ObjectIds.CreateSessionRequest_Encoding_DefaultBinary)
_BROWSE_NEXT = ua.NodeId(ua.ObjectIds.BrowseNextRequest_Encoding_DefaultBinary)
_ACTIVATE_SESSION = ua.NodeId(ua.ObjectIds.ActivateSessionRequest_Encoding_DefaultBinary)

#: Services that the library has, for users with and without rights.
_SERVICES: Final = frozenset(ua.NodeId(number) for number in (*ADMIN_TYPES, *USER_TYPES))
#: Status of a request with a number that an enumeration does not have, by its name: the library
#: takes it for an error of its own.
_OF_UNKNOWN_NUMBERS: Final = {
    "TimestampsToReturn": ua.StatusCodes.BadTimestampsToReturnInvalid,
    "MonitoringMode": ua.StatusCodes.BadMonitoringModeInvalid,
    "BrowseDirection": ua.StatusCodes.BadBrowseDirectionInvalid,
}

_log = structlog.get_logger(__name__)


class BoundedServer(Server):  # type: ignore[misc]  # the library has no types
    """The library's server on connections that are `_Connection`.

    ``encrypted``: whether a session is had on an encrypted connection only.
    """

    def __init__(self, iserver: Any, encrypted: bool) -> None:
        super().__init__(iserver=iserver)
        self._encrypted = encrypted
        iserver.max_connections = MOST_CONNECTIONS
        iserver.max_pending_messages_per_connection = _MOST_WAITING
        iserver.max_pending_activation_seconds = ACTIVATION_S
        iserver.max_unacked_messages_per_subscription = 100
        iserver.max_monitored_item_queue_size = 100
        pieces = MOST_MESSAGE_BYTES // self.limits.max_recv_buffer + 1
        self.limits.max_message_size, self.limits.max_chunk_count = MOST_MESSAGE_BYTES, pieces

    async def start(self) -> None:
        """Listen, as the library's, but for the connections."""
        await self._setup_server_nodes()
        await self.iserver.start()
        host, port = self._get_bind_socket_info()
        self.bserver = _Listener(self.iserver, host, port, self.limits, self._encrypted)
        self.bserver.set_policies(self._policies)
        try:
            await self.bserver.start()
        except BaseException:
            await self.iserver.stop()
            raise


class _Listener(BinaryServer):  # type: ignore[misc]
    def __init__(
        self, iserver: Any, host: str, port: int, limits: TransportLimits, encrypted: bool
    ) -> None:
        super().__init__(iserver, host, port, limits)
        self._encrypted = encrypted

    def _make_protocol(self) -> OPCUAProtocol:
        return _Connection(
            self._encrypted,
            iserver=self.iserver,
            policies=self._policies,
            clients=self.clients,
            closing_tasks=self.closing_tasks,
            limits=self.limits,
        )


class _Connection(OPCUAProtocol):  # type: ignore[misc]
    """One client; what it sends is bounded before anything of it is understood."""

    processor: Any

    def __init__(self, encrypted: bool, **arguments: Any) -> None:
        super().__init__(**arguments)
        self._encrypted = encrypted
        self._received = bytearray()
        self._messages_taken = 0

    @property
    def is_activated(self) -> bool:
        """Whether the client has shown a key, or needs none."""
        session = self.processor.session if self.processor is not None else None
        return session is not None and bool(session.is_activated())

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        site = site_of(transport.get_extra_info("peername")[0])
        strangers = [
            one
            for one in self.clients
            if not one.is_activated and site_of(one.peer_name[0]) == site
        ]
        if len(strangers) >= MOST_STRANGERS:
            transport.close()
            return
        super().connection_made(transport)
        if self.processor is not None:
            self.processor = _Processor(self.iserver, self.transport, self.limits, self._encrypted)
            self.processor.set_policies(self.policies)

    def data_received(self, data: bytes) -> None:
        """Hand on whole pieces; the library would wait for whatever size is announced."""
        if self.processor is None or self.transport is None:
            return
        self._received += data
        while len(self._received) >= _CHUNK_HEAD and not self.transport.is_closing():
            size = int.from_bytes(self._received[4:_CHUNK_HEAD], "little")
            if not _CHUNK_HEAD <= size <= self.processor.longest_piece:
                self._refuse(f"a piece of {size} bytes")
                return
            if len(self._received) < size:
                return
            piece = bytes(self._received[:size])
            del self._received[:size]
            super().data_received(piece)

    async def _process_one_msg(self, header: Any, buf: Buffer) -> bool:
        if self.processor is None or self.transport is None:
            return False
        if not self.is_activated:
            self._messages_taken += 1
            if self._messages_taken > MOST_MESSAGES_BEFORE_ACTIVATION:
                self._refuse(f"more than {MOST_MESSAGES_BEFORE_ACTIVATION} messages")
                return False
        try:
            goes_on = bool(await super()._process_one_msg(header, buf))
        except Exception as error:
            # A piece that is no piece: what follows on this connection means nothing.
            self._refuse(f"{type(error).__name__}")
            return False
        if not self.is_activated and self.processor.bytes_in_pieces > MOST_BYTES_BEFORE_ACTIVATION:
            self._refuse(f"a message of more than {MOST_BYTES_BEFORE_ACTIVATION} bytes")
            return False
        await asyncio.sleep(0)  # one client's row of messages does not hold up the machine's data
        return goes_on

    def _refuse(self, what: str) -> None:
        """Close; what was received is forgotten."""
        self._received.clear()
        if self.transport is not None and not self.transport.is_closing():
            when = "after" if self.is_activated else "before"
            _log.info("opcua_closed", peer=str(self.peer_name), reason=f"{what} {when} activation")
            self.transport.close()


class _Processor(UaProcessor):  # type: ignore[misc]
    def __init__(
        self, iserver: Any, transport: Any, limits: TransportLimits, encrypted: bool
    ) -> None:
        super().__init__(iserver, transport, limits)
        self._encrypted = encrypted

    @property
    def longest_piece(self) -> int:
        """Bytes of a piece, as agreed with the client; at most 64 KiB."""
        return int(self._limits.max_recv_buffer)

    @property
    def bytes_in_pieces(self) -> int:
        """Bytes of a message whose last piece has not come yet."""
        return int(self._connection._incoming_size)

    async def _process_message(
        self, typeid: ua.NodeId, requesthdr: Any, seqhdr: Any, body: Buffer
    ) -> Any:
        # The library opens a connection without security even where it offers none.
        in_clear = self._connection.security_policy.Mode == ua.MessageSecurityMode.None_
        if self._encrypted and in_clear and typeid not in _DISCOVERY:
            raise ServiceError(ua.StatusCodes.BadSecurityModeInsufficient)
        if typeid == _CREATE_SESSION and self.session is not None:
            # One at a time: the library forgets the one before, and what it holds.
            await self.session.close_session()
        if typeid == _ACTIVATE_SESSION and self.session is not None:
            await self.session.admit(struct_from_binary(ua.ActivateSessionParameters, body.copy()))
        if typeid == _BROWSE_NEXT and self.session is not None and self.session.is_activated():
            # The library has the service, and no way to it.
            params = struct_from_binary(ua.BrowseNextParameters, body)
            response = ua.BrowseNextResponse()
            response.Parameters.Results = await self.session.browse_next(params)
            self.send_response(requesthdr.RequestHandle, seqhdr, response)
            return True
        if typeid not in _SERVICES:
            # The library says that a user without rights may not.
            raise ServiceError(ua.StatusCodes.BadServiceUnsupported)
        try:
            return await super()._process_message(typeid, requesthdr, seqhdr, body)
        except ValueError as error:
            status = _OF_UNKNOWN_NUMBERS.get(str(error).rpartition(" ")[2])
            if status is None:
                raise
            raise ServiceError(status) from error
