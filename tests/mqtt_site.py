"""A real broker (mosquitto) in a process of its own, what publishes to it, and what listens."""

import asyncio
import json
import signal
import socket
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from patience import patience, within
from processes import free_port, wait_until
from programs import needed

from service.bus.stream import LiveMessages
from service.plant import rounds
from service.plant.mqtt import PERIOD_S
from service.plant.mqtt.client import MqttClient
from service.plant.mqtt.publisher import MqttPublisher
from service.plant.protocol import Host
from service.site.settings import MqttSection
from service.tasks import background

PATIENCE_S = 30.0


class Broker:
    """mosquitto on a port of its own, with the users twin and ear."""

    def __init__(self, folder: Path) -> None:
        self._program = needed("mosquitto")
        self.port = free_port()
        self._passwords = folder / "passwords"
        self._passwords.touch(mode=0o600)
        self._process: subprocess.Popen[bytes] | None = None
        for user in ("twin", "ear"):
            self.permit(user)
        self._configuration = folder / "mosquitto.conf"
        self._configuration.write_text(
            f"listener {self.port} 127.0.0.1\nallow_anonymous false\n"
            f"password_file {self._passwords}\nuser root\n"
            f"persistence true\npersistence_location {folder}/\n"
        )
        self._log = folder / "mosquitto.log"

    def permit(self, user: str) -> None:
        """Let a user in, at once if the broker runs."""
        subprocess.run(
            ["mosquitto_passwd", "-b", self._passwords, user, "secret"],
            check=True,
            timeout=patience(20),
        )
        if self._process is not None:
            self._process.send_signal(signal.SIGHUP)

    def forbid(self, user: str) -> None:
        """Let a user in no more when the broker starts the next time."""
        subprocess.run(
            ["mosquitto_passwd", "-D", self._passwords, user], check=True, timeout=patience(20)
        )

    def start(self) -> None:
        with self._log.open("ab") as log:
            self._process = subprocess.Popen([self._program, "-c", self._configuration], stderr=log)

        def listens() -> bool:
            with socket.socket() as probe:
                return probe.connect_ex(("127.0.0.1", self.port)) == 0

        wait_until(listens, PATIENCE_S, "mosquitto listens")

    def restart(self) -> None:
        """End in good order, with what is retained on the disk, and start again."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait(10)
        self.start()

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait(10)
            self._process = None


class Asset:
    """An asset whose tags a test sets."""

    def __init__(self) -> None:
        self.tags = {"t_inner_ring_c": tag(61.5), "t_inner_ring_c.twin": tag(61.0)}

    def snapshot(self) -> dict[str, Any]:
        return {"tags": dict(self.tags)}


def tag(value: float | None, quality: int = 192) -> dict[str, Any]:
    time = "2026-11-21T08:00:00.000Z"
    return {"value": value, "unit": "°C", "quality": quality, "time": time}


def section(broker: Broker, **more: Any) -> MqttSection:
    given = {"host": "127.0.0.1", "port": broker.port, "topic_prefix": "works/hall-2"}
    given |= {"enabled": True, "username": "twin", "password": "secret"}
    return MqttSection.model_validate(given | more)


class Listener:
    """Hears all topics."""

    def __init__(self, client: MqttClient) -> None:
        self._messages = aiter(client.messages)

    async def all_until(self, *topics: str) -> dict[str, tuple[str, bool]]:
        """What is heard until there was something on each of these topics."""
        heard: dict[str, tuple[str, bool]] = {}
        async with within(PATIENCE_S):
            while not heard.keys() >= set(topics):
                message = await anext(self._messages)
                topic = str(message.topic).removeprefix("works/hall-2/")
                heard[topic] = bytes(message.payload).decode(), message.retain
        return heard

    async def hear(self, topic: str, payload: Any = ...) -> tuple[Any, bool]:
        """Wait for a payload on a topic; gives it and whether it was retained."""
        async with within(PATIENCE_S):
            while True:
                message = await anext(self._messages)
                text = bytes(message.payload).decode()
                found = json.loads(text) if text.startswith("{") else text
                if str(message.topic) == f"works/hall-2/{topic}" and payload in (..., found):
                    return found, message.retain

    async def order_until(self, topic: str, payload: str) -> list[tuple[str, Any]]:
        """All that is heard, topic and payload, up to this one."""
        heard: list[tuple[str, Any]] = []
        async with within(PATIENCE_S):
            while (topic, payload) not in heard:
                message = await anext(self._messages)
                text = bytes(message.payload).decode()
                name = str(message.topic).removeprefix("works/hall-2/")
                heard.append((name, json.loads(text) if text.startswith("{") else text))
        return heard

    async def rows_until(self, topic: str, payload: str) -> dict[str, list[Any]]:
        """The payloads of every topic, in their order, up to this one."""
        rows: dict[str, list[Any]] = {}
        for name, found in await self.order_until(topic, payload):
            rows.setdefault(name, []).append(found)
        return rows


@asynccontextmanager
async def listening(broker: Broker) -> AsyncIterator[Listener]:
    async with MqttClient(
        "127.0.0.1", broker.port, username="ear", password="secret", timeout=patience(PATIENCE_S)
    ) as client:
        await client.subscribe("works/#", qos=1)
        yield Listener(client)


async def retained(broker: Broker) -> dict[str, Any]:
    """What the broker keeps, by topic: a client that comes now is sent it before all else."""
    async with MqttClient(
        "127.0.0.1", broker.port, username="ear", password="secret", timeout=patience(PATIENCE_S)
    ) as client:
        await client.subscribe("works/#", qos=1)
        await client.publish("works/last", b"", qos=1)
        found: dict[str, Any] = {}
        async for message in client.messages:
            topic, text = str(message.topic), bytes(message.payload).decode()
            if topic == "works/last":
                break
            found[topic.removeprefix("works/")] = json.loads(text) if text[0] == "{" else text
        return found


@asynccontextmanager
async def publishing(
    host: Host,
    settings: MqttSection,
    asset: Asset,
    bus: LiveMessages,
    assets: dict[str, Any] | None = None,
) -> AsyncIterator[None]:
    publisher = rounds.PublisherRounds(
        "mqtt",
        MqttPublisher(settings),
        PERIOD_S,
        {"bench-1": asset} if assets is None else assets,
        bus,
        host,
    )
    ended = asyncio.Event()
    async with background(publisher.run(), "publisher mqtt", ended):
        yield
        assert not ended.is_set()
