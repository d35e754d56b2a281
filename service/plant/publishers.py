"""The ways by which tags leave the service besides REST: OPC UA server and MQTT publisher."""

import contextlib
import ssl
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from importlib.util import find_spec
from typing import Any

from service.bus.stream import Bus
from service.domain.interfaces import AssetTwin
from service.security import AuditTrail, Authenticator
from service.site.configuration import SettingsError
from service.site.settings import MqttSection, Settings

Outlet = tuple[str, Callable[[], Coroutine[Any, Any, None]]]
"""Name of a task and its work, which goes on until it is cancelled."""


def check_ports(settings: Settings) -> None:
    """Make sure that what is enabled can be had here, before anything else starts.

    Raises
    ------
    SettingsError
        One line that names the key and what to do.
    """
    check_extras(settings)
    if settings.opcua.enabled:
        from service.plant.opcua.server import check_port

        check_port(settings.opcua)


def check_extras(settings: Settings) -> None:
    """Make sure that what is enabled is installed, and that its files can be used.

    Raises
    ------
    SettingsError
        One line that names the key and what to do.
    """
    if settings.opcua.enabled:
        _need("asyncua", "opcua")
    if settings.mqtt.enabled:
        _need("aiomqtt", "mqtt")
        ca_file = _mqtt(settings).ca_file
        try:
            ssl.create_default_context(cafile=ca_file)
        except OSError as error:
            raise SettingsError(
                f"mqtt.ca_file = {str(ca_file)!r}: cannot be used ({error.strerror or error}); "
                "expected a file of PEM certificates"
            ) from error


@contextlib.asynccontextmanager
async def open_outlets(
    settings: Settings,
    assets: Mapping[str, AssetTwin],
    bus: Bus,
    authenticator: Authenticator,
    trail: AuditTrail,
) -> AsyncIterator[list[Outlet]]:
    """Open what is enabled; gives the work to be done beside the service.

    Raises
    ------
    SettingsError
        If the OPC UA endpoint cannot be listened on.
    """
    outlets: list[Outlet] = []
    async with contextlib.AsyncExitStack() as stack:
        # Imported only when wanted: each is an extra.
        if settings.opcua.enabled:
            from service.plant.opcua.server import serve_tags

            tags = await stack.enter_async_context(
                serve_tags(settings.opcua, assets, authenticator, trail, settings.data_dir)
            )
            outlets.append(("OPC UA", tags.run))
        if settings.mqtt.enabled:
            from service.plant.mqtt.publisher import Publisher

            outlets.append(("MQTT", Publisher(_mqtt(settings), assets, bus).run))
        yield outlets


def _mqtt(settings: Settings) -> MqttSection:
    section = settings.mqtt
    if section.ca_file is None:
        return section
    return section.model_copy(update={"ca_file": settings.path(section.ca_file)})


def _need(package: str, extra: str) -> None:
    if find_spec(package) is None:
        raise SettingsError(
            f"{extra}.enabled = true: needs the extra {extra!r}; "
            f"install it with: pip install 'bearing-twin[{extra}]'"
        )
