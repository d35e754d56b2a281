"""An OPC UA server with the tags of every asset: the same names and values as the snapshot.

One object per asset under ``Objects``, one read-only variable per tag below it. Node ids are
texts (``ns=2;s=bench-1/t_inner_ring_c``) that stay the same over restarts. A client polls or
subscribes; what it sees is at most half a second behind. Objects and variables appear and
disappear with assets; a client that browses again sees it. There is no event for that: events
would bring filters of clients, which the library evaluates without a bound.
"""

import asyncio
import logging
import math
from collections.abc import Callable, Collection, Mapping
from datetime import UTC, datetime
from urllib.parse import urlsplit

import structlog
from asyncua import Server, ua

from service import __version__
from service.live.guard import Guard
from service.plant.opcua.certificate import Identity, keep_identity
from service.plant.opcua.codes import status_code, unit_id
from service.plant.opcua.history import StoreHistory
from service.plant.opcua.history_nodes import describe_history, mark_historical
from service.plant.opcua.monitored_items import SAMPLING_INTERVAL_MS
from service.plant.opcua.sessions import MOST_BROWSES, KeyedServer
from service.plant.opcua.users import KeyUsers
from service.plant.opcua.wire import BoundedServer
from service.plant.protocol import Host, TagValue
from service.security.loopback import is_loopback
from service.site.settings import OpcUaSection

NAMESPACE = "urn:bearing-twin"
#: Wall seconds between two looks for keys that open nothing any more.
KEYS_EVERY_S = 0.5
_PROFILE = "http://opcfoundation.org/UA-Profile/Server/NanoEmbeddedDevice2017"
_UNECE = "http://www.opcfoundation.org/UA/units/un/cefact"

_log = structlog.get_logger(__name__)


class OpcUaPublisher:
    """The server, a new one for each round; see `service.plant.protocol.Publisher`.

    On a loopback address anybody may read; elsewhere a key is asked for as password (any user
    name), and the connection is encrypted with a certificate of the service's own.

    - ``identity``: reads the certificate of one's own authority; without it the service makes its
      own.
    """

    server: Server

    def __init__(
        self, section: OpcUaSection, identity: Callable[[], Identity] | None = None
    ) -> None:
        self._section = section
        self._read_identity = identity
        self._identity: Identity | None = None
        self._local = is_loopback(urlsplit(section.endpoint).hostname or "")
        self._users: KeyUsers
        self._namespace = 0
        self._history: StoreHistory | None = None
        self._channels_of: Callable[[str], Collection[str]] = lambda asset: ()
        # Assets with an object, and the tags that have a variable there.
        self._variables: dict[str, set[str]] = {}
        # One for each tag: the others go on when one cannot be shown.
        self._guards: dict[ua.NodeId, Guard] = {}
        self._door = Guard("opcua_close", "")
        # The library logs every connection, and of every wrong request with a traceback.
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)

    async def open(self, host: Host) -> None:
        """Set the server up; it does not listen yet."""
        local = self._local
        self._users = KeyUsers(host.authenticator, host.trail, anonymous=local)
        self.server = server = BoundedServer(KeyedServer(self._users), encrypted=not local)
        self._channels_of = host.channels_of
        self._history = None
        if host.history is not None:  # before `init`, which sets the library's own up
            self._history = StoreHistory(server.iserver, host.history)
            server.iserver.history_manager = self._history
        server.application_type = ua.ApplicationType.Server
        server.product_uri = NAMESPACE
        server.manufacturer_name = "Bearing Twin"
        server.set_server_name("Bearing Twin")
        server.allow_remote_admin(False)
        await server.init()
        identity = self._identity = (
            keep_identity(host.data_dir / "opcua", encrypted=not local)
            if self._read_identity is None
            else self._read_identity()
        )
        await server.set_application_uri(identity.application_uri)
        server.set_endpoint(self._section.endpoint)
        if local:
            server.set_identity_tokens([ua.UserNameIdentityToken, ua.AnonymousIdentityToken])
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        else:
            server.iserver.certificate = identity.certificate
            server.iserver.private_key = identity.key
            server.set_identity_tokens([ua.UserNameIdentityToken])
            server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        await server.set_build_info(
            NAMESPACE,
            server.manufacturer_name,
            server.name,
            __version__,
            __version__,
            datetime.now(),
        )
        await _describe_capabilities(server)
        self._namespace = await server.register_namespace(NAMESPACE)
        self._variables = {}
        if self._history is not None:
            await describe_history(server, ua.NodeId("history", self._namespace))

    async def run(self) -> None:
        """Listen, and keep revoked keys out, until cancelled."""
        async with self.server:
            _log.info("opcua_listens", endpoint=self._section.endpoint, anonymous=self._local)
            while True:
                await asyncio.sleep(KEYS_EVERY_S)
                await self.put_out()

    async def publish_tags(self, asset: str, tags: Mapping[str, TagValue]) -> Collection[str]:
        """Write the variables; a tag that is new gets its own. Gives those that were refused."""
        refused = []
        for tag, shown in tags.items():
            node_id = self._node_id(asset, tag)
            guard = self._guards.setdefault(node_id, Guard("opcua_update", f"{asset}/{tag}"))
            with guard():
                await self._show(asset, node_id, tag, shown)
            if guard.failing:
                refused.append(tag)
        await asyncio.sleep(0)  # clients are answered between thousands of assets
        return refused

    async def withdraw_tags(self, asset: str, tags: Collection[str]) -> None:
        """Delete the variables, and with the last one the asset's object."""
        variables = self._variables.get(asset)
        if variables is None:
            return  # none of them could be shown
        variables.difference_update(tags)
        object_id = self._node_id(asset)
        deleted = [self._node_id(asset, tag) for tag in tags]
        for node_id in deleted:
            self._guards.pop(node_id, None)
            if self._history is not None:
                self._history.channels.pop(node_id, None)
        await self._detach(object_id, ua.ObjectIds.HasComponent, deleted)
        if not variables:
            del self._variables[asset]
            deleted.append(object_id)
            objects_id = self.server.nodes.objects.nodeid
            await self._detach(objects_id, ua.ObjectIds.Organizes, [object_id])
        self._delete(deleted + [_unit_node_id(node_id) for node_id in deleted])
        await asyncio.sleep(0)  # as in `publish_tags`

    async def publish_alarm(self, asset: str | None, alarm: Mapping[str, object]) -> None:
        """Do nothing: the address space has no events; what stands is in the tags."""

    async def close(self) -> None:
        """Do nothing: `run` has closed what it opened."""

    def certificate_ends_at(self) -> datetime | None:
        """When the certificate ends; None while none is shown to clients."""
        return None if self._local or self._identity is None else self._identity.ends_at

    async def _show(self, asset: str, node_id: ua.NodeId, tag: str, shown: TagValue) -> None:
        if tag not in self._variables.get(asset, ()):
            await self._add(asset, node_id, tag, shown["unit"])
        # The server's own method says nothing of a write that was refused.
        status = await self.server.iserver.aspace.write_attribute_value(
            node_id, ua.AttributeIds.Value, _data_value(shown)
        )
        if not status.is_good():
            raise ua.UaError(f"the library refuses {shown}: {status.name}")

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

    async def _detach(self, parent: ua.NodeId, kind: int, children: Collection[ua.NodeId]) -> None:
        items = [
            ua.DeleteReferencesItem(
                SourceNodeId=parent,
                ReferenceTypeId=ua.NodeId(kind),
                IsForward=True,
                TargetNodeId=child,
                DeleteBidirectional=False,
            )
            for child in children
        ]
        await self.server.iserver.isession.delete_references(items)

    def _delete(self, node_ids: Collection[ua.NodeId]) -> None:
        """Delete nodes that nothing refers to; the library would search the whole address space."""
        space = self.server.iserver.aspace
        for node_id in node_ids:
            node = space.get(node_id)
            if node is None:
                continue
            # The library leaves some behind, and fails when the client ends its subscription.
            for attribute in node.attributes.values():
                for handle in list(attribute.datachange_callbacks):
                    space.delete_datachange_callback(handle)
            del space[node_id]

    def _node_id(self, *parts: str) -> ua.NodeId:
        return ua.NodeId("/".join(parts), self._namespace)

    async def _add(self, asset: str, node_id: ua.NodeId, tag: str, unit: str) -> None:
        object_id = self._node_id(asset)
        if asset not in self._variables:
            await self.server.nodes.objects.add_object(
                object_id, ua.QualifiedName(asset, self._namespace)
            )
            self._variables[asset] = set()
        parent = self.server.get_node(object_id)
        variable = await parent.add_variable(
            node_id,
            ua.QualifiedName(tag, self._namespace),
            ua.Variant(None, ua.VariantType.Null),
            datatype=ua.NodeId(ua.ObjectIds.Double),
        )
        if unit:
            await variable.add_property(
                _unit_node_id(node_id),
                ua.QualifiedName("EngineeringUnits", 0),
                ua.EUInformation(
                    NamespaceUri=_UNECE,
                    UnitId=unit_id(unit),
                    DisplayName=ua.LocalizedText(unit),
                    Description=ua.LocalizedText(unit),
                ),
            )
        self._variables[asset].add(tag)
        if self._history is not None and tag in self._channels_of(asset):
            await mark_historical(variable, ua.NodeId("history", self._namespace))
            self._history.channels[node_id] = (asset, tag)


