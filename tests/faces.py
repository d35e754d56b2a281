"""A service with every face, and a client of each that shows the last value that it has.

The value that is pushed says when it was measured, so that whoever looks at a face knows how old
is what its client shows, without a word of the face about it.
"""

import asyncio
import json
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx2
from aiomqtt import MqttError
from faults.hall import Peer
from faults.peers import State
from patience import patience, wait_for
from processes import Station, free_port, wait_until
from programs import needed, node_package
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException
from site_files import OBSERVE, UNCHECKED, asset_text, pushed, write_site
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from adapters.samples import is_good
from service.plant.mqtt.client import MqttClient

ASSET, CHANNEL = "motor-1", "t_inner_ring_c"
STARTED_S = 180.0
#: A client gives an answer up after so many wall seconds, and asks again.
ASK_S = 3.0
#: A sample of the stream is a value of now if its message is at most so much later.
_LATE_S = 5.0
FOREIGN = Path(__file__).with_name("foreign")
_PUSHED = ("speed_rpm", "load_n", "ambient_c", CHANNEL)
_BEGIN_C, _C_PER_S = 20.0, 0.05
_FIRST_TAG = 100
_WIRES = """
[opcua]
enabled = true
endpoint = "opc.tcp://127.0.0.1:{opcua_port}/bearing-twin"

[modbus_server]
enabled = true
port = {modbus_port}
tags = ["{asset}/{channel}"]

[mqtt]
enabled = true
port = {mqtt_port}

[[sources]]
name = "plc"
driver = "modbus-tcp"
host = "127.0.0.1"
port = {device_port}
poll_interval_s = 0.2
timeout_s = 0.5
"""
_READ = 't_outer_ring_c = { source = "plc", register = 1, kind = "input", flat_line_s = 0 }'
_LIMITS = f"limits = {{ {CHANNEL} = {{ warning = 300, alarm = 350 }} }}"


@dataclass
class Shown:
    """What a client shows, and whether it calls it good."""

    value: float | None = None
    good: bool = False


@dataclass
class Face:
    """One face, and what its client shows at this moment."""

    name: str
    shown: Shown = field(default_factory=Shown)
    #: Requests that the client of OPC UA has sent, by service.
    requests: dict[str, int] = field(default_factory=dict)


class Faces(Station):
    """The service, its broker, its device, whoever pushes to it, and clients of all faces."""

    def __init__(self, folder: Path) -> None:
        self.opcua_port, self.modbus_port = free_port(), free_port()
        self.mqtt_port, device_port = free_port(), free_port()
        text = _WIRES.format(
            opcua_port=self.opcua_port,
            modbus_port=self.modbus_port,
            mqtt_port=self.mqtt_port,
            device_port=device_port,
            asset=ASSET,
            channel=CHANNEL,
        )
        text += asset_text(ASSET, pushed(_PUSHED, UNCHECKED) + _READ, _LIMITS, OBSERVE)
        super().__init__(folder, *write_site(folder, text))
        self.device = Peer("modbus", device_port, str(folder / "device"))
        State(folder / "device")
        self.faces = {name: Face(name) for name in _CLIENTS}
        self.stop = threading.Event()
        self._began_s = time.time()

    def age_s(self, shown: Shown) -> float:
        """Wall seconds since the value that is shown was measured."""
        if shown.value is None:
            return float("inf")
        return time.time() - self._began_s - (shown.value - _BEGIN_C) / _C_PER_S

    def is_present(self, name: str, within_s: float) -> bool:
        """Whether a face shows a good value that is at most so old."""
        shown = self.faces[name].shown
        return shown.good and self.age_s(shown) <= within_s

    def status_word(self) -> int | None:
        """The status register of the Modbus server."""
        with ModbusTcpClient("127.0.0.1", port=self.modbus_port, timeout=patience(ASK_S)) as client:
            answer = client.read_input_registers(2, count=1)
        return None if answer.isError() else int(answer.registers[0])

    @contextmanager
    def running(self) -> Iterator["Faces"]:
        """Run all, until every face shows a present value."""
        node_package("node-opcua-client")
        with ExitStack() as stack:
            stack.callback(self.close)
            broker = subprocess.Popen(
                [needed("mosquitto"), "-p", str(self.mqtt_port)], stderr=subprocess.DEVNULL
            )
            stack.callback(broker.wait)
            stack.callback(broker.kill)
            stack.callback(self.device.kill)
            self.device.start()
            self.start_service()
            stack.enter_context(self.pushing(ASSET, self._values))
            threads = [threading.Thread(target=_forever(self, name)) for name in _CLIENTS]
            for thread in threads:
                stack.callback(thread.join)
            stack.callback(self.stop.set)
            for thread in threads:
                thread.start()
            for name in _CLIENTS:
                wait_until(
                    lambda name=name: self.is_present(name, 5.0),  # type: ignore[misc]
                    STARTED_S,
                    f"the first value over {name}: {self.faces[name]}",
                )
            yield self

    def _values(self) -> dict[str, float]:
        value = _BEGIN_C + _C_PER_S * (time.time() - self._began_s)
        return dict(zip(_PUSHED, (500.0, 1000.0, 22.0, value), strict=True))


