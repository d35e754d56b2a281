"""Which requests a Modbus source makes, and that none of them writes."""

import ast
import asyncio
import itertools
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import adapters
from adapters.configuration import ConfigurationError
from adapters.drivers.modbus.config import (
    BIT_KINDS,
    ModbusChannel,
    ModbusPlan,
    ModbusRtuSource,
    ModbusTcpSource,
)
from adapters.drivers.modbus.link import Link, WriteRefusedError
from adapters.drivers.modbus.mapping import UnitMap, check, compile_units
from adapters.drivers.modbus.rounds import Round, Rounds
from adapters.protocol import ChannelBinding, PlanBinding
from adapters.samples import Batch

ROOT = Path(adapters.__file__).parents[1]
WORDS = {"int16": 1, "uint16": 1, "int32": 2, "uint32": 2, "float32": 2, "float64": 4, "bool": 1}


def source(**keys: Any) -> ModbusTcpSource:
    return ModbusTcpSource.model_validate({"name": "plc", "host": "127.0.0.1", **keys})


def bound(number: int, **keys: Any) -> ChannelBinding:
    config = ModbusChannel.model_validate({"source": "plc", **keys})
    return ChannelBinding("bench", f"channel-{number}", config)


@st.composite
def channels(draw: st.DrawFn) -> ChannelBinding:
    kind = draw(st.sampled_from(["input", "holding", "coil", "discrete"]))
    types = ["bool"] if kind in BIT_KINDS else [one for one in WORDS if one != "bool"]
    keys: dict[str, Any] = {
        "kind": kind,
        "type": draw(st.sampled_from(types)),
        "register": draw(st.integers(0, 400) | st.integers(65000, 65532)),
        "unit_id": draw(st.sampled_from([None, 1, 2])),
        "poll_interval_s": draw(st.sampled_from([None, 0.1, 1.0, 60.0])),
    }
    if draw(st.booleans()):
        keys["status"] = {"register": draw(st.integers(0, 400)), "bits": {"0": "wire break"}}
    return bound(0, **keys)


@given(
    found=st.lists(channels(), min_size=1, max_size=40),
    most=st.integers(4, 125),
    gap=st.none() | st.integers(0, 20),
)
def test_every_register_is_read_once_per_period_and_no_other_than_is_allowed(
    found: list[ChannelBinding], most: int, gap: int | None
) -> None:
    settings = source(registers_per_read_max=most, register_gap_max=gap)
    bindings = [
        ChannelBinding("bench", f"channel-{number}", one.config) for number, one in enumerate(found)
    ]
    check(settings, bindings, [])
    wanted: dict[tuple[int, float, str], set[int]] = {}
    for binding in bindings:
        config = binding.config
        assert isinstance(config, ModbusChannel)
        key = (config.unit_id or settings.unit, config.poll_interval_s or settings.poll_interval_s)
        cells = {*range(config.address, config.address + WORDS[config.type])}
        wanted.setdefault((*key, config.kind), set()).update(cells)
        if config.status is not None:
            wanted[*key, config.kind].add(config.status.address)
    read: dict[tuple[int, float, str], list[int]] = {}
    for one in compile_units(settings, bindings, [], 1.0):
        for group in one.groups:
            bits = group.kind in BIT_KINDS
            assert 1 <= group.count <= (most * 16 if bits else most)
            asked = {*range(group.start, group.start + group.count)}
            need = sorted(asked & wanted[one.unit, one.interval_s, group.kind])
            assert need[0] == group.start
            assert need[-1] == group.start + group.count - 1
            allowed = gap if gap is not None else 64 if bits else 8
            assert all(b - a - 1 <= allowed for a, b in itertools.pairwise(need))
            read.setdefault((one.unit, one.interval_s, group.kind), []).extend(
                address for cell, _ in group.cells for address in {cell.address}
            )
    for key, addresses in read.items():
        assert set(addresses) <= wanted[key]
        starts = {
            cell.address
            for binding in bindings
            if isinstance(cell := binding.config, ModbusChannel)
            and (cell.unit_id or settings.unit, cell.poll_interval_s or settings.poll_interval_s)
            == key[:2]
            and cell.kind == key[2]
        }
        assert starts <= set(addresses)


class StepClock:
    """A clock that only the test moves."""

    rate = 1.0

    def __init__(self) -> None:
        self.us = 0

    def now_us(self) -> int:
        return self.us

    async def sleep(self, process_seconds: float) -> None:
        self.us += max(1, round(process_seconds * 1e6))


async def run_rounds(
    intervals_ms: list[int], costs_us: list[int], requests: list[int], until_us: int
) -> tuple[dict[int, list[int]], Rounds]:
    """When each round began, with requests that take a time of their own."""
    clock = StepClock()
    limits: Any = None
    maps = [UnitMap(1, ms / 1e3, limits, [], [], []) for ms in intervals_ms]
    cost = {ms * 1000: (c, n) for ms, c, n in zip(intervals_ms, costs_us, requests, strict=True)}
    rounds = Rounds(clock, maps)
    began: dict[int, list[int]] = {ms * 1000: [] for ms in intervals_ms}

    async def steps(one: Round) -> AsyncGenerator[Batch | None]:
        cost_us, count = cost[one.interval_us]
        began[one.interval_us].append(clock.us)
        for _ in range(count):
            clock.us += cost_us
            yield None
        yield Batch()

    rounds.begin()
    while clock.us < until_us:
        one = await rounds.next()
        if one.steps is None:
            one.steps = steps(one)
        if await anext(one.steps) is not None:
            await one.end()
    await rounds.end()
    return began, rounds


