"""Who the OPC UA server is: the name of its application, its certificate and its private key."""

import re
import secrets
import socket
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import structlog
from asyncua.crypto.cert_gen import (
    dump_private_key_as_pem,
    generate_private_key,
    generate_self_signed_app_certificate,
)
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID

from service.files import new_part
from service.site.configuration import SettingsError

#: Of a certificate that is made here.
VALID_DAYS: Final = 3652
_KEY, _CERTIFICATE, _NAME = "private-key.pem", "certificate.der", "application-uri"

_log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Identity:
    """The server's identity.

    - ``application_uri``: its name among all applications of a plant; the same in every answer.
    - ``certificate``, ``key``: None where the server listens on loopback, without encryption.
    """

    application_uri: str
    certificate: x509.Certificate | None = None
    key: RSAPrivateKey | None = None

    @property
    def ends_at(self) -> datetime | None:
        """When the certificate ends."""
        return None if self.certificate is None else self.certificate.not_valid_after_utc


def read_identity(certificate_file: Path, key_file: Path) -> Identity:
    """Read a certificate of one's own authority, and its private key.

    Raises `SettingsError` if they cannot be used; names the key, the file and what was expected.
    """
    certificate_text = _bytes_of("certificate", certificate_file)
    key_text = _bytes_of("private_key", key_file)
    try:
        pem = b"-----BEGIN" in certificate_text
        load = x509.load_pem_x509_certificate if pem else x509.load_der_x509_certificate
        certificate = load(certificate_text)
    except ValueError as error:
        raise SettingsError(
            f"opcua.certificate = {str(certificate_file)!r}: {error}; expected a certificate as "
            "PEM or DER"
        ) from error
    try:
        key = load_pem_private_key(key_text, None)
    except (ValueError, TypeError) as error:
        raise SettingsError(
            f"opcua.private_key = {str(key_file)!r}: {error}; expected a PEM file without a "
            "password"
        ) from error
    if not isinstance(key, RSAPrivateKey) or key.public_key() != certificate.public_key():
        raise SettingsError(
            f"opcua.private_key = {str(key_file)!r}: is not the RSA key of "
            f"opcua.certificate = {str(certificate_file)!r}"
        )
    uri = _uri_in(certificate)
    if uri is None:
        raise SettingsError(
            f"opcua.certificate = {str(certificate_file)!r}: names no application; expected a URI "
            "among its subject alternative names, such as urn:HOST:bearing-twin:LINE-2"
        )
    return Identity(uri, certificate, key)


def keep_identity(folder: Path, encrypted: bool) -> Identity:
    """Give the identity of the service's own, which is made once and stays.

    A certificate is kept until it ends, also one of an earlier version. Only the start after its
    end makes another one, and says so in the log.

    - ``folder``: where it is kept, readable by the service's user alone.
    """
    folder.mkdir(mode=0o700, exist_ok=True)
    folder.chmod(0o700)
    now = datetime.now(UTC)
    key = _kept_key(folder / _KEY)
    certificate = _kept_certificate(folder / _CERTIFICATE) if key is not None else None
    valid = certificate is not None and certificate.not_valid_after_utc > now
    uri = _uri_in(certificate) if valid and certificate is not None else None
    uri = uri or _kept_uri(folder / _NAME)
    if not encrypted:
        return Identity(uri)
    if key is None:
        key = generate_private_key()
        _write(folder / _KEY, dump_private_key_as_pem(key))
    if not valid or certificate is None:
        ended = None if certificate is None else certificate.not_valid_after_utc
        certificate = _make_certificate(key, uri)
        _write(folder / _CERTIFICATE, certificate.public_bytes(Encoding.DER))
        _log.warning(
            "opcua_certificate_made",
            application_uri=uri,
            sha256=certificate.fingerprint(SHA256()).hex(),
            ends_at=certificate.not_valid_after_utc.isoformat(),
            replaces=None if ended is None else f"one that ended at {ended.isoformat()}",
            mend="have the clients trust it",
        )
    return Identity(uri, certificate, key)


def _make_certificate(key: RSAPrivateKey, uri: str) -> x509.Certificate:
    host = socket.gethostname()
    made: x509.Certificate = generate_self_signed_app_certificate(
        key,
        f"Bearing Twin on {host}",
        {"organizationName": "Bearing Twin"},
        [x509.UniformResourceIdentifier(uri), x509.DNSName(host)],
        [ExtendedKeyUsageOID.SERVER_AUTH],
        VALID_DAYS,
    )
    return made


def _kept_uri(path: Path) -> str:
    """Give the name that was once made for this installation."""
    if path.is_file():
        return path.read_text(encoding="ascii").strip()
    host = re.sub(r"[^a-z0-9.-]", "-", socket.gethostname().lower())
    uri = f"urn:{host}:bearing-twin:{secrets.token_hex(4)}"
    _write(path, uri.encode())
    return uri


def _kept_key(path: Path) -> RSAPrivateKey | None:
    if not path.is_file():
        return None
    path.chmod(0o600)  # of an earlier version, or restored from a copy
    key = load_pem_private_key(path.read_bytes(), None)
    return key if isinstance(key, RSAPrivateKey) else None


def _kept_certificate(path: Path) -> x509.Certificate | None:
    return x509.load_der_x509_certificate(path.read_bytes()) if path.is_file() else None


def _uri_in(certificate: x509.Certificate) -> str | None:
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName)
    except x509.ExtensionNotFound:
        return None
    uris = names.value.get_values_for_type(x509.UniformResourceIdentifier)
    return uris[0] if uris else None


def _bytes_of(key: str, path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise SettingsError(
            f"opcua.{key} = {str(path)!r}: {error.strerror}; expected a file"
        ) from error


def _write(path: Path, content: bytes) -> None:
    """Write a file that no one else can read at any moment."""
    with new_part(path) as part:
        part.write_bytes(content)
        part.replace(path)
