"""The snapshot's tags as an OPC UA server (extra ``opcua``)."""

from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

from service.plant.protocol import Endpoint, Publisher, PublisherEntry
from service.site.settings import Settings

PERIOD_S = 0.5


def _make(settings: Settings) -> Publisher:
    from service.plant.opcua.certificate import read_identity
    from service.plant.opcua.server import OpcUaPublisher

    files = _own_files(settings)
    return OpcUaPublisher(settings.opcua, None if files is None else partial(read_identity, *files))


def _check(settings: Settings) -> None:
    from service.plant.opcua.certificate import read_identity

    files = _own_files(settings)
    if files is not None:
        read_identity(*files)


def _own_files(settings: Settings) -> tuple[Path, Path] | None:
    """Certificate and private key of one's own authority, where the configuration names them."""
    certificate, key = settings.opcua.certificate, settings.opcua.private_key
    if certificate is None or key is None:
        return None
    return settings.path(certificate), settings.path(key)


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
    check=_check,
    listens=_listens,
)
