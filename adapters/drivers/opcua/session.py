"""One session with an OPC UA server: connected, subscribed, gone; a new one for each connection."""

import asyncio
import contextlib
import hashlib
import logging
import os
import struct
from collections import deque
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from asyncua import Client, ua
from asyncua.client.ua_client import UaClientState
from asyncua.crypto import uacrypto
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.ua.uaerrors import UaError
from cryptography import x509

from adapters import AdapterError
from adapters.drivers.opcua.config import OpcUaSource
from adapters.drivers.opcua.units import NODES_PER_REQUEST, StatedUnits, stated_units, value_of

# Whatever goes wrong is reported once, by the driver; the library logs every failed attempt.
if logging.getLogger("asyncua").level == logging.NOTSET:
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)

QUEUED_VALUES = 100_000  # notifications that wait for the driver; the oldest go first
_QUEUE_OF_A_NODE = 100
_CLOSE_S = 0.8
_APPLICATION_URI = "urn:bearing-twin:client"

WENT_WRONG = (
    *(OSError, asyncio.TimeoutError, asyncio.IncompleteReadError),
    *(UaError, ValueError, struct.error),
)
"""What the library raises when a server is away, hangs or talks nonsense."""


class SessionError(AdapterError):
    """The server cannot be used now; the message says why."""


