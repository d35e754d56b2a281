"""The certificate and the name by which the OPC UA server is known."""

import socket
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.crypto.cert_gen import (
    dump_private_key_as_pem,
    generate_private_key,
    generate_self_signed_app_certificate,
    setup_self_signed_certificate,
)
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from opcua_site import RING, Asset, apart, inside, make_client, read
from prometheus_client import CollectorRegistry
from structlog.testing import capture_logs

from service.bus.stream import LiveMessages
from service.clock import ProcessClock
from service.plant.opcua import certificate as module
from service.plant.opcua.certificate import Identity, keep_identity, read_identity
from service.plant.protocol import Host
from service.plant.rounds import PublisherRounds, make_publishers
from service.security.keys import create_key
from service.site.configuration import SettingsError
from service.site.settings import OpcUaSection, Settings
from service.store import Outbox, Store

OLD_URI = "urn:bearing-twin:server"
OWN_URI = "urn:plant.example:bearing-twin:line-2"


def write_pair(folder: Path, uri: str, days: int, pem: bool = True) -> tuple[Path, Path]:
    """A certificate with its key, as an authority of one's own gives them out."""
    key = generate_private_key()
    names = [x509.UniformResourceIdentifier(uri)] if uri else [x509.DNSName("plant.example")]
    usage = [ExtendedKeyUsageOID.SERVER_AUTH]
    made = generate_self_signed_app_certificate(key, "Line 2", {}, names, usage, days)
    files = folder / "own.crt", folder / "own.key"
    files[0].write_bytes(made.public_bytes(Encoding.PEM if pem else Encoding.DER))
    files[1].write_bytes(dump_private_key_as_pem(key))
    return files


async def write_old(folder: Path) -> None:
    """What the version before made: for a year, with one name on all installations."""
    await setup_self_signed_certificate(
        folder / "private-key.pem",
        folder / "certificate.der",
        OLD_URI,
        socket.gethostname(),
        [ExtendedKeyUsageOID.SERVER_AUTH],
        {"commonName": "Bearing Twin"},
    )


def days_left(identity: Identity) -> float:
    assert identity.ends_at is not None
    return (identity.ends_at - datetime.now(UTC)).total_seconds() / 86_400


def test_a_certificate_is_made_once_for_ten_years_with_a_name_of_its_own(tmp_path: Path) -> None:
    with capture_logs() as lines:
        first = keep_identity(tmp_path / "a", encrypted=True)
        again = keep_identity(tmp_path / "a", encrypted=True)
        other = keep_identity(tmp_path / "b", encrypted=True)
    assert again.certificate == first.certificate
    assert again.application_uri == first.application_uri
    assert first.application_uri.startswith(f"urn:{socket.gethostname().lower()}:bearing-twin:")
    assert other.application_uri != first.application_uri, "two services of one machine"
    assert keep_identity(tmp_path / "a", encrypted=False) == Identity(first.application_uri)
    assert 3651 < days_left(first) < 3653
    assert first.certificate is not None
    names = first.certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    assert len(names) == 1
    assert [one["event"] for one in lines] == ["opcua_certificate_made"] * 2
    for file in (tmp_path / "a").iterdir():
        assert file.stat().st_mode & 0o077 == 0, file