async def _describe_capabilities(server: Server) -> None:
    """Say what the server does and does not do."""
    string, double = ua.VariantType.String, ua.VariantType.Double
    for number, value in (
        (ua.ObjectIds.Server_ServerCapabilities_ServerProfileArray, ua.Variant([_PROFILE], string)),
        (ua.ObjectIds.Server_ServerCapabilities_LocaleIdArray, ua.Variant(["en"], string)),
        (
            ua.ObjectIds.Server_ServerCapabilities_MinSupportedSampleRate,
            ua.Variant(SAMPLING_INTERVAL_MS, double),
        ),
        (
            ua.ObjectIds.Server_ServerCapabilities_MaxBrowseContinuationPoints,
            ua.Variant(MOST_BROWSES, ua.VariantType.UInt16),
        ),
    ):
        await server.get_node(number).write_value(value)
    no_events = ua.DataValue(ua.Variant(0, ua.VariantType.Byte))
    await server.nodes.server.write_attribute(ua.AttributeIds.EventNotifier, no_events)


def _unit_node_id(variable: ua.NodeId) -> ua.NodeId:
    return ua.NodeId(f"{variable.Identifier}/EngineeringUnits", variable.NamespaceIndex)


def _data_value(shown: TagValue) -> ua.DataValue:
    number = shown["value"]
    variant = None
    if number is not None and math.isfinite(number):
        variant = ua.Variant(float(number), ua.VariantType.Double)
    value = ua.DataValue(
        variant,
        StatusCode=ua.StatusCode(status_code(shown["quality"])),
        SourceTimestamp=datetime.fromisoformat(shown["time"]),
        ServerTimestamp=datetime.now(UTC),
    )
    if variant is None:
        # Absent, not empty: the library takes an empty value for one of the wrong type, and
        # refuses it next to a good status ("good and none": not within the horizon).
        object.__setattr__(value, "Value", None)
    return value
