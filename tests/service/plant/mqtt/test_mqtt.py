"""The MQTT publisher with a real broker (mosquitto) in a process of its own."""

import asyncio
import json
import socket
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from aiomqtt import Client
from mqtt_site import PATIENCE_S, Asset, Broker, listening, publishing, retained, section, tag
from patience import patience, within

from adapters.samples import Quality
from service.bus.stream import LiveMessages
from service.clock import ProcessClock
from service.plant import publishers as outlets
from service.plant import rounds
from service.plant.mqtt.client import MqttClient
from service.plant.protocol import Host
from service.site.configuration import SettingsError
from service.site.settings import MqttSection, Settings

pytestmark = pytest.mark.wires


async def test_tags_alarms_and_status(broker: Broker, host: Host) -> None:
    asset, bus = Asset(), LiveMessages(ProcessClock())
    async with publishing(host, section(broker), asset, bus):
        async with listening(broker) as listener:
            await listener.hear("bench-1/t_inner_ring_c.twin", tag(61.0))
        async with listening(broker) as listener:  # who comes later finds what is retained
            await listener.hear("status", "online")
        async with listening(broker) as listener:
            assert await listener.hear("bench-1/t_inner_ring_c") == (tag(61.5), True)
            asset.tags["t_inner_ring_c"] = tag(None, 16)
            assert await listener.hear("bench-1/t_inner_ring_c") == (tag(None, 16), False)
            bus.publish("measurement", "bench-1", {"samples": []})
            bus.publish("alarm", "bench-1", {"id": "7", "state": "UNACK"})
            alarm = {"id": "7", "state": "UNACK"}
            assert await listener.hear("bench-1/alarms") == (alarm, False)
    async with listening(broker) as listener:
        assert await listener.hear("status") == ("offline", True)


async def test_the_broker_forgets_the_topics_of_an_asset_that_is_gone(
    broker: Broker, host: Host
) -> None:
    asset, bus = Asset(), LiveMessages(ProcessClock())
    assets: dict[str, Any] = {"bench-1": asset}
    async with publishing(host, section(broker), asset, bus, assets):
        async with listening(broker) as listener:
            await listener.hear("bench-1/t_inner_ring_c", tag(61.5))
            assets["bench-2"] = Asset()
            assert await listener.hear("bench-2/t_inner_ring_c") == (tag(61.5), False)
            del assets["bench-1"]
            topic = "bench-1/t_inner_ring_c"
            assert await listener.hear(topic) == (tag(None, Quality.OUT_OF_SERVICE), False)
            assert await listener.hear(topic) == ("", False)
            # The topics of an asset are withdrawn together, each with the broker's answer; what
            # comes after them says that all of them are.
            assets["bench-3"] = Asset()
            await listener.hear("bench-3/t_inner_ring_c")
        found = await retained(broker)
    assert sorted(topic for topic in found if "/bench" in topic) == [
        f"hall-2/bench-{number}/t_inner_ring_c{end}" for number in (2, 3) for end in ("", ".twin")
    ]


async def test_a_broker_that_was_away_gets_everything_when_it_is_back(
    broker: Broker, host: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rounds, "REOPEN_FIRST_S", 0.1)
    monkeypatch.setattr(rounds, "REOPEN_LAST_S", 0.2)
    broker.stop()
    asset, bus = Asset(), LiveMessages(ProcessClock())
    async with publishing(host, section(broker), asset, bus):
        await asyncio.sleep(0.5)
        for _ in range(2):
            await asyncio.to_thread(broker.start)
            async with listening(broker) as listener:
                await listener.hear("bench-1/t_inner_ring_c", tag(61.5))
            broker.stop()
        bus.publish("alarm", "bench-1", {"id": "1"})
        # The listener comes first, as the broker keeps no alarm for it.
        broker.forbid("twin")
        await asyncio.to_thread(broker.start)
        async with listening(broker) as listener:
            await asyncio.to_thread(broker.permit, "twin")
            assert (await listener.hear("bench-1/alarms"))[0] == {"id": "1"}


@pytest.mark.parametrize("client", [Client, MqttClient])
async def test_a_late_write_is_not_for_the_next_socket_of_the_same_number(
    broker: Broker, client: type[Client]
) -> None:
    """The connection ends between the wish to write and the turn of the loop that writes."""
    loop = asyncio.get_running_loop()
    async with client(
        "127.0.0.1", broker.port, username="ear", password="secret", timeout=patience(PATIENCE_S)
    ) as connected:
        paho = connected._client
        own = paho.socket()
        assert own is not None
        number = own.fileno()
        paho.publish("works/x", b"1", qos=1)
        paho._sock_close()
        with socket.socket() as other:
            assert other.fileno() == number
            await asyncio.sleep(0)
            await asyncio.sleep(0)
            assert loop.remove_writer(number) == (client is Client), "what the library does"


