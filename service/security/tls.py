"""TLS for the web side, from the files that the configuration names."""

import ssl
import stat
from pathlib import Path

import structlog

from service.site.configuration import SettingsError

_log = structlog.get_logger(__name__)


def tls_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """Load a certificate and its private key.

    ``certificate``, ``key``: PEM files; the certificate first, then any that lead to the authority.
    The key carries no password: no one is there to type it. Raises `SettingsError` if a file cannot
    be used; names it.
    """
    for name, path in (("certificate", certificate), ("key", key)):
        try:
            path.read_bytes()
        except OSError as error:
            raise SettingsError(
                f"tls.{name} = {str(path)!r}: {error.strerror}; expected a PEM file"
            ) from error
    if key.stat().st_mode & stat.S_IROTH:
        _log.warning("tls_key_readable_by_others", file=str(key), mend=f"chmod o-r {key}")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.set_alpn_protocols(["http/1.1"])
    try:
        context.load_cert_chain(certificate, key, password=_no_password)
    except (ssl.SSLError, ValueError) as error:
        raise SettingsError(
            f"tls.certificate = {str(certificate)!r}, tls.key = {str(key)!r}: "
            f"{getattr(error, 'reason', None) or error}; expected a PEM certificate and its "
            "private key without a password"
        ) from error
    return context


def _no_password() -> str:
    raise ValueError("the key needs a password")
