"""An OPC UA server over an asset that a test drives, and clients in an event loop of their own."""

import asyncio
import math
import socket
import tempfile
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from asyncua import Client, ua
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from cryptography.x509.oid import ExtendedKeyUsageOID
from patience import patience
from processes import free_port, wait_until

from adapters.samples import Quality, Sample
from service.bus.stream import LiveMessages
from service.clock import ProcessClock
from service.plant.opcua import PERIOD_S
from service.plant.opcua.certificate import read_identity
from service.plant.opcua.server import OpcUaPublisher
from service.plant.protocol import Host
from service.plant.rounds import PublisherRounds
from service.security.audit_trail import AuditTrail
from service.security.authenticator import Authenticator
from service.site.settings import OpcUaSection
from service.store import Outbox, Store

Answer = TypeVar("Answer")
WRONG = "bt_00000000_" + "A" * 43
BEGAN = "2026-01-21T08:00:00.000Z"
RING = "t_inner_ring_c"


class Asset:
    """An asset whose tags a test sets."""

    def __init__(self) -> None:
        self.tags: dict[str, dict[str, Any]] = {}
        self.tell(RING, 61.5)
        self.tell(f"{RING}.time_to_alarm_s", None, unit="s")
        self.tell("model.version", 3, unit="")

    def tell(
        self,
        name: str,
        value: float | None,
        quality: int = Quality.GOOD,
        time: str = BEGAN,
        unit: str = "°C",
    ) -> None:
        self.tags[name] = {"value": value, "unit": unit, "quality": int(quality), "time": time}

    def snapshot(self) -> dict[str, Any]:
        return {"tags": dict(self.tags)}


def fill_seconds(store: Store, begin_us: int, count: int) -> None:
    """Store once a second 20, 21 ... °C; the sixth of a broken sensor, the eighth uncertain."""
    quality = {5: Quality.SENSOR_FAILURE, 7: Quality.UNCERTAIN}
    store.samples.write(
        [
            Sample(
                "bench-1",
                RING,
                begin_us + k * 1_000_000,
                math.nan if k == 5 else 20.0 + k,
                int(quality.get(k, Quality.GOOD)),
                0,
            )
            for k in range(count)
        ]
    )


@dataclass
class Serving:
    """A running server: where it is, and its inside."""

    address: str
    publisher: OpcUaPublisher
    rounds: PublisherRounds


@asynccontextmanager
async def inside(
    asset: Any,
    folder: Path,
    store: Store,
    outbox: Outbox,
    host: str = "127.0.0.1",
    assets: dict[str, Any] | None = None,
    identity: tuple[Path, Path] | None = None,
) -> AsyncIterator[Serving]:
    """Serve the tags of bench-1, or of all assets; a host that is not loopback asks for keys."""
    port = free_port()
    section = OpcUaSection(enabled=True, endpoint=f"opc.tcp://{host}:{port}/bearing-twin")
    host_of_it = Host(
        Authenticator(store),
        AuditTrail(outbox),
        folder,
        channels_of=lambda asset: (RING,),
        history=store.channel_history,
    )
    publisher = OpcUaPublisher(section, identity and partial(read_identity, *identity))
    rounds = PublisherRounds(
        "opcua",
        publisher,
        PERIOD_S,
        assets or {"bench-1": asset},
        LiveMessages(ProcessClock()),
        host_of_it,
    )
    running = asyncio.create_task(rounds.run())
    try:
        await asyncio.to_thread(wait_until, lambda: _listens(port), 60.0, "the server listens")
        yield Serving(f"opc.tcp://127.0.0.1:{port}/bearing-twin", publisher, rounds)
        assert not running.done(), running
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@asynccontextmanager
async def serving(
    asset: Any, folder: Path, store: Store, outbox: Outbox, host: str = "127.0.0.1"
) -> AsyncIterator[str]:
    """Serve an asset's tags; gives the address."""
    async with inside(asset, folder, store, outbox, host) as served:
        yield served.address


async def apart(work: Callable[[], Coroutine[Any, Any, Answer]]) -> Answer:
    """Run a client in a thread with an event loop of its own."""
    return await asyncio.to_thread(lambda: asyncio.run(work()))


def node_id(name: str) -> str:
    return f"ns=2;s=bench-1/{name}"


async def read(client: Client, name: str) -> ua.DataValue:
    return await client.get_node(node_id(name)).read_data_value(raise_on_bad_status=False)


async def make_client(address: str, key: str | None = None, encrypted: bool = False) -> Client:
    """Make a client with a key as password, and a certificate of its own where it encrypts."""
    client = Client(address, timeout=patience(30))
    if key is not None:
        client.set_user("scada")
        client.set_password(key)
    if encrypted:
        folder = Path(tempfile.mkdtemp())
        certificate, private_key = folder / "client.der", folder / "client.pem"
        await setup_self_signed_certificate(
            private_key,
            certificate,
            client.application_uri,
            "scada",
            [ExtendedKeyUsageOID.CLIENT_AUTH],
            {"commonName": "A SCADA system"},
        )
        await client.set_security_string(
            f"Basic256Sha256,SignAndEncrypt,{certificate},{private_key}"
        )
    return client


class Changes:
    """Takes a subscription's messages."""

    def __init__(self) -> None:
        self.values: asyncio.Queue[tuple[Any, int]] = asyncio.Queue()

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        self.values.put_nowait((value, data.monitored_item.Value.StatusCode.value))
