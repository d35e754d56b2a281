"""What is removed does not stay good on any face, while the service is down and while it runs."""

import asyncio
import json
import socket
import struct
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client
from patience import patience
from processes import Station, free_port, wait_until
from programs import needed
from pymodbus.client import ModbusTcpClient
from site_files import CHANNELS, MACHINE, OBSERVE, asset_table, asset_text, write_site

from adapters.samples import Quality
from service.plant.mqtt.client import MqttClient

pytestmark = [pytest.mark.wires, pytest.mark.timeout(300)]
PATIENCE_S = 90.0
RING, OUTER = "t_inner_ring_c", "t_outer_ring_c"
LIMITS = f"limits = {{ {RING} = {{ warning = 300, alarm = 350 }} }}"
NO_LIMITS = "limits = {}"
WIRES = """
[opcua]
enabled = true
endpoint = "opc.tcp://127.0.0.1:{opcua}/bearing-twin"

[modbus_server]
enabled = true
port = {modbus}
tags = ["fan-1/t_outer_ring_c", "fan-1/t_inner_ring_c.forecast_max", "fan-1/t_inner_ring_c"]

[mqtt]
enabled = true
port = {mqtt}
"""
_FIRST_TAG = 100
_MQTT_ANSWER_S = 10.0


class Fans(Station):
    """A service with every face, and its broker."""

    def __init__(self, folder: Path) -> None:
        self.opcua, self.modbus, self.mqtt = free_port(), free_port(), free_port()
        self._wires = WIRES.format(opcua=self.opcua, modbus=self.modbus, mqtt=self.mqtt)
        text = asset_text("fan-1", CHANNELS, LIMITS, OBSERVE)
        text += asset_text("fan-2", CHANNELS, LIMITS, OBSERVE)
        super().__init__(folder, *write_site(folder, self._wires + text))

    def remove_much(self) -> None:
        """Keep one asset, with one temperature and no limits."""
        text = self.configuration.read_text()
        before = text.partition("\n[opcua]")[0]
        assets = asset_text("fan-1", MACHINE, NO_LIMITS, OBSERVE)
        self.configuration.write_text(before + self._wires + assets)

    def push_all(self, asset: str, *names: str) -> None:
        values = {name: 39.0 if name.endswith("_c") else 500.0 for name in names}
        assert self.push(asset, **values).is_success

    def retained(self) -> dict[str, Any]:
        """What the broker keeps of the service, by topic."""
        return asyncio.run(self._retained())

    async def _retained(self) -> dict[str, Any]:
        found: dict[str, Any] = {}
        async with MqttClient("127.0.0.1", self.mqtt, timeout=patience(_MQTT_ANSWER_S)) as client:
            await client.subscribe("bearing-twin/#", qos=1)
            await client.subscribe("last", qos=1)
            await client.publish("last", b"", qos=1)
            async for message in client.messages:
                topic, text = str(message.topic), bytes(message.payload).decode()
                if topic == "last":
                    return found
                if message.retain:
                    found[topic.removeprefix("bearing-twin/")] = text
        raise AssertionError("the broker has ended the connection")

    def nodes(self, *names: str) -> list[str]:
        """The status of the nodes of OPC UA."""

        async def read() -> list[str]:
            async with Client(f"opc.tcp://127.0.0.1:{self.opcua}/bearing-twin") as client:
                nodes = [client.get_node(f"ns=2;s={name}") for name in names]
                found = [await one.read_data_value(raise_on_bad_status=False) for one in nodes]
            return [one.StatusCode.name for one in found if one.StatusCode is not None]

        return asyncio.run(read())

    def registers(self) -> list[tuple[float, int]]:
        """Value and quality of the three tags of the map."""
        with ModbusTcpClient("127.0.0.1", port=self.modbus) as client:
            answer = client.read_input_registers(_FIRST_TAG, count=12)
        words = struct.pack(">12H", *answer.registers)
        return [struct.unpack(">fHH", words[begin : begin + 8])[:2] for begin in (0, 8, 16)]

    def until_topics_are_tags(self, *assets: str) -> None:
        """Wait until the broker keeps the tags of these assets, and nothing else."""
        tags = {f"{one}/{tag}" for one in assets for tag in self.tags(one)}

        def same() -> bool:
            found = self.retained()
            kept = {topic for topic in found if not topic.startswith("service/")}
            return found.get("status") == "online" and kept == tags | {"status"}

        wait_until(same, PATIENCE_S, f"the topics of {assets}: {sorted(self.retained())}")


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture
def fans(tmp_path: Path) -> Iterator[Fans]:
    with ExitStack() as stack:
        fans = stack.enter_context(Fans(tmp_path))
        broker = subprocess.Popen(
            [needed("mosquitto"), "-p", str(fans.mqtt)], stderr=subprocess.DEVNULL
        )
        stack.callback(broker.wait)
        stack.callback(broker.kill)
        yield fans


