"""What a broker keeps of an earlier process of the service, and what the next one withdraws."""

import asyncio
import contextlib
import sqlite3
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mqtt_site import (
    PATIENCE_S,
    Asset,
    Broker,
    listening,
    publishing,
    retained,
    section,
    tag,
)
from patience import patience

from adapters.samples import Quality
from service.bus.stream import LiveMessages
from service.clock import ProcessClock, rfc3339
from service.domain.errors import CellUnavailableError
from service.plant import kept_tags, rounds
from service.plant.kept_tags import FILE_NAME
from service.plant.mqtt.client import MqttClient
from service.plant.protocol import Host

pytestmark = pytest.mark.wires
RING = "t_inner_ring_c"
TWIN = f"{RING}.twin"
NOW_US = 1_800_000_000_000_000


@pytest.fixture
def host(host: Host) -> Host:
    return replace(host, now_us=lambda: NOW_US)


def bus() -> LiveMessages:
    return LiveMessages(ProcessClock())


def without_value(unit: str, quality: int) -> dict[str, Any]:
    return {"value": None, "unit": unit, "quality": quality, "time": rfc3339(NOW_US)}


async def publish_once(broker: Broker, host: Host, *names: str, **more: Any) -> None:
    """One process of the service with these assets, until all of them were handed on."""
    assets = {name: Asset() for name in names}
    async with (
        publishing(host, section(broker, **more), Asset(), bus(), assets),
        listening(broker) as listener,
    ):
        await listener.hear("status", "online")


def topics(found: dict[str, Any]) -> list[str]:
    return sorted(one for one in found if not one.endswith("/status"))


def of(*assets: str, prefix: str = "hall-2") -> list[str]:
    return [f"{prefix}/{asset}/{name}" for asset in assets for name in (RING, TWIN)]


async def test_what_was_removed_while_the_service_was_down_is_withdrawn(
    broker: Broker, host: Host
) -> None:
    """A channel, tags of a limit, and a whole asset; also for who has listened all the time."""
    before = Asset()
    before.tags |= {name: tag(4.0) for name in ("t_outer_ring_c", f"{RING}.time_to_alarm_s")}
    before.tags["alarms.active"] = tag(0.0)
    async with listening(broker) as listener:
        assets = {"bench-1": before, "bench-2": Asset()}
        async with publishing(host, section(broker), before, bus(), assets):
            await listener.hear("status", "online")
        await listener.hear("status", "offline")
        async with publishing(host, section(broker), Asset(), bus()):
            gone = {
                "bench-1/t_outer_ring_c": "°C",
                f"bench-1/{RING}.time_to_alarm_s": "s",
                "bench-1/alarms.active": "",
                f"bench-2/{RING}": "°C",
                f"bench-2/{TWIN}": "°C",
            }
            heard = await listener.rows_until("status", "online")
            for topic, unit in gone.items():
                last = without_value(unit, Quality.OUT_OF_SERVICE)
                assert heard[topic] == [last, ""], topic
            assert topics(await retained(broker)) == of("bench-1")
        # The next process has nothing left to do.
        await listener.hear("status", "offline")
        async with publishing(host, section(broker), Asset(), bus()):
            heard = await listener.rows_until("status", "online")
            assert not gone.keys() & heard.keys()


async def test_online_is_said_when_all_that_is_retained_is_of_this_process(
    broker: Broker, host: Host
) -> None:
    """Also where the broker did not notice yet that an earlier process is gone."""
    await publish_once(broker, host, "bench-1", "bench-2")
    async with MqttClient(
        "127.0.0.1", broker.port, username="ear", password="secret", timeout=patience(PATIENCE_S)
    ) as client:
        await client.publish("works/hall-2/status", b"online", qos=1, retain=True)
    async with listening(broker) as listener:
        assert await listener.hear("status") == ("online", True)
        async with publishing(host, section(broker), Asset(), bus()):
            heard = await listener.order_until("status", "online")
    begin = heard.index(("status", "offline"))
    changed = {f"hall-2/{topic}" for topic, _ in heard[begin + 1 : -1]}
    assert changed == {*of("bench-1", "bench-2")}


async def test_what_others_publish_below_the_same_prefix_is_left_alone(
    broker: Broker, host: Host, tmp_path: Path
) -> None:
    other = replace(host, data_dir=tmp_path / "other")
    await publish_once(broker, other, "other-1")
    await publish_once(broker, host, "bench-1", "bench-2")
    await publish_once(broker, host, "bench-1")
    assert topics(await retained(broker)) == of("bench-1", "other-1")


