"""The certificate by which the OPC UA server is known, and its private key."""

import os
import socket
from pathlib import Path

from asyncua import Server
from asyncua.crypto.cert_gen import (
    dump_private_key_as_pem,
    generate_private_key,
    setup_self_signed_certificate,
)
from cryptography.x509.oid import ExtendedKeyUsageOID


async def load_certificate(server: Server, folder: Path, application_uri: str) -> None:
    """Load the service's own certificate; made when there is none, and again before it ends.

    Parameters
    ----------
    server
        Takes it.
    folder
        Where it is kept, readable by the service's user alone.
    application_uri
        The server's, which stands in the certificate.
    """
    key, certificate = folder / "private-key.pem", folder / "certificate.der"
    _have_key(key)
    host = socket.gethostname()
    await setup_self_signed_certificate(
        key,
        certificate,
        application_uri,
        host,
        [ExtendedKeyUsageOID.SERVER_AUTH],
        {"commonName": f"Bearing Twin on {host}", "organizationName": "Bearing Twin"},
    )
    await server.load_certificate(certificate)
    await server.load_private_key(key)


def _have_key(path: Path) -> None:
    """Make a private key unless there is one; no one else can read it at any moment."""
    folder = path.parent
    folder.mkdir(mode=0o700, exist_ok=True)
    folder.chmod(0o700)
    if path.is_file():
        path.chmod(0o600)  # of an earlier version, or restored from a copy
        return
    part = path.with_name(f"{path.name}.part")
    part.unlink(missing_ok=True)
    with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(dump_private_key_as_pem(generate_private_key()))
    part.replace(path)