async def test_a_cancellation_that_comes_with_the_acknowledgement_is_heard(broker: Broker) -> None:
    """Otherwise the service would not stop: its tasks are asked to end once."""
    async with MqttClient(
        "127.0.0.1", broker.port, username="twin", password="secret", timeout=patience(PATIENCE_S)
    ) as client:
        acknowledge = client._client.on_publish
        assert acknowledge is not None

        def acknowledge_and_cancel(*arguments: Any) -> None:
            acknowledge(*arguments)
            sending.cancel()

        client._client.on_publish = acknowledge_and_cancel
        sending = asyncio.create_task(client.publish("works/hall-2/status", b"", qos=1))
        await asyncio.wait({sending})
        assert sending.cancelled()


async def test_open_alarms_can_be_had_by_who_connects_late(broker: Broker, host: Host) -> None:
    """What ended while we were away is taken back."""

    async def open_alarms() -> list[dict[str, object]]:
        return [{"id": "old", "state": "ACKED"}]

    bus = LiveMessages(ProcessClock())
    async with listening(broker) as listener:
        async with MqttClient(
            "127.0.0.1",
            broker.port,
            username="ear",
            password="secret",
            timeout=patience(PATIENCE_S),
        ) as before:
            await before.publish("works/hall-2/service/alarms/gone", "{}", qos=1, retain=True)
        known = replace(host, open_alarms=open_alarms)
        async with publishing(known, section(broker), Asset(), bus):
            await listener.hear("service/alarms/gone", "")
            bus.publish("alarm", "bench-1", {"id": "new", "state": "UNACK"})
            bus.publish("alarm", None, {"id": "shared", "state": "UNACK"})
            await listener.hear("service/alarms/shared")
            async with listening(broker) as late:
                found = await late.all_until("service/alarms/new", "service/alarms/old")
                assert found["service/alarms/new"] == ('{"id": "new", "state": "UNACK"}', True)
                assert found["service/alarms/old"] == ('{"id": "old", "state": "ACKED"}', True)
            bus.publish("alarm", "bench-1", {"id": "new", "state": "NORM"})
            await listener.hear("service/alarms/new", "")
            async with listening(broker) as late:
                bus.publish("alarm", "bench-1", {"id": "end", "state": "UNACK"})
                heard = await late.all_until("service/alarms/shared", "service/alarms/end")
                assert "service/alarms/new" not in heard
                assert "service/alarms/gone" not in heard


LOST = """
import asyncio, sys
from pathlib import Path
from service.clock import ProcessClock
from adapters.samples import Quality
from service.bus.stream import LiveMessages
from service.plant.mqtt.client import MqttClient
from service.plant.mqtt.publisher import MqttPublisher
from service.plant.protocol import Host
from service.plant.rounds import PublisherRounds
from service.site.settings import MqttSection
section = MqttSection.model_validate_json(sys.argv[1])
host = Host(None, None, Path(sys.argv[2]))  # it asks for no keys
publisher = MqttPublisher(section)
asyncio.run(PublisherRounds("mqtt", publisher, 1.0, {}, LiveMessages(ProcessClock()), host).run())
"""


async def test_the_broker_says_offline_for_a_service_that_is_lost(
    broker: Broker, tmp_path: Path
) -> None:
    given = section(broker).model_dump() | {"password": "secret"}
    async with listening(broker) as listener:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-c", LOST, json.dumps(given), str(tmp_path)
        )
        try:
            await listener.hear("status", "online")
            process.kill()
            await listener.hear("status", "offline")
        finally:
            if process.returncode is None:
                process.kill()
            await process.wait()


async def test_a_wrong_password_leaves_the_service_running_and_is_never_shown(
    broker: Broker,
    host: Host,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(rounds, "REOPEN_FIRST_S", 0.1)
    monkeypatch.setattr(rounds, "REOPEN_LAST_S", 0.2)
    wrong = section(broker, password="not-the-secret")
    assert "not-the-secret" not in repr(wrong)
    shown = ""
    async with (
        publishing(host, wrong, Asset(), LiveMessages(ProcessClock())),
        within(PATIENCE_S),
    ):
        while "mqtt_away" not in shown:
            await asyncio.sleep(0.05)
            shown += "".join(capsys.readouterr())
    assert "ot authorized" in shown
    assert "not-the-secret" not in shown


def test_what_cannot_be_had_is_told_before_anything_starts(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    wanted = Settings(
        mqtt=MqttSection(enabled=True, tls=True, ca_file=Path("none.pem")), base_dir=tmp_path
    )
    with pytest.raises(SettingsError, match=r"mqtt.ca_file = .*none.pem'.*PEM certificates"):
        outlets.check_extras(wanted)
    monkeypatch.setattr(outlets, "find_spec", lambda name: None)
    with pytest.raises(SettingsError, match=r"mqtt.enabled = true: .*'bearing-twin\[mqtt\]'"):
        outlets.check_extras(wanted)


@pytest.mark.parametrize("prefix", ["", "/a", "a/", "a//b", "a/+", "#", "$SYS", "a b"])
def test_a_prefix_that_is_no_topic_is_refused(prefix: str) -> None:
    with pytest.raises(ValueError, match="topic_prefix"):
        MqttSection(topic_prefix=prefix)