async def test_the_list_is_of_one_prefix_at_one_broker(broker: Broker, host: Host) -> None:
    await publish_once(broker, host, "bench-1", "bench-2")
    asset = {"bench-1": Asset()}
    hall_3 = section(broker, topic_prefix="works/hall-3")
    async with (
        publishing(host, hall_3, Asset(), bus(), asset),
        listening(broker) as listener,
    ):
        await listener.order_until("works/hall-3/status", "online")
        both = of("bench-1", "bench-2") + of("bench-1", prefix="hall-3")
        assert topics(await retained(broker)) == both
    assert (await retained(broker))["hall-2/status"] == "offline"
    await publish_once(broker, host, "bench-1")
    assert topics(await retained(broker)) == of("bench-1") + of("bench-1", prefix="hall-3")


class Silent(Asset):
    """An asset whose cell has not answered yet."""

    def snapshot(self) -> dict[str, Any]:
        raise CellUnavailableError("the cell has not answered yet")


@pytest.mark.parametrize("assets", [{}, {"bench-2": Silent()}], ids=["not there", "no snapshot"])
async def test_an_asset_whose_cell_does_not_answer_has_no_value_and_stays(
    broker: Broker, host: Host, assets: dict[str, Any]
) -> None:
    await publish_once(broker, host, "bench-1", "bench-2")
    known = replace(host, is_known=lambda name: name in ("bench-1", "bench-2"))
    assets = {"bench-1": Asset(), **assets}
    async with (
        listening(broker) as listener,
        publishing(known, section(broker), Asset(), bus(), assets),
    ):
        await listener.hear("status", "online")
        found = await retained(broker)
        assert topics(found) == of("bench-1", "bench-2")
        waiting = without_value("°C", Quality.WAITING_FOR_INITIAL_DATA)
        assert [found[topic] for topic in of("bench-2")] == [waiting, waiting]
        assets["bench-2"] = back = Asset()
        del back.tags[TWIN]
        assert await listener.hear(f"bench-2/{TWIN}", "") == ("", False)
        assert (await retained(broker))[f"hall-2/bench-2/{RING}"] == tag(61.5)


async def test_what_was_removed_while_the_broker_was_away_is_withdrawn_with_a_last_word(
    broker: Broker, host: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rounds, "REOPEN_FIRST_S", 0.1)
    monkeypatch.setattr(rounds, "REOPEN_LAST_S", 0.2)
    asset = Asset()
    async with publishing(host, section(broker), asset, bus()):
        async with listening(broker) as listener:
            await listener.hear("status", "online")
        broker.forbid("twin")
        await asyncio.to_thread(broker.restart)
        del asset.tags[TWIN]
        async with listening(broker) as listener:
            await asyncio.to_thread(broker.permit, "twin")
            last = without_value("°C", Quality.OUT_OF_SERVICE)
            assert (await listener.hear(f"bench-1/{TWIN}", last))[0] == last
            assert await listener.hear(f"bench-1/{TWIN}") == ("", False)


async def test_a_list_that_cannot_be_read_or_written_stops_nothing(
    broker: Broker, host: Host, capsys: pytest.CaptureFixture[str]
) -> None:
    await publish_once(broker, host, "bench-1")
    file = host.data_dir / "mqtt" / FILE_NAME
    assert file.stat().st_mode & 0o777 == 0o600
    file.write_bytes(b"not a database" * 1000)
    await publish_once(broker, host, "bench-1", "bench-2")
    assert "mqtt_kept_tags_damaged" in "".join(capsys.readouterr())
    await publish_once(broker, host, "bench-1")
    assert topics(await retained(broker)) == of("bench-1"), "the list is a new one"
    file.unlink()
    file.mkdir()
    await publish_once(broker, host, "bench-1")
    assert "mqtt_kept_tags_failed" in "".join(capsys.readouterr())


async def test_a_list_that_is_locked_at_the_start_is_read_when_it_is_free(
    broker: Broker, host: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept_tags, "_PAUSE_S", 0.1)
    await publish_once(broker, host, "bench-1", "bench-2")
    with contextlib.closing(sqlite3.connect(host.data_dir / "mqtt" / FILE_NAME)) as copy:
        copy.execute("BEGIN EXCLUSIVE")
        async with (
            publishing(host, section(broker), Asset(), bus()),
            listening(broker) as listener,
        ):
            await listener.hear("status", "online")
            assert topics(await retained(broker)) == of("bench-1", "bench-2")
            copy.rollback()
            assert await listener.hear(f"bench-2/{TWIN}", "") == ("", False)
    assert topics(await retained(broker)) == of("bench-1")