@given(
    slow=st.lists(
        st.tuples(st.integers(200, 5000), st.integers(100, 20_000), st.integers(1, 30)),
        min_size=1,
        max_size=4,
        unique_by=lambda row: row[0],
    ),
    cost_us=st.integers(100, 40_000),
)
def test_a_fast_round_waits_for_one_slow_request_at_most(
    slow: list[tuple[int, int, int]], cost_us: int
) -> None:
    intervals = [100, *(row[0] for row in slow)]
    costs = [cost_us, *(row[1] for row in slow)]
    began, _ = asyncio.run(
        run_rounds(intervals, costs, [1, *(row[2] for row in slow)], until_us=12_000_000)
    )
    late_us = [at - number * 100_000 for number, at in enumerate(began[100_000])]
    assert all(0 <= late <= max(costs[1:]) for late in late_us)  # and so none is left out
    load = sum(cost * count / ms / 1e3 for ms, cost, count in slow)
    if load + cost_us / 100_000 < 0.9:
        assert all(began.values())


def test_slow_rounds_come_to_an_end_where_the_device_cannot_keep_the_fast_one() -> None:
    began, rounds = asyncio.run(
        run_rounds([10, 100, 1000], [30_000, 30_000, 30_000], [2, 5, 20], until_us=60_000_000)
    )
    assert rounds.skipped
    assert min(len(times) for times in began.values()) >= 5
    assert len(began[10_000]) > len(began[1_000_000])


@pytest.mark.parametrize(
    ("settings", "registers", "expected"),
    [
        ({"registers_per_read_max": 3}, [{"type": "float64"}], "float64 takes 4 registers"),
        (
            {"request_gap_s": 0.3, "register_gap_max": 0},
            [{}, {"register": 9}, {"register": 20}, {"register": 30}],
            "request_gap_s 0.3 is too long: with 4 requests the gaps alone take 1.2 times",
        ),
    ],
)
def test_what_a_device_cannot_do_is_said_before_anything_starts(
    settings: dict[str, Any], registers: list[dict[str, Any]], expected: str
) -> None:
    bindings = [
        bound(number, **{"register": 0, "type": "int16", **keys})
        for number, keys in enumerate(registers)
    ]
    with pytest.raises(ConfigurationError, match=expected):
        check(source(**settings), bindings, [])


def test_a_plan_needs_a_whole_row_at_once() -> None:
    plan = PlanBinding(
        "bench", ModbusPlan.model_validate({"source": "plc", "register": 40, "rows": 2})
    )
    with pytest.raises(ConfigurationError, match="a row takes 6 registers"):
        check(source(registers_per_read_max=5), [], [plan])


WRITES: dict[str, dict[str, Any]] = {
    "write_coil": {"address": 0, "value": True},
    "write_coils": {"address": 0, "values": [True]},
    "write_register": {"address": 0, "value": 1},
    "write_registers": {"address": 0, "values": [1]},
    "mask_write_register": {},
    "readwrite_registers": {},
    "diag_restart_communication": {"toggle": True},
    "write_file_record": {"records": []},
}


@pytest.mark.parametrize(
    "settings",
    [
        source(),
        source(framing="rtu"),
        ModbusRtuSource.model_validate({"name": "line", "device": "/dev/null"}),
    ],
)
@pytest.mark.parametrize("name", WRITES)
async def test_the_client_itself_refuses_to_write(name: str, settings: Any) -> None:
    client = Link(settings)._new_client()
    with pytest.raises(WriteRefusedError):
        await getattr(client, name)(**WRITES[name])


def test_only_the_link_makes_modbus_clients_and_nothing_names_a_write() -> None:
    clients: set[str] = set()
    writers: set[str] = set()
    for path in [*(ROOT / "adapters").rglob("*.py"), *(ROOT / "service").rglob("*.py")]:
        place = path.relative_to(ROOT).as_posix()
        if place.startswith("adapters/virtual_bench/"):
            continue
        text = path.read_text("utf-8")
        if "pymodbus" not in text:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Attribute) and node.attr in WRITES:
                writers.add(place)
            modules = [one.name for one in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module:
                modules = [node.module, *(f"{node.module}.{one.name}" for one in node.names)]
            if any(one.startswith(("pymodbus.client", "pymodbus.pdu")) for one in modules):
                clients.add(place)
    # Benchmarks measure the library alone; the demo starts faults of its own virtual bench.
    bench_tools = {"service/demo/run.py"} | {
        f"laboratory/bearing_twin_laboratory/benchmarks/{name}.py" for name in ("fleet", "wires")
    }
    assert clients - bench_tools == {"adapters/drivers/modbus/link.py"}
    assert writers <= {"service/demo/run.py"}