def _forever(site: Faces, name: str) -> Callable[[], None]:
    """Let a client follow its face; one whose connection is lost shows nothing good."""
    face, follow = site.faces[name], _CLIENTS[name]

    def work() -> None:
        while not site.stop.is_set():
            try:
                follow(site, face)
            except _LOST:
                face.shown = Shown(face.shown.value)
                site.stop.wait(0.2)

    return work


_LOST = (OSError, TimeoutError, MqttError, ModbusException, WebSocketException, httpx2.HTTPError)


def _rest(site: Faces, face: Face) -> None:
    url = f"http://127.0.0.1:{site.port}/api/v1/assets/{ASSET}/snapshot"
    with httpx2.Client(headers={"X-API-Key": site.key}, timeout=patience(ASK_S)) as client:
        while not site.stop.wait(0.2):
            answer = client.get(url)
            answer.raise_for_status()
            tag = answer.json()["tags"][CHANNEL]
            face.shown = Shown(tag["value"], is_good(tag["quality"]))


def _modbus(site: Faces, face: Face) -> None:
    with ModbusTcpClient(
        "127.0.0.1", port=site.modbus_port, timeout=patience(ASK_S), retries=0
    ) as client:
        while not site.stop.wait(0.2):
            answer = client.read_input_registers(_FIRST_TAG, count=4)
            if answer.isError():
                raise ModbusException(str(answer))
            words = struct.pack(">4H", *answer.registers)
            value, quality, _ = struct.unpack(">fHH", words)
            face.shown = Shown(value, is_good(quality))


def _mqtt(site: Faces, face: Face) -> None:
    async def follow() -> None:
        async with MqttClient("127.0.0.1", site.mqtt_port, timeout=patience(ASK_S)) as client:
            online = False
            await client.subscribe(f"bearing-twin/{ASSET}/{CHANNEL}", qos=1)
            await client.subscribe("bearing-twin/status", qos=1)
            messages = aiter(client.messages)
            while not site.stop.is_set():
                try:
                    message = await wait_for(anext(messages), ASK_S)
                except TimeoutError:
                    messages = aiter(client.messages)
                    continue
                payload: Any = message.payload
                if message.topic.value.endswith("/status"):
                    online = payload == b"online"
                    face.shown = Shown(face.shown.value, online and face.shown.good)
                else:
                    tag = json.loads(payload)
                    face.shown = Shown(tag["value"], online and is_good(tag["quality"]))

    asyncio.run(follow())


def _websocket(site: Faces, face: Face) -> None:
    address = f"ws://127.0.0.1:{site.port}/api/v1/stream?assets={ASSET}"
    headers = {"X-API-Key": site.key}
    sample, degraded = Shown(), False
    with connect(
        address, additional_headers=headers, proxy=None, open_timeout=ASK_S, close_timeout=1
    ) as stream:
        while not site.stop.is_set():
            try:
                message = json.loads(stream.recv(1.0))
            except TimeoutError:
                continue
            data = message["data"]
            if message["type"] == "health":
                degraded = data["degraded"]
            elif message["type"] == "measurement":
                for one in data["samples"]:
                    # What has waited in a cell that stood still comes late, with its own time.
                    late = _seconds_between(one["time"], message["time"]) > _LATE_S
                    if one["channel"] == CHANNEL:
                        sample = Shown(one["value"], is_good(one["quality"]) and not late)
            face.shown = Shown(sample.value, sample.good and not degraded)


def _seconds_between(earlier: str, later: str) -> float:
    return (datetime.fromisoformat(later) - datetime.fromisoformat(earlier)).total_seconds()


def _opcua(site: Faces, face: Face) -> None:
    """node-opcua connects again itself: it has one process for all of the time."""
    program = [needed("nodejs", "node"), str(FOREIGN / "subscribe.js")]
    endpoint = f"opc.tcp://127.0.0.1:{site.opcua_port}/bearing-twin"
    with subprocess.Popen(
        [*program, endpoint, f"ns=2;s={ASSET}/{CHANNEL}"],
        cwd=FOREIGN,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        ending = threading.Thread(target=lambda: (site.stop.wait(), process.kill()))
        ending.start()
        assert process.stdout is not None
        reported = Shown()
        for line in process.stdout:
            if not line.startswith("{"):
                continue  # the library tells of itself on the same stream
            event = json.loads(line)
            face.requests = event["requests"]
            if "status" in event:
                face.shown = reported = Shown(event["value"], event["status"].startswith("Good"))
            elif event.get("connected") is not None:
                # A screen shows what was reported last as soon as the connection stands again.
                face.shown = reported if event["connected"] else Shown(reported.value)
        process.wait()
        if not site.stop.is_set():
            raise ConnectionError("the client of OPC UA has ended")
        ending.join()


_CLIENTS: dict[str, Callable[[Faces, Face], None]] = {
    "OPC UA": _opcua,
    "Modbus": _modbus,
    "MQTT": _mqtt,
    "WebSocket": _websocket,
    "REST": _rest,
}
FACES = tuple(_CLIENTS)