class Session:
    """A connection with its subscription.

    - ``changed``: set when notifications wait, or the connection is lost.
    - ``lost``: why the connection is of no use any more; empty while it is.
    - ``dropped``: notifications that were not taken in time.
    """

    def __init__(self, source: OpcUaSource) -> None:
        self._source = source
        self._client: Any = None
        self._nodes: dict[str, Any] = {}
        self._names: dict[Any, list[str]] = {}
        self._waiting: deque[tuple[str, Any]] = deque(maxlen=QUEUED_VALUES)
        self.changed = asyncio.Event()
        self.lost = ""
        self.dropped = 0

    async def open(self, nodes: Iterable[str]) -> dict[str, str]:
        """Connect and subscribe to nodes; returns those that the server does not give, and why.

        Raises `SessionError`: not reached, not let in, or another server than the pinned one.
        """
        try:
            await self._connect()
            return await self._subscribe(list(dict.fromkeys(nodes)))
        except WENT_WRONG as error:
            await self.close()
            raise SessionError(self._why(error)) from error
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """End it; waits for the server only a moment."""
        client, self._client = self._client, None
        self.lost = self.lost or "closed"
        if client is None:
            return
        with contextlib.suppress(*WENT_WRONG):
            async with asyncio.timeout(_CLOSE_S):
                await client.disconnect()
        with contextlib.suppress(*WENT_WRONG):
            client.disconnect_socket()

    def take(self) -> list[tuple[str, Any]]:
        """Return the notifications that wait: node and data value, in the order of their coming."""
        self.changed.clear()
        found = list(self._waiting)
        self._waiting.clear()
        return found

    async def read(self, nodes: Sequence[str]) -> list[tuple[str, Any]]:
        """Read nodes whose names the server knows. Raises `SessionError` if it does not answer."""
        known = [name for name in nodes if name in self._nodes]
        found: list[tuple[str, Any]] = []
        try:
            for begin in range(0, len(known), NODES_PER_REQUEST):
                names = known[begin : begin + NODES_PER_REQUEST]
                request = ua.ReadParameters()
                request.MaxAge = 0
                request.TimestampsToReturn = ua.TimestampsToReturn.Both
                request.NodesToRead = [value_of(self._nodes[name]) for name in names]
                values = await self._client.uaclient.read(request)
                found += zip(names, values, strict=True)
        except WENT_WRONG as error:
            raise SessionError(self._why(error)) from error
        return found

    async def stated_units(self, nodes: Iterable[str]) -> StatedUnits:
        """Ask for the units of nodes that the server knows. Raises `SessionError`."""
        known = {name: self._nodes[name] for name in nodes if name in self._nodes}
        client = self._client.uaclient
        try:
            found = await stated_units(client, known)
        except WENT_WRONG as error:
            raise SessionError(self._why(error)) from error
        # A server that closes the connection has answered as one that cannot say it now.
        if found.unanswered and client.state is not UaClientState.CONNECTED:
            raise SessionError(next(iter(found.unanswered.values())))
        return found

    async def history(self, node: str, begin: Any, end: Any) -> list[Any]:
        """Read the recorded values of a node, ends included. Raises `SessionError`."""
        try:
            found = self._client.get_node(self._nodes[node])
            values = await found.read_raw_history(begin, end, return_bounds=False)
            return list(values)
        except WENT_WRONG as error:
            raise SessionError(self._why(error)) from error

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        """Take a notification (the library's name)."""
        for name in self._names.get(node.nodeid, ()):
            self.dropped += len(self._waiting) == QUEUED_VALUES
            self._waiting.append((name, data.monitored_item.Value))
        self.changed.set()

    def status_change_notification(self, status: Any) -> None:
        """Record that the server has ended the subscription (the library's name)."""
        self.lose(f"the server ended the subscription: {getattr(status, 'Status', status)}")

    async def _connect(self) -> None:
        source = self._source
        if source.server_certificate is not None:
            await self._compare_certificates(source.server_certificate)
        client = Client(source.endpoint, timeout=source.timeout_s)
        client.name = "Bearing Twin"
        client.application_uri = _APPLICATION_URI
        if source.certificate is not None:
            client.application_uri = _uri_in(_certificate(source.certificate)) or _APPLICATION_URI
            assert source.private_key is not None  # noqa: S101 - by the configuration's model
            assert source.server_certificate is not None  # noqa: S101
            await client.set_security(
                SecurityPolicyBasic256Sha256,
                _file(source.certificate),
                _file(source.private_key),
                server_certificate=_file(source.server_certificate),
                mode=ua.MessageSecurityMode.SignAndEncrypt,
            )
        if source.user is not None:
            client.set_user(source.user)
            client.set_password(os.environ.get(source.password_variable or "", ""))
        client.connection_lost_callback = self._on_lost
        self._client = client
        await client.connect()

    async def _compare_certificates(self, pinned: Path) -> None:
        """Say plainly that another server answers; the library would only run into its time-out."""
        client = Client(self._source.endpoint, timeout=self._source.timeout_s)
        endpoints = await client.connect_and_get_server_endpoints()
        expected = uacrypto.der_from_x509(_certificate(pinned))
        shown = {one.ServerCertificate for one in endpoints if one.ServerCertificate}
        if not any(one.startswith(expected) for one in shown):  # others of the chain may follow
            prints = ", ".join(hashlib.sha256(one).hexdigest()[:16] for one in shown) or "none"
            raise SessionError(
                f"certificate of the server (SHA-256 {prints}…) is not the pinned one, "
                f"{pinned.name} ({hashlib.sha256(expected).hexdigest()[:16]}…)"
            )

    async def _subscribe(self, names: Sequence[str]) -> dict[str, str]:
        problems: dict[str, str] = {}
        self._nodes = {}
        for name in names:
            try:
                self._nodes[name] = await self._node_id(name)
            except (ua.UaStringParsingError, ValueError):
                problems[name] = f"node {name!r}: the server has no such namespace or id"
        self._names = {}
        for name, node_id in self._nodes.items():
            self._names.setdefault(node_id, []).append(name)
        period_ms = 1e3 * max(self._source.sampling_interval_s, 0.1)
        subscription = await self._client.create_subscription(period_ms, self)
        known = list(self._nodes)
        every_time = ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp)
        for begin in range(0, len(known), NODES_PER_REQUEST):
            part = known[begin : begin + NODES_PER_REQUEST]
            results = await self._monitor(subscription, part, begin, every_time)
            # Some servers know no filter; then a value that stays the same is read now and then.
            refused = [name for name in part if _is_filter_refused(results[name])]
            results |= await self._monitor(subscription, refused, begin + len(known), None)
            for name, result in results.items():
                if isinstance(result, ua.StatusCode):
                    problems[name] = f"node {name!r}: {result.name}"
                    del self._nodes[name]
        return problems

    async def _monitor(
        self, subscription: Any, names: Sequence[str], first: int, trigger: Any
    ) -> dict[str, Any]:
        requests = []
        for number, name in enumerate(names, first + 1):
            wanted = ua.MonitoringParameters()
            wanted.ClientHandle = number
            wanted.SamplingInterval = 1e3 * self._source.sampling_interval_s
            wanted.QueueSize = _QUEUE_OF_A_NODE
            wanted.DiscardOldest = True
            if trigger is not None:
                wanted.Filter = trigger
            request = ua.MonitoredItemCreateRequest()
            request.ItemToMonitor = value_of(self._nodes[name])
            request.MonitoringMode = ua.MonitoringMode.Reporting
            request.RequestedParameters = wanted
            requests.append(request)
        if not requests:
            return {}
        return dict(zip(names, await subscription.create_monitored_items(requests), strict=True))

    async def _node_id(self, name: str) -> Any:
        if name.startswith("nsu="):
            uri, _, rest = name.removeprefix("nsu=").partition(";")
            name = f"ns={await self._client.get_namespace_index(uri)};{rest}"
        return ua.NodeId.from_string(name)

    async def _on_lost(self, error: BaseException) -> None:
        self.lose("connection lost")

    def lose(self, reason: str) -> None:
        """Note why the connection is of no use any more."""
        self.lost = self.lost or reason
        self.changed.set()

    def _why(self, error: BaseException) -> str:
        if isinstance(error, TimeoutError | asyncio.TimeoutError):
            return f"no answer within {self._source.timeout_s:g} s"
        if isinstance(error, ConnectionRefusedError):
            return "connection refused"
        return f"{error}".strip().splitlines()[0] if f"{error}".strip() else type(error).__name__


def _is_filter_refused(result: Any) -> bool:
    return isinstance(result, ua.StatusCode) and result.value in (
        ua.StatusCodes.BadMonitoredItemFilterUnsupported,
        ua.StatusCodes.BadMonitoredItemFilterInvalid,
        ua.StatusCodes.BadFilterNotAllowed,
    )


def _file(path: Path) -> Any:
    """Read a certificate or key; what it is shows in the file, whatever its name."""
    data = path.read_bytes()
    return uacrypto.CertProperties(data, "pem" if b"-----BEGIN" in data else "der")


def _certificate(path: Path) -> x509.Certificate:
    data = path.read_bytes()
    if b"-----BEGIN" in data:
        return x509.load_pem_x509_certificate(data)
    return x509.load_der_x509_certificate(data)


def _uri_in(certificate: x509.Certificate) -> str | None:
    """Return the application's URI, which must be that of its certificate."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName)
    except x509.ExtensionNotFound:
        return None
    uris = names.value.get_values_for_type(x509.UniformResourceIdentifier)
    return uris[0] if uris else None
