"""The Modbus server, read by two clients of other makers and attacked by bare sockets."""

import asyncio
import contextlib
import json
import math
import socket
import struct
import subprocess
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from patience import patience, wait_for
from processes import free_port, wait_until
from programs import needed
from pymodbus.client import AsyncModbusTcpClient
from site_files import asset_section

from service.bus.commands import PackedDocument
from service.bus.replica import UNCERTAIN_AFTER_S, AssetReplica
from service.bus.stream import LiveMessages
from service.clock import ProcessClock
from service.plant import publishers as outlets
from service.plant.modbus_server.image import NEVER, Image
from service.plant.modbus_server.publisher import ModbusPublisher
from service.plant.modbus_server.register_map import MappedTag, RegisterMap, map_of
from service.plant.modbus_server.wire import MOST_OF_ONE, ReadingServer
from service.plant.protocol import Host
from service.plant.rounds import PublisherRounds
from service.site.configuration import SettingsError
from service.site.settings import ModbusServerSection, Settings

pytestmark = pytest.mark.wires

INPUTS = ("speed_rpm", "t_inner_ring_c")
TAGS = (
    "t_inner_ring_c",
    "speed_rpm",
    "t_inner_ring_c.twin",
    "t_inner_ring_c.time_to_alarm_s",
    "no_c",
)
MAP = RegisterMap({"bench-1": INPUTS, "gone": ()}, [MappedTag("bench-1", one) for one in TAGS], 7)
NOW_US = 1_769_000_000_000_000
AGO_3_S = "2026-01-21T12:53:17.000Z"


def shown(value: float | None, quality: int = 192, time: str = AGO_3_S) -> dict[str, Any]:
    return {"value": value, "unit": "", "quality": quality, "time": time}


def safe_tags() -> dict[str, dict[str, Any]]:
    return {
        "t_inner_ring_c": shown(41.25),
        "speed_rpm": shown(1500.0),
        "t_inner_ring_c.twin": shown(40.875, 68),
        "t_inner_ring_c.time_to_alarm_s": shown(None, 32),
        "verdict.now": shown(1),
        "verdict.next_step": shown(1),
        "model.trusted": shown(1),
        "alarms.active": shown(0),
    }


