"""Publishes every tag that changes, and every alarm, to an MQTT broker.

Below the prefix of the configuration:

``status``
    ``online`` or ``offline``, retained; the broker itself says ``offline`` when we are lost. It is
    ``online`` only after all tags of the round: what an earlier process left is withdrawn by then.
``ASSET/TAG``
    ``{"value", "unit", "quality", "time"}`` as in the snapshot, retained. For a tag that is gone
    an empty payload follows, which has the broker forget the topic.
``ASSET/alarms``
    Every change of an alarm as one document, not retained; ``service/alarms`` of one that several
    assets have.
``service/alarms/ID``
    Each alarm that is not over, retained; an empty payload when it is.
"""

import asyncio
import contextlib
import json
import ssl
from collections.abc import Collection, Mapping, Sequence

import structlog
from aiomqtt import MqttError, Will
from pydantic_core import to_json

from service.plant.mqtt.client import MqttClient
from service.plant.protocol import Host, TagValue
from service.site.settings import MqttSection

_ANSWER_S = 5.0
_FAREWELL_S = 1.0

_log = structlog.get_logger(__name__)


class MqttPublisher:
    """Publishes over one connection to a broker; see `service.plant.protocol.Publisher`."""

    def __init__(self, section: MqttSection) -> None:
        self._section = section
        self._client: MqttClient | None = None
        # Ids of the alarms that are not over; None while that is not known.
        self._open: set[str] | None = None

    @property
    def receiver(self) -> str:
        """Broker and prefix."""
        return f"{self._section.host}:{self._section.port}/{self._section.topic_prefix}"

    async def open(self, host: Host) -> None:
        """Connect."""
        section = self._section
        password = section.password.get_secret_value() if section.password else None
        client = MqttClient(
            section.host,
            section.port,
            username=section.username or None,
            password=password,
            timeout=_ANSWER_S,
            keepalive=15,
            will=Will(self._topic("status"), b"offline", qos=1, retain=True),
            tls_context=ssl.create_default_context(cafile=section.ca_file) if section.tls else None,
        )
        # All tags of a round are under way together.
        client.pending_calls_threshold = 10_000
        try:
            await client.__aenter__()
        except MqttError as error:
            raise MqttError(f"{section.host}:{section.port}: {error}") from error
        self._client = client
        # The broker may not have noticed yet that an earlier connection is lost.
        await client.publish(self._topic("status"), b"offline", qos=1, retain=True)
        await self._keep_open_alarms(client, await host.open_alarms())
        _log.info("mqtt_connected", host=section.host, port=section.port)

    async def _keep_open_alarms(
        self, client: MqttClient, alarms: Sequence[Mapping[str, object]] | None
    ) -> None:
        """Retain what is open now, and ask the broker for what was retained before."""
        self._open = None if alarms is None else {str(alarm["id"]) for alarm in alarms}
        for alarm in alarms or ():
            await self._retain_alarm(alarm)
        with contextlib.suppress(MqttError):  # a broker may forbid it: what is over stays then
            await client.subscribe(self._topic("service", "alarms", "+"), qos=1)

    async def run(self) -> None:
        """Say that we are online, and have the broker forget alarms that ended while we were away.

        It raises `MqttError` when the connection is gone, even if there is nothing to publish.
        """
        await self._connected.publish(self._topic("status"), b"online", qos=1, retain=True)
        async for message in self._connected.messages:
            name = str(message.topic).rpartition("/")[2]
            if message.payload and self._open is not None and name not in self._open:
                await self._retain("service/alarms", {name: b""})

    async def publish_tags(self, asset: str, tags: Mapping[str, TagValue]) -> Collection[str]:
        """Publish tags, each with the broker's acknowledgement."""
        await self._retain(
            asset, {tag: to_json(shown, inf_nan_mode="null") for tag, shown in tags.items()}
        )
        return ()

    async def withdraw_tags(self, asset: str, tags: Collection[str]) -> None:
        """Have the broker forget topics: an empty payload removes what is retained."""
        await self._retain(asset, dict.fromkeys(tags, b""))

    async def publish_alarm(self, asset: str | None, alarm: Mapping[str, object]) -> None:
        """Publish an alarm, with the broker's acknowledgement."""
        topic = self._topic(asset or "service", "alarms")
        await self._connected.publish(topic, json.dumps(alarm), qos=1)
        await self._retain_alarm(alarm)

    async def _retain_alarm(self, alarm: Mapping[str, object]) -> None:
        name, is_over = str(alarm["id"]), alarm.get("state") == "NORM"
        if self._open is not None:
            (self._open.discard if is_over else self._open.add)(name)
        payload = b"" if is_over else json.dumps(alarm).encode()
        await self._retain("service/alarms", {name: payload})

    async def close(self) -> None:
        """Say that we are offline, since the broker keeps the will to itself, and disconnect."""
        client, self._client = self._client, None
        if client is None:
            return
        status = self._topic("status")
        with contextlib.suppress(MqttError):
            await client.publish(status, b"offline", qos=1, retain=True, timeout=_FAREWELL_S)
        with contextlib.suppress(MqttError):
            await client.__aexit__(None, None, None)

    async def _retain(self, asset: str, payloads: Mapping[str, bytes]) -> None:
        # Acknowledged by the broker, so that a slow one delays the next round instead of filling
        # our memory.
        await asyncio.gather(
            *(
                self._connected.publish(self._topic(asset, tag), payload, qos=1, retain=True)
                for tag, payload in payloads.items()
            )
        )

    @property
    def _connected(self) -> MqttClient:
        if self._client is None:
            raise MqttError("not connected")
        return self._client

    def _topic(self, *parts: str) -> str:
        return "/".join((self._section.topic_prefix, *parts))
