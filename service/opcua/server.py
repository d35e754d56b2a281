"""An OPC UA server with the tags of every asset: the same names and values as the snapshot.

One object per asset under ``Objects``, one read-only variable per tag below it. Node ids are
texts (``ns=2;s=bench-1/t_inner_ring_c``) that stay the same over restarts. A client polls or
subscribes; what it sees is at most `PERIOD_S` behind.
"""

import asyncio
import contextlib
import logging
import socket
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import anyio
import structlog
from asyncua import Server, ua
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from cryptography.x509.oid import ExtendedKeyUsageOID

from service.api.context import AssetTwin
from service.configuration import SettingsError
from service.live.guard import Guard
from service.opcua.codes import status_code, unit_id
from service.opcua.users import KeyedServer, KeyUsers
from service.security import AuditTrail, Authenticator
from service.settings import OpcUaSection
from service.wiring import is_loopback

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
    """

    def __init__(
        self, server: Server, namespace: int, assets: Mapping[str, AssetTwin], users: KeyUsers
    ) -> None:
        self._server = server
        self._users = users
        self._namespace = namespace
        self._assets = assets
        self._shown: dict[ua.NodeId, Mapping[str, Any]] = {}
        self._guards = {name: Guard("opcua_update", name) for name in assets}
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
            with self._guards[name]():
                for tag, shown in asset.snapshot()["tags"].items():
                    node_id = ua.NodeId(f"{name}/{tag}", self._namespace)
                    if node_id not in self._shown:
                        await self._add(name, node_id, tag, shown["unit"])
                    if self._shown.get(node_id) != shown:
                        await self._server.write_attribute_value(node_id, _data_value(shown))
                        self._shown[node_id] = shown

    async def put_out(self) -> None:
        """End the connections whose key opens nothing any more."""
        for client in list(self._server.bserver.clients if self._server.bserver else ()):
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
            await self._server.nodes.objects.add_object(
                node_id, ua.QualifiedName(name, self._namespace)
            )

    async def _add(self, asset: str, node_id: ua.NodeId, tag: str, unit: str) -> None:
        parent = self._server.get_node(ua.NodeId(asset, self._namespace))
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
    value = shown["value"]
    variant = (
        ua.Variant(None, ua.VariantType.Null)
        if value is None
        else ua.Variant(float(value), ua.VariantType.Double)
    )
    return ua.DataValue(
        variant,
        StatusCode=ua.StatusCode(status_code(shown["quality"])),
        SourceTimestamp=datetime.fromisoformat(shown["time"]),
        ServerTimestamp=datetime.now(UTC),
    )


def check_port(section: OpcUaSection) -> None:
    """Make sure that the endpoint can be listened on.

    Raises
    ------
    SettingsError
        If it cannot; names it.
    """
    place = urlsplit(section.endpoint)
    family = socket.AF_INET6 if ":" in (place.hostname or "") else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((place.hostname, place.port))
        except OSError as error:
            raise SettingsError(
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
    name), and the connection may be encrypted with a certificate of the service's own.

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
    server = Server(iserver=KeyedServer(users))
    server.application_type = ua.ApplicationType.Server
    server.product_uri = NAMESPACE
    server.manufacturer_name = "Bearing Twin"
    server.set_server_name("Bearing Twin")
    server.allow_remote_admin(False)
    await server.init()
    await server.set_application_uri(APPLICATION_URI)
    server.set_endpoint(section.endpoint)
    tokens: list[type] = [ua.UserNameIdentityToken]
    policies = [ua.SecurityPolicyType.NoSecurity]
    if local:
        tokens.append(ua.AnonymousIdentityToken)
    else:
        folder = data_dir / "opcua"
        await anyio.Path(folder).mkdir(mode=0o700, exist_ok=True)
        await _load_certificate(server, folder)
        policies.append(ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt)
    server.set_identity_tokens(tokens)
    server.set_security_policy(policies)
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


async def _load_certificate(server: Server, folder: Path) -> None:
    """Load the service's own certificate; made when there is none, and anew before it ends."""
    key, certificate = folder / "private-key.pem", folder / "certificate.der"
    host = socket.gethostname()
    await setup_self_signed_certificate(
        key,
        certificate,
        APPLICATION_URI,
        host,
        [ExtendedKeyUsageOID.SERVER_AUTH],
        {"commonName": f"Bearing Twin on {host}", "organizationName": "Bearing Twin"},
    )
    await server.load_certificate(certificate)
    await server.load_private_key(key)