class Site:
    """A server whose tags a test sets."""

    def __init__(self, host: Host) -> None:
        self.tags: dict[str, Any] | None = safe_tags()
        self.port = free_port()
        section = ModbusServerSection(enabled=True, port=self.port)
        self.publisher = ModbusPublisher(section, MAP)
        look = {"bench-1": lambda: self.tags}
        host = replace(
            host, tags_of=lambda asset: look.get(asset, lambda: None)(), now_us=lambda: NOW_US
        )
        self.rounds = PublisherRounds(
            "modbus_server", self.publisher, 0.05, {}, LiveMessages(ProcessClock()), host
        )

    @asynccontextmanager
    async def client(self) -> AsyncIterator[AsyncModbusTcpClient]:
        async with AsyncModbusTcpClient(
            "127.0.0.1", port=self.port, timeout=patience(20)
        ) as client:
            yield client

    async def bare(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        return await asyncio.open_connection("127.0.0.1", self.port)


@pytest.fixture
async def site(host: Host) -> AsyncIterator[Site]:
    site = Site(host)
    running = asyncio.create_task(site.rounds.run())

    def listens() -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", site.port)) == 0

    await asyncio.to_thread(wait_until, listens, 60.0, "the server listens")
    yield site
    assert not running.done(), running
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


def decoded(words: list[int]) -> list[tuple[float, int, int]]:
    values = struct.iter_unpack(">fHH", struct.pack(f">{len(words)}H", *words))
    return [(value, quality, age) for value, quality, age in values]


async def test_a_plc_reads_values_with_quality_and_age(site: Site) -> None:
    async with site.client() as client:
        answers = [
            await read(100, count=20, device_id=unit)
            for read in (client.read_input_registers, client.read_holding_registers)
            for unit in (0, 1, 247)
        ]
        assert len({tuple(answer.registers) for answer in answers}) == 1
        ring, speed, twin, never, unknown = decoded(answers[0].registers)
        assert (ring, speed, twin) == ((41.25, 192, 3), (1500.0, 192, 3), (40.875, 68, 3))
        assert math.isnan(never[0])
        assert never[1:] == (32, NEVER)
        assert math.isnan(unknown[0])
        assert unknown[1:] == (4, NEVER), "a tag that does not exist is an error of configuration"
        head = (await client.read_input_registers(0, count=12)).registers
        # The other asset is not there: its data are old, its model is not trusted.
        assert head[1:4] == [7, 2 + 4, 5]
        assert head[4] << 16 | head[5] == NOW_US // 1_000_000
        assert head[10:] == [1, 0]
        for read in (client.read_coils, client.read_discrete_inputs):
            assert (await read(0, count=2)).bits[:2] == [True, False]
        site.tags = safe_tags() | {"verdict.next_step": shown(0)}
        assert (await client.read_coils(0, count=1)).bits[0] is False
        site.tags = safe_tags() | {"t_inner_ring_c": shown(1e300), "alarms.active": shown(2)}
        words = (await client.read_input_registers(102, count=1)).registers
        assert words == [0], "part of a tag, whose value no float32 has"
        ring = decoded((await client.read_input_registers(100, count=4)).registers)[0]
        assert math.isnan(ring[0])
        assert (await client.read_input_registers(2, count=1)).registers == [1 + 2 + 4]

        async def beat() -> int:
            return int((await client.read_input_registers(0, count=1)).registers[0])

        first = await beat()
        for _ in range(600):
            if await beat() >= first + 2:
                break
            await asyncio.sleep(0.1)
        assert await beat() >= first + 2


@pytest.mark.parametrize(
    "lost",
    [{name: shown(41.25, quality)} for name in INPUTS for quality in (24, 64)]
    + [{INPUTS[0]: shown(None)}, {INPUTS[0]: None}],
)
@pytest.mark.parametrize("alarms", [0, 2])
def test_the_status_says_that_data_are_missing_when_one_input_is_lost(
    lost: dict[str, Any], alarms: int
) -> None:
    alone = RegisterMap({"bench-1": INPUTS}, MAP.tags, 7)
    tags = safe_tags() | {"alarms.active": shown(alarms)}
    image = Image(alone, lambda asset: tags, lambda: NOW_US)
    alarm = int(alarms > 0)
    assert image.registers(2, 1) == [alarm]
    tags = {name: one for name, one in (tags | lost).items() if one is not None}
    assert image.registers(2, 1) == [alarm + 4]
    assert image.bits(0, 1) == [False]


async def test_nobody_writes_and_nothing_is_read_beyond_the_map(site: Site) -> None:
    async with site.client() as client:
        before = (await client.read_holding_registers(100, count=20)).registers
        refused = [
            await client.write_coil(0, True),
            await client.write_register(0, 9),
            await client.write_coils(0, [True, True]),
            await client.write_registers(100, [1, 2]),
            await client.mask_write_register(address=100, and_mask=0, or_mask=0xFFFF),
            await client.readwrite_registers(
                read_address=0, read_count=1, write_address=0, values=[5]
            ),
        ]
        assert [answer.exception_code for answer in refused] == [1] * 6
        assert (await client.read_holding_registers(100, count=20)).registers == before
        for address, count in ((100, 21), (120, 1), (65535, 1), (0, 121)):
            answer = await client.read_input_registers(address, count=count)
            assert answer.exception_code == 2, (address, count)
        assert (await client.read_coils(0, count=3)).exception_code == 2
        assert (await client.read_coils(65535, count=1)).exception_code == 2


async def test_no_answer_mixes_two_moments(site: Site) -> None:
    async def change() -> None:
        number = 0
        while True:
            number += 1
            site.tags = {name: shown(float(number)) for name in TAGS}
            await asyncio.sleep(0)

    changing = asyncio.create_task(change())
    seen = set()
    async with site.client() as client:
        for _ in range(200):
            values = decoded((await client.read_input_registers(100, count=20)).registers)
            assert len({value for value, _, _ in values}) == 1
            seen.add(values[0][0])
    changing.cancel()
    assert len(seen) > 20


async def test_mbpoll_reads_a_float(site: Site) -> None:
    arguments = ["-m", "tcp", "-a", "1", "-t", "3:float", "-B", "-r", "101", "-c", "1", "-1"]
    run = await asyncio.create_subprocess_exec(
        needed("mbpoll"), *arguments, "-p", str(site.port), "127.0.0.1",
        stdout=subprocess.PIPE,
    )  # fmt: skip
    out, _ = await wait_for(run.communicate(), 60)
    assert any(line.split() == ["[101]:", "41.25"] for line in out.decode().splitlines()), out


async def test_hostile_clients_keep_nobody_from_the_values(site: Site) -> None:
    request = struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 100, 20)
    attacks = (request[:5], request, b"\0\1\0\0\xff\xff\1\4", b"GET / HTTP/1.1\r\n\r\n")
    crowd = []
    for number in range(3 * MOST_OF_ONE):
        reader, writer = await site.bare()
        # Half requests, requests whose answers nobody takes, a length that lies, no Modbus at all.
        for _ in range(1000 if number % 4 == 1 else 1):
            with contextlib.suppress(OSError):
                writer.write(attacks[number % 4])
        crowd.append((reader, writer))
    async with site.client() as client:
        for _ in range(20):
            answer = await client.read_input_registers(100, count=4)
            assert decoded(answer.registers)[0][0] == 41.25
        server = site.publisher._server
        assert server is not None
        assert len(server._connections) <= MOST_OF_ONE
        # Who was given up is told so by the end of the connection.
        ended = await wait_for(crowd[0][0].read(), 60)
        assert ended == b""
        assert site.rounds.problem is None
    for _, writer in crowd:
        writer.close()


