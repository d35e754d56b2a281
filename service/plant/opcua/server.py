"""An OPC UA server with the tags of every asset: the same names and values as the snapshot.

One object per asset under ``Objects``, one read-only variable per tag below it. Node ids are
texts (``ns=2;s=bench-1/t_inner_ring_c``) that stay the same over restarts. A client polls or
subscribes; what it sees is at most `PERIOD_S` behind.
"""

import asyncio
import contextlib
import errno
import logging
import math
import socket
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from contextlib import AbstractContextManager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import structlog
from asyncua import Server, ua

from service.domain.errors import TemporaryError
from service.domain.interfaces import AssetTwin
from service.live.guard import Guard
from service.plant.opcua.certificate import load_certificate
from service.plant.opcua.codes import status_code, unit_id
from service.plant.opcua.sessions import KeyedServer
from service.plant.opcua.users import KeyUsers
from service.plant.opcua.wire import BoundedServer
from service.security import AuditTrail, Authenticator
from service.security.loopback import is_loopback
from service.site.configuration import SettingsError
from service.site.settings import OpcUaSection

APPLICATION_URI = "urn:bearing-twin:server"
NAMESPACE = "urn:bearing-twin"
PERIOD_S = 0.5
_UNECE = "http://www.opcfoundation.org/UA/units/un/cefact"

_log = structlog.get_logger(__name__)


class TagServer:
    """The running server; made by `serve_tags`.

    Parameters
    ----------
    server
        Initialised server of the library.
    namespace
        Index of our namespace.
    assets
        Whose tags are shown.
    users
        Who may read them.

    Attributes
    ----------
    server : asyncua.Server
        The library's.
    refused : int
        Writes that the library has refused so far; each is tried again.
    """

    def __init__(
        self, server: Server, namespace: int, assets: Mapping[str, AssetTwin], users: KeyUsers
    ) -> None:
        self.server = server
        self.refused = 0
        self._users = users
        self._namespace = namespace
        self._assets = assets
        self._shown: dict[ua.NodeId, Mapping[str, Any]] = {}
        # One for each tag: the others go on when one cannot be shown.
        self._guards: dict[ua.NodeId | str, Guard] = {}
        self._door = Guard("opcua_close", "")

    async def run(self) -> None:
        """Keep the variables up to date, and revoked keys out, until cancelled."""
        # Side by side: keys are looked up in the store, and its troubles must not delay a tag.
        async with asyncio.TaskGroup() as group:
            group.create_task(_repeat(self.update))
            group.create_task(_repeat(self.put_out))

    async def update(self) -> None:
        """Write what has changed since the last time; a tag that is new gets its variable."""
        for name, asset in self._assets.items():
            with self._guard(name, name):
                for tag, shown in asset.snapshot()["tags"].items():
                    node_id = ua.NodeId(f"{name}/{tag}", self._namespace)
                    with self._guard(node_id, f"{name}/{tag}"):
                        await self._show(name, node_id, tag, shown)

    async def _show(
        self, asset: str, node_id: ua.NodeId, tag: str, shown: Mapping[str, Any]
    ) -> None:
        if node_id not in self._shown:
            await self._add(asset, node_id, tag, shown["unit"])
        if self._shown[node_id] == shown:
            return
        # The server's own method says nothing of a write that was refused.
        status = await self.server.iserver.aspace.write_attribute_value(
            node_id, ua.AttributeIds.Value, _data_value(shown)
        )
        if not status.is_good():
            self.refused += 1
            raise ua.UaError(f"the library refuses {shown}: {status.name}")
        self._shown[node_id] = shown

    def _guard(self, what: ua.NodeId | str, name: str) -> AbstractContextManager[None]:
        return self._guards.setdefault(what, Guard("opcua_update", name))()

    async def put_out(self) -> None:
        """End the connections whose key opens nothing any more."""
        for client in list(self.server.bserver.clients if self.server.bserver else ()):
            session = client.processor.session if client.processor else None
            if session is None or await self._users.may_stay(session.user):
                continue
            _log.info("opcua_closed", peer=str(client.peer_name), reason="key no longer valid")
            if client.transport is not None:
                client.transport.close()
            with self._door():
                await session.close_session()

    async def add_objects(self) -> None:
        """Make the object of every asset."""
        for name in self._assets:
            node_id = ua.NodeId(name, self._namespace)
            await self.server.nodes.objects.add_object(
                node_id, ua.QualifiedName(name, self._namespace)
            )

    async def _add(self, asset: str, node_id: ua.NodeId, tag: str, unit: str) -> None:
        parent = self.server.get_node(ua.NodeId(asset, self._namespace))
        variable = await parent.add_variable(
            node_id,
            ua.QualifiedName(tag, self._namespace),
            ua.Variant(None, ua.VariantType.Null),
            datatype=ua.NodeId(ua.ObjectIds.Double),
        )
        if unit:
            await variable.add_property(
                ua.NodeId(f"{node_id.Identifier}/EngineeringUnits", self._namespace),
                ua.QualifiedName("EngineeringUnits", 0),
                ua.EUInformation(
                    NamespaceUri=_UNECE,
                    UnitId=unit_id(unit),
                    DisplayName=ua.LocalizedText(unit),
                    Description=ua.LocalizedText(unit),
                ),
            )
        self._shown[node_id] = {}