async def test_one_of_an_earlier_version_is_kept_until_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "opcua").mkdir()
    await write_old(tmp_path / "opcua")
    before = (tmp_path / "opcua" / "certificate.der").read_bytes()
    monkeypatch.setattr(socket, "gethostname", lambda: "another-name")
    with capture_logs() as lines:
        kept = keep_identity(tmp_path / "opcua", encrypted=True)
        assert keep_identity(tmp_path / "opcua", encrypted=False).application_uri == OLD_URI
    assert kept.certificate is not None
    assert kept.certificate.public_bytes(Encoding.DER) == before
    assert kept.application_uri == OLD_URI
    assert lines == []

    class Later(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> "Later":
            return cls.fromtimestamp(datetime.now(tz).timestamp() + 366 * 86_400, tz)

    monkeypatch.setattr(module, "datetime", Later)
    with capture_logs() as lines:
        following = keep_identity(tmp_path / "opcua", encrypted=True)
    assert following.application_uri.startswith("urn:another-name:bearing-twin:")
    assert following.certificate != kept.certificate
    (line,) = lines
    assert (line["event"], line["log_level"]) == ("opcua_certificate_made", "warning")
    assert "one that ended at" in line["replaces"]


@pytest.mark.wires
@pytest.mark.parametrize("own", [False, True])
async def test_the_name_is_the_same_everywhere(
    tmp_path: Path, store: Store, outbox: Outbox, own: bool
) -> None:
    key = create_key(store, "viewer").text
    files = write_pair(tmp_path, OWN_URI, 400) if own else None
    async with inside(Asset(), tmp_path, store, outbox, "0.0.0.0", identity=files) as served:

        async def look() -> set[str]:
            found: set[str] = set()
            strange = Client(served.address)
            for endpoint in await strange.connect_and_get_server_endpoints():
                found.add(endpoint.Server.ApplicationUri)
                shown = x509.load_der_x509_certificate(endpoint.ServerCertificate)
                names = shown.extensions.get_extension_for_class(x509.SubjectAlternativeName)
                found |= set(names.value.get_values_for_type(x509.UniformResourceIdentifier))
            async with await make_client(served.address, key, encrypted=True) as client:
                array = client.get_node(ua.ObjectIds.Server_ServerArray)
                found.add((await array.read_value())[0])
                found.add((await client.get_namespace_array())[1])
                assert (await read(client, RING)).Value.Value == 61.5
            return found

        (uri,) = await apart(look)
    assert uri == OWN_URI if own else ":bearing-twin:" in uri


@pytest.mark.parametrize("pem", [True, False])
def test_files_that_cannot_be_used_are_refused_by_name(tmp_path: Path, pem: bool) -> None:
    certificate, key = write_pair(tmp_path, OWN_URI, 400, pem)
    assert read_identity(certificate, key).application_uri == OWN_URI
    (tmp_path / "other").mkdir()
    nameless, other = write_pair(tmp_path / "other", "", 400)
    (tmp_path / "text").write_text("no certificate")
    for files, expected in (
        ((tmp_path / "gone", key), r"opcua\.certificate = '.*gone': No such file"),
        ((certificate, tmp_path / "gone"), r"opcua\.private_key = '.*gone': No such file"),
        ((tmp_path / "text", key), r"opcua\.certificate = .*expected a certificate as PEM or DER"),
        ((certificate, tmp_path / "text"), r"opcua\.private_key = .*expected a PEM file"),
        ((certificate, other), r"is not the RSA key of opcua\.certificate"),
        ((nameless, other), r"names no application; expected a URI"),
    ):
        with pytest.raises(SettingsError, match=expected):
            read_identity(*files)
    with pytest.raises(ValueError, match="both certificate and private_key, or neither"):
        OpcUaSection(certificate=certificate)


@pytest.mark.parametrize(
    ("days", "expected"), [(61, None), (59, "ends in 59 days"), (-1, "has ended")]
)
async def test_the_end_is_announced_for_60_days(
    host: Host, days: float, expected: str | None
) -> None:
    class Ending:
        def certificate_ends_at(self) -> datetime:
            return datetime.now(UTC) + timedelta(days=days)

    rounds = PublisherRounds("opcua", Ending(), 1.0, {}, LiveMessages(ProcessClock()), host)  # type: ignore[arg-type]
    with capture_logs() as lines:
        rounds._announce_certificate()
        rounds._announce_certificate()
    if expected is None:
        rounds.failure = None
        assert rounds.problem is None
        assert lines == []
    else:
        rounds.failure = None
        assert expected in (rounds.problem or "")
        rounds.failure = "not reached"
        assert rounds.problem == "not reached"
        assert [one["event"] for one in lines] == ["opcua_certificate_ends"], "once a day"


@pytest.mark.wires
async def test_the_days_that_are_left_are_measured(
    tmp_path: Path, store: Store, outbox: Outbox, host: Host
) -> None:
    registry = CollectorRegistry()
    section = OpcUaSection(enabled=True, endpoint="opc.tcp://0.0.0.0:4840/")
    (rounds,) = make_publishers(
        Settings(opcua=section), {}, LiveMessages(ProcessClock()), host, registry
    )
    await rounds.publisher.open(host)
    name, labels = "bearing_twin_publisher_certificate_days", {"publisher": "opcua"}
    days = registry.get_sample_value(name, labels)
    assert days is not None
    assert 3651 < days < 3653