@given(st.binary(min_size=1, max_size=253))
def test_every_request_has_an_answer_and_only_reading_ones_have_data(request_: bytes) -> None:
    image = Image(MAP, lambda asset: None, lambda: NOW_US)
    answer = ReadingServer(image.registers, image.bits).answer(request_)
    assert 2 <= len(answer) <= 253
    assert answer[0] in (request_[0], request_[0] | 0x80)
    if request_[0] not in (1, 2, 3, 4):
        assert answer == bytes((request_[0] | 0x80, 1))


async def test_a_snapshot_that_nobody_renews_takes_the_permissive_by_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    replica = AssetReplica("bench-1", None)  # type: ignore[arg-type]
    began_s = time.monotonic()
    replica.take(
        "snapshot", PackedDocument(b"1", json.dumps({"tags": safe_tags()}).encode()), began_s
    )
    image = Image(MAP, lambda asset: replica.snapshot()["tags"], lambda: NOW_US)
    assert image.bits(0, 1) == [True]
    monkeypatch.setattr(time, "monotonic", lambda: began_s + UNCERTAIN_AFTER_S - 0.1)
    assert image.bits(0, 1) == [True]
    monkeypatch.setattr(time, "monotonic", lambda: began_s + UNCERTAIN_AFTER_S + 0.1)
    assert image.bits(0, 1) == [False]
    assert image.registers(10, 1) == [0]
    assert image.registers(2, 1) == [2 + 4]
    assert [quality for _, quality, _ in decoded(image.registers(100, 8))] == [68, 68]


# ------------------------------------------------------------------------------------- the map
def settings_of(tags: list[str] | None = None, **section: Any) -> Settings:
    channels = ("speed_rpm", "load_n", "t_inner_ring_c")
    server = {"enabled": True, "tags": tags or [], **section}
    assets = [asset_section(name, channels) for name in ("bench-1", "bench-2")]
    return Settings(assets=assets, modbus_server=server)  # type: ignore[arg-type]


def test_the_map_follows_the_configuration_and_its_version_tells() -> None:
    usual = map_of(settings_of())
    assert usual == map_of(settings_of()), "the same in every process"
    assert usual.version == 8334, "and in every release: a PLC compares it with a constant"
    assert list(usual.assets) == ["bench-1", "bench-2"]
    assert usual.assets["bench-1"] == ("t_inner_ring_c", "speed_rpm", "load_n")
    two = ["bench-2/t_inner_ring_c.twin", "bench-1/speed_rpm"]
    chosen, turned = map_of(settings_of(two)), map_of(settings_of(two[::-1]))
    assert list(chosen.assets) == ["bench-2", "bench-1"]
    assert len({usual.version, chosen.version, turned.version}) == 3
    entries = {(one.table, one.name): one.address for one in chosen.entries()}
    assert entries["register", "bench-2/permissive"] == 10
    assert entries["bit", "bench-1/permissive"] == 1
    assert entries["register", "bench-1/speed_rpm"] == 104
    assert entries["register", "bench-1/speed_rpm age"] == 107


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        (["bench-9/speed_rpm"], "modbus_server.tags[0] = 'bench-9/speed_rpm': expected an asset"),
        (["speed_rpm"], "expected ASSET/TAG"),
        (
            ["bench-1/speed_rpm", "bench-1/speed_rpm"],
            "tags[1] = 'bench-1/speed_rpm': is there twice",
        ),
    ],
)
def test_a_map_that_cannot_be_is_refused(tags: list[str], expected: str) -> None:
    with pytest.raises(SettingsError) as error:
        outlets.check_extras(settings_of(tags))
    assert expected in str(error.value)


def test_it_is_off_by_default_and_warns_off_loopback() -> None:
    assert Settings().modbus_server.enabled is False
    assert outlets.warnings(settings_of()) == []
    (line,) = outlets.warnings(settings_of(host="0.0.0.0"))
    assert line.startswith("modbus_server.host = '0.0.0.0': anyone with access")
    assert outlets.warnings(settings_of(host="0.0.0.0", enabled=False)) == []