async def _repeat(work: Callable[[], Coroutine[Any, Any, None]]) -> None:
    while True:
        await asyncio.sleep(PERIOD_S)
        await work()


def _data_value(shown: Mapping[str, Any]) -> ua.DataValue:
    number = shown["value"]
    has_value = number is not None and math.isfinite(number)
    value = ua.DataValue(
        ua.Variant(float(number), ua.VariantType.Double) if has_value else None,
        StatusCode=ua.StatusCode(status_code(shown["quality"])),
        SourceTimestamp=datetime.fromisoformat(shown["time"]),
        ServerTimestamp=datetime.now(UTC),
    )
    if not has_value:
        # Absent, not empty: the library takes an empty value for one of the wrong type, and
        # refuses it beside a good status ("good and none": not within the horizon).
        object.__setattr__(value, "Value", None)
    return value


def check_port(section: OpcUaSection) -> None:
    """Make sure that the endpoint can be listened on.

    Raises
    ------
    TemporaryError
        If the port is taken, or the machine does not have the address yet; names it.
    SettingsError
        If it cannot be used at all; names it.
    """
    place = urlsplit(section.endpoint)
    family = socket.AF_INET6 if ":" in (place.hostname or "") else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((place.hostname, place.port))
        except OSError as error:
            passing = (errno.EADDRINUSE, errno.EADDRNOTAVAIL, socket.EAI_AGAIN)
            kind = TemporaryError if error.errno in passing else SettingsError
            raise kind(
                f"opcua.endpoint = {section.endpoint!r}: cannot listen there "
                f"({error.strerror or error}); expected a free port"
            ) from error


@contextlib.asynccontextmanager
async def serve_tags(
    section: OpcUaSection,
    assets: Mapping[str, AssetTwin],
    authenticator: Authenticator,
    trail: AuditTrail,
    data_dir: Path,
) -> AsyncIterator[TagServer]:
    """Listen, and show the tags as they are now.

    On a loopback address anybody may read; elsewhere a key is asked for as password (any user
    name), and the connection is encrypted with a certificate of the service's own.

    Parameters
    ----------
    section
        The configuration.
    assets
        Whose tags are shown.
    authenticator, trail
        Checks keys, and keeps a line of wrong ones.
    data_dir
        Where the certificate is kept.

    Raises
    ------
    SettingsError
        If the endpoint cannot be listened on.
    """
    # The library tells of every connection, and of every wrong request with a traceback.
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    check_port(section)
    local = is_loopback(urlsplit(section.endpoint).hostname or "")
    users = KeyUsers(authenticator, trail, anonymous=local)
    server = BoundedServer(KeyedServer(users), encrypted=not local)
    server.application_type = ua.ApplicationType.Server
    server.product_uri = NAMESPACE
    server.manufacturer_name = "Bearing Twin"
    server.set_server_name("Bearing Twin")
    server.allow_remote_admin(False)
    await server.init()
    await server.set_application_uri(APPLICATION_URI)
    server.set_endpoint(section.endpoint)
    if local:
        server.set_identity_tokens([ua.UserNameIdentityToken, ua.AnonymousIdentityToken])
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    else:
        await load_certificate(server, data_dir / "opcua", APPLICATION_URI)
        server.set_identity_tokens([ua.UserNameIdentityToken])
        server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
    build = version("bearing-twin")
    await server.set_build_info(
        NAMESPACE, server.manufacturer_name, server.name, build, build, datetime.now()
    )
    tags = TagServer(server, await server.register_namespace(NAMESPACE), assets, users)
    await tags.add_objects()
    await tags.update()
    async with server:
        _log.info("opcua_listens", endpoint=section.endpoint, anonymous=local)
        yield tags
