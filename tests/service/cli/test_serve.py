"""The service of unusual configurations, and its end."""

import asyncio
import json
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client as OpcUaClient
from processes import Command, Station, free_port, wait_until

from adapters.samples import Sample
from bearing_twin_laboratory.benchmarks.fleet import processes_of
from service.ingest import Spool
from service.site.settings import load_settings
from service.store import Store

from .conftest import ASSET

pytestmark = pytest.mark.wires

MACHINE = {"speed_rpm": 1500.0, "load_n": 2650.0, "ambient_c": 22.0, "t_inner_ring_c": 40.0}
FAST = "\n[clock]\nrate = 60\n"
Start = Callable[..., Command]


class Client(Station):
    """A gateway and an administrator of one asset that only gets pushed values."""

    def send(self, **values: float) -> None:
        answer = self.push("motor-1", **values)
        assert answer.status_code == 200, answer.text
        assert answer.json()["rejected"] == []

    def value(self, name: str) -> Any:
        return self.tag(name, "motor-1")

    def follow(self, name: str) -> Any:
        """Push the machine's values until the twin has a value for a tag."""

        def look() -> Any:
            self.send(**MACHINE)
            return self.value(name)

        return wait_until(look, 30, f"a value of {name}")


@pytest.fixture
def connect(port: int) -> Iterator[Callable[[Path], Client]]:
    clients: list[Client] = []

    def to(config: Path) -> Client:
        clients.append(Client(config.parent, config, port))
        return clients[-1]

    yield to
    for client in clients:
        client.close()


def test_a_service_without_sources_and_assets_is_ready(
    configure: Callable[..., Path], start: Start, connect: Callable[[Path], Client]
) -> None:
    config = configure("")
    service = start("serve", "-c", str(config))
    client = connect(config)
    assert client.get("/readyz")["status"] == "ready"
    assert client.get("/api/v1/assets")["items"] == []
    assert client.get("/api/v1/alarms")["items"] == []
    assert client.client.get("/").status_code == 200
    assert service.terminate() == 0


def test_a_broker_that_does_not_answer_is_named_by_readiness(
    configure: Callable[..., Path], start: Start, connect: Callable[[Path], Client]
) -> None:
    port = free_port()
    modbus = f"[modbus_server]\nenabled = true\nport = {free_port()}\n"
    config = configure(f"[mqtt]\nenabled = true\nport = {port}\n{modbus}")
    start("serve", "-c", str(config))
    client = connect(config)

    def publishers() -> dict[str, tuple[str, str]]:
        checks = client.get("/readyz")["checks"]
        return {one["name"]: (one["status"], one["detail"]) for one in checks}

    wait_until(
        lambda: publishers().get("publisher:modbus_server") == ("ok", "hands everything on"),
        30,
        "a Modbus server that listens",
    )
    status, detail = wait_until(
        lambda: publishers().get("publisher:mqtt"), 30, "the broker's check"
    )
    assert status == "degraded"
    assert str(port) in detail
    assert client.get("/readyz")["status"] == "degraded"


@pytest.mark.parametrize("processes", [(), ("--one-process",)], ids=["several", "one"])
def test_pushed_values_alone_keep_a_twin(
    configure: Callable[..., Path],
    start: Start,
    connect: Callable[[Path], Client],
    processes: tuple[str, ...],
) -> None:
    endpoint = f"opc.tcp://127.0.0.1:{free_port()}/bearing-twin"
    opcua = f'[opcua]\nenabled = true\nendpoint = "{endpoint}"\n'
    config = configure(ASSET + FAST + opcua)
    service = start("serve", *processes, "-c", str(config))
    client = connect(config)
    sides = {"twin-cell", "twin-web", "twin-plant"} & set(
        processes_of(service.process.pid).values()
    )
    assert len(sides) == (0 if processes else 3)
    assert client.get("/readyz")["status"] == "degraded"
    assert client.value("t_node_7_c.twin") is None
    assert 22.0 < client.follow("t_node_7_c.twin") < 60.0
    assert client.follow("t_inner_ring_c.forecast_max") > 30.0
    asset = client.get("/api/v1/assets/motor-1")
    assert asset["health"]["twin_running"] is True
    assert asset["controller"] is None
    assert {one["source"] for one in asset["channels"]} == {"push", "twin"}
    forecast = client.get("/api/v1/assets/motor-1/forecast")
    assert forecast["planned"] is False
    assert client.get("/api/v1/assets/motor-1/windows")["items"] == []

    def estimated() -> dict[str, Any] | None:
        client.send(**MACHINE)
        shown = asyncio.run(opcua_tags(endpoint, "motor-1"))
        return None if shown["t_node_7_c.twin"] is None else shown

    shown = wait_until(estimated, 30, "an estimate over OPC UA")
    assert list(shown) == list(client.get("/api/v1/assets/motor-1/snapshot")["tags"])
    assert shown["model.version"] == 1
    assert 22.0 < shown["t_node_7_c.twin"] < 60.0
    assert service.terminate() == 0
    assert '"level": "error"' not in service.log.read_text()


async def opcua_tags(endpoint: str, asset: str) -> dict[str, Any]:
    """Names and values of an asset's variables, as an OPC UA client finds them."""
    async with OpcUaClient(endpoint) as client:
        nodes = await client.get_node(f"ns=2;s={asset}").get_children()
        names = [(await node.read_browse_name()).Name for node in nodes]
        found = [await node.read_data_value(raise_on_bad_status=False) for node in nodes]
        return {name: one.Value.Value for name, one in zip(names, found, strict=True)}


