"""The snapshot's tags as an OPC UA server (extra ``opcua``)."""

from urllib.parse import urlsplit

from service.plant.protocol import Endpoint, Publisher, PublisherEntry
from service.site.settings import Settings

PERIOD_S = 0.5


def _make(settings: Settings) -> Publisher:
    from service.plant.opcua.server import OpcUaPublisher

    return OpcUaPublisher(settings.opcua)


def _listens(settings: Settings) -> Endpoint:
    endpoint = settings.opcua.endpoint
    place = urlsplit(endpoint)
    return Endpoint(f"opcua.endpoint = {endpoint!r}", place.hostname or "", place.port or 0)


PUBLISHER = PublisherEntry(
    name="opcua",
    package="asyncua",
    period_s=PERIOD_S,
    is_enabled=lambda settings: settings.opcua.enabled,
    make=_make,
    listens=_listens,
)
