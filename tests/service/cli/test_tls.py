"""A service that other machines reach: only with a key, and over TLS where there are files."""

import asyncio
import json
import ssl
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest
import trustme
import websockets
from patience import patience
from processes import Command

from service.security.keys import create_key
from service.site.settings import load_settings
from service.store import Store

pytestmark = pytest.mark.wires

TLS = '[tls]\ncertificate = "server.pem"\nkey = "server.key"\n'


@pytest.fixture(scope="module")
def authority() -> trustme.CA:
    return trustme.CA()


@pytest.fixture
def certified(tmp_path: Path, authority: trustme.CA) -> ssl.SSLContext:
    """Put certificate and key where the configuration looks; give what a client trusts."""
    certificate = authority.issue_cert("127.0.0.1")
    certificate.private_key_pem.write_to_path(tmp_path / "server.key")
    (tmp_path / "server.key").chmod(0o600)  # else the service warns
    for number, part in enumerate(certificate.cert_chain_pems):
        part.write_to_path(tmp_path / "server.pem", append=number > 0)
    trusting = ssl.create_default_context()
    authority.configure_trust(trusting)
    return trusting


def admin_key(config: Path) -> str:
    settings = load_settings(config)
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        return create_key(store, "admin").text


async def hello(address: str, key: str, trusting: ssl.SSLContext) -> Any:
    async with websockets.connect(
        f"{address.replace('https', 'wss')}api/v1/stream",
        ssl=trusting,
        additional_headers={"X-API-Key": key},
    ) as stream:
        return json.loads(await stream.recv())


def test_with_a_key_and_over_tls_everything_is_there_and_nothing_without(
    refused: Callable[..., str],
    configure: Callable[..., Path],
    start: Callable[..., Command],
    certified: ssl.SSLContext,
    port: int,
) -> None:
    config = configure(TLS, service='host = "0.0.0.0"')
    assert "at least one API key" in refused("serve", "-c", str(config))
    key = admin_key(config)
    service = start("serve", "-c", str(config))
    assert service.first_line == f"https://0.0.0.0:{port}/"
    address = f"https://127.0.0.1:{port}/"
    with httpx2.Client(base_url=address, verify=certified, timeout=patience(20)) as client:
        answer = client.post("/api/v1/session", json={"key": key})
        assert answer.status_code == 200
        assert answer.headers["strict-transport-security"] == "max-age=2592000"
        for attribute in ("Secure", "HttpOnly", "SameSite=strict"):
            assert attribute in answer.headers["set-cookie"]
        # The cookie is good here, and only from this very address.
        same = {"Origin": f"https://127.0.0.1:{port}"}
        other = {"Origin": "https://127.0.0.1"}
        what = "/api/v1/alarms/none/acknowledge"
        assert client.get("/api/v1/audit").status_code == 200
        assert client.post(what, headers=same).status_code == 404
        assert client.post(what, headers=other).status_code == 403
    assert asyncio.run(hello(address, key, certified))["type"] == "hello"
    with pytest.raises(httpx2.ConnectError, match="certificate"):
        httpx2.get(f"{address}livez")
    with pytest.raises(httpx2.TransportError):
        httpx2.get(f"http://127.0.0.1:{port}/livez")
    assert service.terminate() == 0
    assert key not in service.log.read_text()