def test_what_was_removed_is_good_on_no_face(fans: Fans) -> None:
    service = fans.start_service()
    for asset in ("fan-1", "fan-2"):
        fans.push_all(asset, *CHANNELS)
    fans.until_topics_are_tags("fan-1", "fan-2")
    wait_until(
        lambda: json.loads(fans.retained()[f"fan-1/{OUTER}"])["quality"] == Quality.GOOD,
        PATIENCE_S,
        "a good value at the broker",
    )
    wait_until(lambda: listens(fans.modbus), PATIENCE_S, "the Modbus server listens")
    assert fans.registers()[0] == (39.0, Quality.GOOD)
    service.kill()
    fans.remove_much()
    fans.start_service()
    fans.push_all("fan-1", *MACHINE)
    tags = fans.tags("fan-1")
    assert OUTER not in tags
    assert f"{RING}.forecast_max" not in tags
    assert fans.client.get("/api/v1/assets/fan-2/snapshot").status_code == 404
    fans.until_topics_are_tags("fan-1")
    for port in (fans.opcua, fans.modbus):
        wait_until(lambda port=port: listens(port), PATIENCE_S, "a server listens")  # type: ignore[misc]
    unknown = "BadNodeIdUnknown"
    gone = (f"fan-1/{OUTER}", f"fan-1/{RING}.forecast_max", "fan-2", f"fan-2/{RING}")
    assert fans.nodes(*gone) == [unknown] * 4
    outer, forecast, ring = fans.registers()
    assert (outer[1], forecast[1]) == (Quality.CONFIG_ERROR, Quality.CONFIG_ERROR)
    assert ring == (39.0, Quality.GOOD)
    metrics = fans.client.get("/metrics").text
    assert "fan-1" in metrics
    assert "fan-2" not in metrics
    change_while_it_runs(fans)


def change_while_it_runs(fans: Fans) -> None:
    """A channel and limits leave over `PUT`, the whole asset over `DELETE`."""
    limited = {"limits": {RING: {"warning": 300, "alarm": 350}}}
    left = asset_table("fan-3", MACHINE) | {"limits": {}}
    for table in (asset_table("fan-3") | limited, left):
        assert fans.client.put("/api/v1/assets/fan-3", json=table).is_success
        names = list(table["channels"])
        wait_until(
            lambda names=names: (OUTER in fans.tags("fan-3")) == (OUTER in names),  # type: ignore[misc]
            PATIENCE_S,
            "the table is in force",
        )
        fans.push_all("fan-3", *names)
        fans.until_topics_are_tags("fan-1", "fan-3")
    gone = (f"fan-3/{OUTER}", f"fan-3/{RING}.forecast_max")
    wait_until(lambda: fans.nodes(*gone) == ["BadNodeIdUnknown"] * 2, PATIENCE_S, "no such nodes")
    assert fans.client.delete("/api/v1/assets/fan-3").is_success
    fans.until_topics_are_tags("fan-1")
    wait_until(lambda: fans.nodes("fan-3") == ["BadNodeIdUnknown"], PATIENCE_S, "no object")
    wait_until(lambda: "fan-3" not in fans.client.get("/metrics").text, PATIENCE_S, "no metrics")
