"""The snapshot's tags as Modbus TCP registers for a PLC, with a permissive bit for each asset."""

from collections.abc import Sequence

from service.plant.modbus_server.register_map import map_of, without_room
from service.plant.protocol import Endpoint, Publisher, PublisherEntry
from service.security.loopback import is_loopback
from service.site.settings import Settings

#: Requests are answered from the snapshot of their moment: nothing depends on this period.
PERIOD_S = 1.0


def _make(settings: Settings) -> Publisher:
    from service.plant.modbus_server.publisher import ModbusPublisher

    return ModbusPublisher(settings.modbus_server, map_of(settings))


def _check(settings: Settings) -> None:
    map_of(settings)


def _listens(settings: Settings) -> Endpoint:
    section = settings.modbus_server
    return Endpoint(f"modbus_server.port = {section.port}", section.host, section.port)


def _warn(settings: Settings) -> Sequence[str]:
    lines = without_room(settings)
    host = settings.modbus_server.host
    if is_loopback(host):
        return lines
    return (
        *lines,
        f"modbus_server.host = {host!r}: anyone with access to this address can read the values, "
        "since Modbus has no keys and no encryption; let a firewall admit the PLC alone",
    )


PUBLISHER = PublisherEntry(
    name="modbus_server",
    package=None,
    period_s=PERIOD_S,
    is_enabled=lambda settings: settings.modbus_server.enabled,
    make=_make,
    check=_check,
    listens=_listens,
    warn=_warn,
)