def test_an_asset_without_temperatures_does_not_end_the_service(
    configure: Callable[..., Path], start: Start, connect: Callable[[Path], Client]
) -> None:
    without = ASSET.replace('t_inner_ring_c = { source = "push" }\n', "").replace(
        'ambient_c = { source = "push" }\n', ""
    )
    config = configure(without + "\n[clock]\nrate = 300\n")
    service = start("serve", "-c", str(config))
    client = connect(config)
    client.send(speed_rpm=1500.0, load_n=2650.0)
    time.sleep(2.5)  # by then it has looked for windows twice
    assert client.get("/livez")["status"] == "alive"
    assert client.get("/api/v1/assets/motor-1/windows")["items"] == []
    assert client.value("t_node_7_c.twin") is None
    assert service.terminate() == 0
    assert '"level": "error"' not in service.log.read_text()


def test_another_bearing_in_the_configuration_begins_anew(
    configure: Callable[..., Path], start: Start, connect: Callable[[Path], Client]
) -> None:
    """What was identified, and estimated, belongs to the old one."""
    config = configure(ASSET + FAST)
    service = start("serve", "-c", str(config))
    client = connect(config)
    client.follow("t_node_7_c.twin")
    assert service.terminate() == 0
    config.write_text(config.read_text().replace("6311", "6016"))
    service = start("serve", "-c", str(config))
    assert client.value("t_node_7_c.twin") is None
    assert client.value("model.version") == 2
    models = client.get("/api/v1/assets/motor-1/models")["items"]
    assert [(model["version"], model["status"]) for model in models] == [
        (2, "active"),
        (1, "retired"),
    ]
    assert "6311" in models[0]["reason"]
    client.follow("t_inner_ring_c.forecast_max")
    answer = client.client.post("/api/v1/assets/motor-1/models/1/activate")
    assert answer.status_code == 409
    assert "6311" in answer.json()["detail"]
    assert service.terminate() == 0


def test_a_kept_state_that_cannot_be_read_does_not_keep_it_from_starting(
    configure: Callable[..., Path], start: Start, connect: Callable[[Path], Client]
) -> None:
    config = configure(ASSET + FAST)
    client = connect(config)
    with closing(sqlite3.connect(config.parent / "data" / "bearing-twin.db")) as store, store:
        store.execute("INSERT INTO asset_states (asset, document) VALUES ('motor-1', '{}')")
    service = start("serve", "-c", str(config))
    client.follow("t_node_7_c.twin")
    assert service.terminate() == 0


@pytest.mark.endurance
def test_it_ends_within_seconds_though_the_store_is_locked(
    configure: Callable[..., Path], start: Start, connect: Callable[[Path], Client]
) -> None:
    """Another program holds the database, and the twin just tries to keep its state."""
    config = configure(ASSET + FAST)
    service = start("serve", "-c", str(config))
    client = connect(config)
    client.follow("t_node_7_c.twin")
    database = config.parent / "data" / "bearing-twin.db"
    with closing(sqlite3.connect(database, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        time.sleep(5.5)  # a save is under way now
        assert service.terminate() == 0
        other.execute("ROLLBACK")


def test_a_damaged_spool_stops_no_start_and_what_is_left_is_stored(
    configure: Callable[..., Path], start: Start, connect: Callable[[Path], Client]
) -> None:
    config = configure(ASSET)
    settings = load_settings(config)
    begin_us = time.time_ns() // 1000 - 60_000_000
    samples = [
        Sample("motor-1", "load_n", begin_us + k, float(k), 192, begin_us) for k in range(5000)
    ]
    with Store.open("", settings.data_dir) as store:
        store.samples.write([Sample("motor-0", "load_n", k, 1.0, 192, 0) for k in range(7)])
    spool = Spool.open(settings.data_dir, 16)
    spool.append(samples)
    spool.close()
    path = settings.data_dir / "spool.db"
    content = bytearray(path.read_bytes())
    middle = len(content) // 2 // 4096 * 4096
    content[middle : middle + 4096] = b"\xa5" * 4096
    path.write_bytes(content)

    service = start("serve", "-c", str(config))
    client = connect(config)

    def count(name: str) -> float:
        text = client.client.get("/metrics").text
        return float(next(line.split()[-1] for line in text.splitlines() if line.startswith(name)))

    wait_until(lambda: count("bearing_twin_spool_samples ") == 0, 60, "an empty spool")
    lost = count('bearing_twin_samples_skipped_total{reason="damaged"}')
    assert 0 < lost < 200
    assert count('bearing_twin_damaged_file_rows_lost{file="spool"}') == lost
    ready = client.get("/readyz")
    (files,) = (check for check in ready["checks"] if check["name"] == "files")
    assert (ready["status"], files["status"]) == ("degraded", "degraded")
    assert f"{lost:.0f} lost; kept as spool-damaged-1.db" in files["detail"]
    assert service.terminate() == 0
    with Store.open("", settings.data_dir) as store:
        stored = store.samples.read("motor-1", ["load_n"], 0, 2**62, 10**5)
    assert len({one.time_us for one in stored} & {one.time_us for one in samples}) == 5000 - lost
    (warning,) = (line for line in service.log.read_text().splitlines() if "not_configured" in line)
    assert json.loads(warning)["samples"] == {"motor-0": 7}
