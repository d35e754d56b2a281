"""The publishers that there are, and those that a configuration asks for."""

from collections.abc import Mapping, Sequence
from functools import partial
from importlib.util import find_spec

from prometheus_client import CollectorRegistry, Gauge

from adapters.configuration import suggestion
from service.bus.replica import AssetReplica
from service.bus.stream import Bus
from service.plant import mqtt, opcua
from service.plant.endpoints import check_endpoint
from service.plant.protocol import Endpoint, Host, PublisherEntry
from service.plant.rounds import PublisherRounds
from service.site.configuration import SettingsError
from service.site.settings import Settings

PUBLISHERS: Sequence[PublisherEntry] = (
    opcua.PUBLISHER,
    mqtt.PUBLISHER,
)


def any_enabled(settings: Settings) -> bool:
    """Tell whether there is anything to do for the plant side."""
    return bool(_enabled(settings))


def check_extras(settings: Settings) -> None:
    """Make sure that what is enabled is installed, and that its files can be used.

    Raises
    ------
    SettingsError
        One line that names the key and what to do.
    """
    unknown = sorted(settings.publishers.keys() - {entry.name for entry in PUBLISHERS})
    if unknown:
        names = [entry.name for entry in PUBLISHERS]
        raise SettingsError(
            f"publishers.{unknown[0]}: unknown publisher; {suggestion(unknown[0], names)}"
        )
    for entry in _enabled(settings):
        if find_spec(entry.package) is None:
            raise SettingsError(
                f"{entry.name}.enabled = true: needs the extra {entry.name!r}; "
                f"install it with: pip install 'bearing-twin[{entry.name}]'"
            )
        if entry.check is not None:
            entry.check(settings)


def check_ports(settings: Settings) -> None:
    """Make sure that what is enabled can be had here, before anything else starts.

    Raises
    ------
    TemporaryError
        If a port is taken, or the machine does not have the address yet; names it.
    SettingsError
        If it cannot be used at all; names it.
    """
    check_extras(settings)
    for endpoint in endpoints(settings):
        check_endpoint(endpoint)


def endpoints(settings: Settings) -> list[Endpoint]:
    """Where the enabled publishers listen."""
    return [entry.listens(settings) for entry in _enabled(settings) if entry.listens is not None]


def make_publishers(
    settings: Settings,
    assets: Mapping[str, AssetReplica],
    bus: Bus,
    host: Host,
    registry: CollectorRegistry,
) -> list[PublisherRounds]:
    """Make what is enabled, each to be run next to the service.

    Parameters
    ----------
    settings
        The checked configuration.
    assets
        Whose tags are published; they may come and go.
    bus
        Where alarms come from.
    host
        What a publisher may use.
    registry
        Where each publisher's state is measured.
    """
    publishers = [
        PublisherRounds(entry.name, entry.make(settings), entry.period_s, assets, bus, host)
        for entry in _enabled(settings)
    ]
    up = Gauge(
        "bearing_twin_publisher_up",
        "Whether a publisher has its connection, or listens, and hands everything on.",
        ["publisher"],
        registry=registry,
    )
    for one in publishers:
        up.labels(one.name).set_function(partial(_is_up, one))
    return publishers


def _is_up(publisher: PublisherRounds) -> float:
    return float(publisher.problem is None)


def _enabled(settings: Settings) -> list[PublisherEntry]:
    return [entry for entry in PUBLISHERS if entry.is_enabled(settings)]
