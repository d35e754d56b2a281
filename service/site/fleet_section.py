"""A fleet: cells that share its machines, and the cluster that identifies them at night."""

import ipaddress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

from service.domain.section import Section
from service.site.configuration import SettingsError


def _address(text: str) -> str:
    """Access to a scheduler's port is access to its workers: not without certificates."""
    try:
        place = urlsplit(text)
        host, port = place.hostname, place.port
    except ValueError:
        host, port = None, None
    if not host or not port or place.path or place.scheme not in ("tcp", "tls"):
        raise ValueError("expected tls://HOST:PORT, or tcp:// with an address of this machine")
    if place.scheme == "tcp" and not _is_loopback(host):
        raise ValueError("expected tls://: without certificates only on this machine (127.0.0.1)")
    return text


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _address_or_none(text: str) -> str:
    return _address(text) if text else text


def _database_or_none(text: str) -> str:
    if text and urlsplit(text).scheme not in ("postgresql", "postgres"):
        raise ValueError("expected postgresql://USER:PASSWORD@HOST/DATABASE: cells share a server")
    return text


def _nats_or_none(text: str) -> str:
    """Access to the bus is access to every cell: not without a password from other machines."""
    if not text:
        return text
    try:
        place = urlsplit(text)
        host, _ = place.hostname, place.port
    except ValueError:
        host = None
    if not host or place.path or place.scheme not in ("nats", "tls"):
        raise ValueError("expected nats://TOKEN@HOST:PORT or tls://TOKEN@HOST:PORT")
    if not place.username and not _is_loopback(host):
        raise ValueError("expected a token or USER:PASSWORD before a host that others reach, too")
    return text


class FleetSection(Section):
    """Several cells that share the machines, and identification of a whole fleet (``fleet``)."""

    #: PostgreSQL and NATS of all cells and web sides; empty: one service does everything.
    database_url: Annotated[str, AfterValidator(_database_or_none)] = Field("", repr=False)
    nats_url: Annotated[str, AfterValidator(_nats_or_none)] = Field("", repr=False)
    #: PEM files for a NATS server with tls://: the authority that signed its certificate, and the
    #: certificate and key by which it knows us.
    nats_ca: Path | None = None
    nats_certificate: Path | None = None
    nats_key: Path | None = None
    #: Parts that the machines are divided into; a cell owns some of them.
    partitions: int = Field(64, ge=1, le=1024)
    #: Address of a Dask scheduler; empty: processes of this machine.
    scheduler: Annotated[str, AfterValidator(_address_or_none)] = ""
    #: PEM files for tls://: certificates of the authority that signed the scheduler's, and the
    #: certificate and key by which the scheduler knows us.
    scheduler_ca: Path | None = None
    scheduler_certificate: Path | None = None
    scheduler_key: Path | None = None


@dataclass(frozen=True, slots=True)
class SchedulerAddress:
    """A scheduler, and the files that both sides show each other; None for plain TCP."""

    address: str
    ca_file: Path | None
    certificate_file: Path | None
    key_file: Path | None


def checked_scheduler(
    section: FleetSection, base_dir: Path, option: str | None
) -> SchedulerAddress:
    """Give the scheduler of the option ``--scheduler``, or of the configuration.

    Raises `SettingsError` if there is none, or a file is missing.
    """
    try:
        address = section.scheduler if option is None else _address(option)
    except ValueError as error:
        raise SettingsError(f"--scheduler {option!r}: {error}") from error
    if not address:
        raise SettingsError("fleet.scheduler: missing; expected it, or --scheduler ADDRESS")
    if address.startswith("tcp:"):
        return SchedulerAddress(address, None, None, None)
    files = {
        name: getattr(section, name)
        for name in ("scheduler_ca", "scheduler_certificate", "scheduler_key")
    }
    wrong = [
        f"fleet.{name}: missing; {address} needs it"
        if file is None
        else f"fleet.{name} = {str(file)!r}: expected a file that can be read"
        for name, file in files.items()
        if file is None or not (base_dir / file).is_file()
    ]
    if wrong:
        raise SettingsError(*wrong)
    ca, certificate, key = (base_dir / file for file in files.values())
    return SchedulerAddress(address, ca, certificate, key)
