"""Publishes every tag that changes, and every alarm, to an MQTT broker.

Below the prefix of the configuration:

``status``
    ``online`` or ``offline``, retained; the broker itself says ``offline`` when we are lost.
``ASSET/TAG``
    ``{"value", "unit", "quality", "time"}`` as in the snapshot, retained.
``ASSET/alarms``
    Every change of an alarm as one document, not retained.
"""

import asyncio
import contextlib
import json
import ssl
from collections.abc import Mapping
from typing import Any

import structlog
from aiomqtt import Client, MqttError, Will
from pydantic_core import to_json

from service.bus.stream import Bus, Message, Subscription, SubscriptionClosedError
from service.domain.interfaces import AssetTwin
from service.live.guard import Guard
from service.site.settings import MqttSection

PERIOD_S = 1.0
RECONNECT_S = (1.0, 30.0)
_ANSWER_S = 5.0
_FAREWELL_S = 1.0
_ALARMS_KEPT = 4096

_log = structlog.get_logger(__name__)


class Publisher:
    """Keeps one connection to a broker; while it is away the service goes on as ever.

    Alarms wait for the broker's return, tags are then published as they are.

    Parameters
    ----------
    section
        The configuration.
    assets
        Whose tags are published.
    bus
        Where alarms come from.
    """

    def __init__(self, section: MqttSection, assets: Mapping[str, AssetTwin], bus: Bus) -> None:
        self._section = section
        self._assets = assets
        self._bus = bus
        self._guards = {name: Guard("mqtt_tags", name) for name in assets}
        self._alarms: Subscription | None = None
        self._unsent: Message | None = None

    async def run(self) -> None:
        """Publish until cancelled; connect again, ever more slowly, whenever that fails."""
        self._alarms = self._subscribe()
        least_s, most_s = RECONNECT_S
        wait_s, away = least_s, False
        where = {"host": self._section.host, "port": self._section.port}
        while True:
            try:
                async with self._client() as client:
                    _log.info("mqtt_connected", **where)
                    wait_s, away = least_s, False
                    await self._publish_all(client)
            except* Exception as group:
                # Whatever it was that the connection ended with: the service goes on.
                if not away:
                    _log.warning("mqtt_away", reason=str(group.exceptions[0]), **where)
                away = True
            await asyncio.sleep(wait_s)
            wait_s = min(2 * wait_s, most_s)

    def _client(self) -> Client:
        section = self._section
        password = section.password.get_secret_value() if section.password else None
        client = Client(
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
        return client

    async def _publish_all(self, client: Client) -> None:
        status = self._topic("status")
        await client.publish(status, b"online", qos=1, retain=True)
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._tell_tags(client))
                tasks.create_task(self._tell_alarms(client))
                tasks.create_task(_until_lost(client))
        except asyncio.CancelledError:
            # The broker keeps the will to itself when we leave in order.
            with contextlib.suppress(MqttError):
                await client.publish(status, b"offline", qos=1, retain=True, timeout=_FAREWELL_S)
            raise

    async def _tell_tags(self, client: Client) -> None:
        known: dict[str, Mapping[str, Any]] = {}
        while True:
            changed: dict[str, Mapping[str, Any]] = {}
            for name, asset in self._assets.items():
                with self._guards[name]():
                    for tag, shown in asset.snapshot()["tags"].items():
                        if known.get(topic := self._topic(name, tag)) != shown:
                            changed[topic] = shown
            # Acknowledged by the broker, so that a slow one delays the next round instead of
            # filling our memory.
            await asyncio.gather(
                *(
                    client.publish(topic, to_json(shown, inf_nan_mode="null"), qos=1, retain=True)
                    for topic, shown in changed.items()
                )
            )
            known |= changed
            await asyncio.sleep(PERIOD_S)

    async def _tell_alarms(self, client: Client) -> None:
        while True:
            if self._unsent is None:
                self._unsent = await self._next_alarm()
            alarm = json.loads(self._unsent.text)["data"]
            await client.publish(
                self._topic(self._unsent.asset or "service", "alarms"), json.dumps(alarm), qos=1
            )
            self._unsent = None

    async def _next_alarm(self) -> Message:
        while True:
            if self._alarms is None:
                self._alarms = self._subscribe()
            try:
                return await self._alarms.get()
            except SubscriptionClosedError as error:
                if self._bus.closed:
                    await asyncio.Event().wait()  # the service stops, and this task with it
                _log.warning("mqtt_alarms_lost", reason=str(error))
                self._alarms = None

    def _subscribe(self) -> Subscription:
        return self._bus.subscribe(types={"alarm"}, capacity=_ALARMS_KEPT)

    def _topic(self, *parts: str) -> str:
        return "/".join((self._section.topic_prefix, *parts))


async def _until_lost(client: Client) -> None:
    """Raise `MqttError` when the connection is gone, even if there is nothing to publish."""
    async for _ in client.messages:
        pass
