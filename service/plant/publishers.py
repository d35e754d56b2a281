"""The publishers that there are, and those that a configuration asks for."""

from collections.abc import Sequence
from importlib.util import find_spec

from adapters.configuration import suggestion
from service.plant import modbus_server, mqtt, opcua
from service.plant.endpoints import check_endpoint
from service.plant.protocol import Endpoint, PublisherEntry
from service.site.configuration import SettingsError
from service.site.settings import Settings

PUBLISHERS: Sequence[PublisherEntry] = (
    opcua.PUBLISHER,
    mqtt.PUBLISHER,
    modbus_server.PUBLISHER,
)

_ANY_HOST = {"0.0.0.0", "::"}


def any_enabled(settings: Settings) -> bool:
    """Whether there is anything to do for the plant side."""
    return bool(enabled(settings))


def check_extras(settings: Settings) -> None:
    """Make sure that what is enabled is installed, with files that can be used and own ports.

    Raises `SettingsError`: one line that names the key and what to do.
    """
    unknown = sorted(settings.publishers.keys() - {entry.name for entry in PUBLISHERS})
    if unknown:
        names = [entry.name for entry in PUBLISHERS]
        raise SettingsError(
            f"publishers.{unknown[0]}: unknown publisher; {suggestion(unknown[0], names)}"
        )
    for entry in enabled(settings):
        if entry.package is not None and find_spec(entry.package) is None:
            raise SettingsError(
                f"{entry.name}.enabled = true: needs the extra {entry.name!r}; "
                f"install it with: pip install 'bearing-twin[{entry.name}]'"
            )
        if entry.check is not None:
            entry.check(settings)
    _check_distinct_ports(settings)


def _check_distinct_ports(settings: Settings) -> None:
    others = [] if settings.is_fleet else [own_endpoint(settings)]  # there it may be elsewhere
    for endpoint in endpoints(settings):
        for other in others:
            hosts = {endpoint.host, other.host}
            if endpoint.port == other.port != 0 and (len(hosts) == 1 or hosts & _ANY_HOST):
                text = f"{endpoint.key}: expected another port than that of {other.key}"
                raise SettingsError(text)
        others.append(endpoint)


def check_ports(settings: Settings) -> None:
    """Make sure that what is enabled can be had here, before anything else starts.

    Raises `TemporaryError` if a port is taken, or the machine does not have the address yet; names
    it. Raises `SettingsError` if it cannot be used at all; names it.
    """
    check_extras(settings)
    for endpoint in endpoints(settings):
        check_endpoint(endpoint)


def own_endpoint(settings: Settings) -> Endpoint:
    """Where the web side listens."""
    service = settings.service
    return Endpoint(f"service.port = {service.port}", service.host, service.port)


def endpoints(settings: Settings) -> list[Endpoint]:
    """Where the enabled publishers listen."""
    return [entry.listens(settings) for entry in enabled(settings) if entry.listens is not None]


def warnings(settings: Settings) -> list[str]:
    """What is enabled and should be known, one line each."""
    return [
        line
        for entry in enabled(settings)
        if entry.warn is not None
        for line in entry.warn(settings)
    ]


def enabled(settings: Settings) -> list[PublisherEntry]:
    """Give the publishers that a configuration asks for."""
    return [entry for entry in PUBLISHERS if entry.is_enabled(settings)]
