import logging
import math
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.configuration import ConfigurationError
from adapters.drivers.modbus.config import ModbusChannel, ModbusPlan, ModbusTcpSource
from adapters.drivers.modbus.groups import Group
from adapters.drivers.modbus.mapping import PolledChannel, UnitMap, check, compile_units
from adapters.drivers.modbus.plan import ImplausiblePlanError, decode_plan
from adapters.protocol import ChannelBinding, PlanBinding
from adapters.samples import PlanStep, Quality

SOURCE = ModbusTcpSource(name="plc", host="127.0.0.1")


def channel(name: str, **keys: Any) -> ChannelBinding:
    config = ModbusChannel.model_validate({"source": "plc", **keys})
    return ChannelBinding("bench", name, config)


def compiled(*channels: ChannelBinding) -> UnitMap:
    check(SOURCE, channels, [])
    (unit,) = compile_units(SOURCE, channels, [], 1.0)
    return unit


def evaluate(registers: list[int], time_us: int = 10, **keys: Any) -> tuple[float, Quality, str]:
    """Decode one channel at register 0 of a block that starts at 0."""
    unit = compiled(channel("c", register=0, **keys))
    for group in unit.groups:
        group.store(registers[group.start : group.start + group.count], time_us)
    value, quality, _, reason = unit.points[0].evaluate(time_us)
    return value, quality, reason


TYPES = {
    "int16": ("h", st.integers(-(2**15), 2**15 - 1)),
    "uint16": ("H", st.integers(0, 2**16 - 1)),
    "int32": ("i", st.integers(-(2**31), 2**31 - 1)),
    "uint32": ("I", st.integers(0, 2**32 - 1)),
    "float32": ("f", st.floats(width=32, allow_nan=False, allow_infinity=False)),
    "float64": ("d", st.floats(allow_nan=False, allow_infinity=False)),
}


@pytest.mark.parametrize("value_type", TYPES)
@given(data=st.data())
def test_every_word_and_byte_order_is_read_as_it_was_written(
    value_type: str, data: st.DataObject
) -> None:
    code, values = TYPES[value_type]
    value = data.draw(values)
    word_order = data.draw(st.sampled_from(["big", "little"]))
    byte_order = data.draw(st.sampled_from(["big", "little"]))
    payload = struct.pack(">" + code, value)
    words = [payload[i : i + 2] for i in range(0, len(payload), 2)]
    if word_order == "little":
        words.reverse()
    if byte_order == "little":
        words = [word[::-1] for word in words]
    registers = [int.from_bytes(word, "big") for word in words]
    read, quality, _ = evaluate(
        registers, type=value_type, word_order=word_order, byte_order=byte_order
    )
    assert quality == Quality.GOOD
    assert read == value


def test_cdab_is_word_order_little() -> None:
    # 1234.5 as float32 is 44 9A 50 00
    assert evaluate([0x449A, 0x5000], type="float32")[0] == 1234.5
    assert evaluate([0x5000, 0x449A], type="float32", word_order="little")[0] == 1234.5
    assert evaluate([0x9A44, 0x0050], type="float32", byte_order="little")[0] == 1234.5


def test_scale_and_offset_come_before_the_conversion() -> None:
    assert evaluate([-55 & 0xFFFF], scale=0.1, offset=-1.0)[0] == pytest.approx(-6.5)
    value, quality, _ = evaluate([13850], scale=0.01, conversion="pt100_ohm")
    assert value == pytest.approx(99.985, abs=1e-2)
    assert quality == Quality.GOOD


@pytest.mark.parametrize(("raw", "reason"), [(50, "short circuit"), (42000, "wire break")])
def test_a_broken_pt100_is_a_sensor_failure(raw: int, reason: str) -> None:
    value, quality, said = evaluate([raw], type="uint16", scale=0.01, conversion="pt100_ohm")
    assert math.isnan(value)
    assert quality == Quality.SENSOR_FAILURE
    assert said == reason


def test_sentinels_are_compared_before_scaling_and_exactly() -> None:
    keys: dict[str, Any] = {"scale": 0.1, "sentinels": [-32768, 9999]}
    for raw in (0x8000, 9999):
        value, quality, reason = evaluate([raw], **keys)
        assert math.isnan(value)
        assert quality == Quality.SENSOR_FAILURE
        assert "sentinel" in reason
    assert evaluate([9998], **keys)[:2] == (pytest.approx(999.8), Quality.GOOD)


def test_a_float_sentinel_is_meant_as_the_device_holds_it() -> None:
    raw = struct.unpack(">2H", struct.pack(">f", -999.9))
    assert evaluate(list(raw), type="float32", sentinels=[-999.9])[1] == Quality.SENSOR_FAILURE


def test_a_sentinel_that_cannot_occur_is_pointed_out(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        compiled(channel("c", register=0, sentinels=[32768, -32768]))
    assert [record.getMessage() for record in caplog.records] == [
        "channel bench/c: sentinel 32768 can never occur in int16"
    ]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_not_a_number_is_never_good(value: float) -> None:
    registers = list(struct.unpack(">2H", struct.pack(">f", value)))
    read, quality, _ = evaluate(registers, type="float32")
    assert math.isnan(read)
    assert quality == Quality.SENSOR_FAILURE


def test_outside_the_valid_range_the_value_is_kept_but_uncertain() -> None:
    limits = [-20.0, 150.0]
    assert evaluate([1500], scale=0.1, valid_range=limits)[:2] == (150.0, Quality.GOOD)
    assert evaluate([1501], scale=0.1, valid_range=limits)[:2] == (
        pytest.approx(150.1),
        Quality.EU_EXCEEDED,
    )


def test_status_bits_name_what_is_wrong() -> None:
    status = {"register": 1, "bits": {"4": "short circuit", "5": "wire break"}}
    assert evaluate([250, 0b1111_1111_1100_1111], status=status)[1] == Quality.GOOD
    value, quality, reason = evaluate([250, 0b0011_0000], status=status)
    assert math.isnan(value)
    assert quality == Quality.SENSOR_FAILURE
    assert reason == "status: short circuit, wire break"


def test_status_may_be_discrete_inputs() -> None:
    status = {"register": 8, "kind": "discrete", "bits": {"1": "open"}}
    unit = compiled(channel("c", register=0, status=status))
    assert [(g.kind, g.start, g.count) for g in unit.groups] == [
        ("holding", 0, 1),
        ("discrete", 8, 2),
    ]
    unit.groups[0].store([250], 1)
    unit.groups[1].store([True, False], 1)
    assert unit.points[0].evaluate(1)[1] == Quality.GOOD
    unit.groups[1].store([False, True], 2)
    assert unit.points[0].evaluate(2)[1] == Quality.SENSOR_FAILURE


@pytest.mark.parametrize(
    ("code", "quality"),
    [
        (1, Quality.CONFIG_ERROR),
        (2, Quality.CONFIG_ERROR),
        (3, Quality.CONFIG_ERROR),
        (4, Quality.DEVICE_FAILURE),
        (8, Quality.DEVICE_FAILURE),
        (0x77, Quality.BAD),
    ],
)
def test_an_exception_never_leaves_a_value(code: int, quality: Quality) -> None:
    unit = compiled(channel("c", register=4))
    unit.groups[0].store([250], 1)
    assert unit.points[0].evaluate(1)[1] == Quality.GOOD
    unit.groups[0].fail(code, 2)
    value, got, kind, reason = unit.points[0].evaluate(2)
    assert math.isnan(value)
    assert got == quality
    assert kind == f"exception_{code:02x}"
    assert "register 4 (holding, unit 1)" in reason


@pytest.mark.parametrize("code", [5, 6])
def test_a_busy_device_keeps_its_last_good_value_as_uncertain(code: int) -> None:
    unit = compiled(channel("c", register=0, sentinels=[-1], max_age_s=5))
    point, group = unit.points[0], unit.groups[0]
    group.fail(code, 1)
    value, quality, *_ = point.evaluate(1)
    assert math.isnan(value)
    assert quality == Quality.WAITING_FOR_INITIAL_DATA
    group.store([250], 2)
    assert point.evaluate(2)[:2] == (250.0, Quality.GOOD)
    group.fail(code, 3)
    assert point.evaluate(3)[:2] == (250.0, Quality.LAST_USABLE)
    # not for ever
    assert point.evaluate(2 + 5_000_001)[1] == Quality.COMM_FAILURE
    # also where the clock was set back
    group.store([250], 3_600_000_000)
    point.evaluate(3_600_000_000)
    group.fail(code, 3)
    assert point.evaluate(3)[1] == Quality.COMM_FAILURE
    # and not across a sensor failure
    group.store([250], 4)
    point.evaluate(4)
    group.store([0xFFFF], 5)
    point.evaluate(5)
    group.fail(code, 6)
    assert point.evaluate(6)[1] == Quality.WAITING_FOR_INITIAL_DATA


def test_an_age_is_never_judged_tighter_than_the_wall_allows() -> None:
    (unit,) = compile_units(SOURCE, [channel("c", register=0, max_age_s=5)], [], 120.0)
    assert unit.points[0].age_limit_us == 180e6


def spans(groups: list[Group]) -> list[tuple[str, int, int]]:
    return [(group.kind, group.start, group.count) for group in groups]


def test_reads_are_grouped_by_unit_and_kind_over_small_gaps() -> None:
    units = compile_units(
        SOURCE,
        [
            channel("a", register=0, kind="input"),
            channel("b", register=9, kind="input", type="float32"),
            channel("c", register=30, kind="input"),
            channel("d", register=1, kind="holding"),
            channel("e", register=3, kind="coil"),
            channel("f", register=0, kind="input", unit_id=2),
        ],
        [],
        1.0,
    )
    assert {u.unit: spans(u.groups) for u in units} == {
        1: [("input", 0, 11), ("input", 30, 1), ("holding", 1, 1), ("coil", 3, 1)],
        2: [("input", 0, 1)],
    }


@given(
    st.lists(
        st.tuples(st.integers(0, 600), st.sampled_from(["int16", "int32", "float64"])),
        min_size=1,
        max_size=60,
    )
)
def test_groups_cover_every_channel_within_the_limit(layout: list[tuple[int, str]]) -> None:
    unit = compiled(*(channel(f"c{i}", register=r, type=t) for i, (r, t) in enumerate(layout)))
    width = {"int16": 1, "int32": 2, "float64": 4}
    assert all(group.count <= 125 for group in unit.groups)
    for register, value_type in layout:
        assert any(
            g.start <= register and register + width[value_type] <= g.start + g.count
            for g in unit.groups
        )
    assert sum(len(group.cells) for group in unit.groups) == len(set(layout))


def test_two_channels_may_share_a_register() -> None:
    unit = compiled(
        channel("raw", register=5, type="uint16"), channel("c", register=5, type="uint16", scale=2)
    )
    unit.groups[0].store([7], 1)
    assert [point.evaluate(1)[0] for point in unit.points] == [7.0, 14.0]


def test_a_group_splits_down_to_single_cells() -> None:
    unit = compiled(*(channel(f"c{i}", register=i) for i in (0, 1, 2)))
    low, high = unit.groups[0].halves() or (None, None)
    assert low is not None
    assert high is not None
    assert (spans([low]), spans([high])) == ([("holding", 0, 1)], [("holding", 1, 2)])
    assert low.halves() is None
    # also when a wide and a narrow value begin at the same register
    both = compiled(channel("n", register=0), channel("w", register=0, type="int32"))
    narrow, wide = both.groups[0].halves() or (None, None)
    assert narrow is not None
    assert wide is not None
    assert (narrow.count, wide.count) == (1, 2)


def test_wrong_bindings_are_refused_before_the_start() -> None:
    with pytest.raises(ConfigurationError, match=r"bench/c is bound twice"):
        check(SOURCE, [channel("c", register=0), channel("c", register=1)], [])
    with pytest.raises(ConfigurationError, match=r"bench/c: register 65535.*past the last"):
        check(SOURCE, [channel("c", register=65535, type="int32")], [])
    plan = ModbusPlan.model_validate({"source": "plc", "register": 65500, "rows": 10})
    with pytest.raises(ConfigurationError, match=r"plan of bench: register 65500"):
        check(SOURCE, [], [PlanBinding("bench", plan)])


def plan_registers(rows: list[tuple[int, float, float]], word_order: str = "big") -> list[int]:
    registers: list[int] = []
    for row in rows:
        words = struct.unpack(">6H", struct.pack(">Iff", *row))
        for i in (0, 2, 4):
            pair = words[i : i + 2]
            registers += pair if word_order == "big" else pair[::-1]
    return registers


@pytest.mark.parametrize("word_order", ["big", "little"])
def test_a_plan_is_read_without_its_unused_rows(word_order: Any) -> None:
    rows = [(1800, 2400.0, 2650.0), (0, 0.0, 0.0), (70000, 6200.5, 5500.25)]
    assert decode_plan(plan_registers(rows, word_order), word_order) == (
        PlanStep(1800.0, 2400.0, 2650.0),
        PlanStep(70000.0, 6200.5, 5500.25),
    )
    assert decode_plan([0] * 12, word_order) == ()


@pytest.mark.parametrize(
    "row",
    [(600, math.nan, 1.0), (600, 1.0, -5.0), (600, math.inf, 1.0), (0xFFFFFFFF, 1.0, 1.0)],
)
def test_an_implausible_row_spoils_the_plan(row: tuple[int, float, float]) -> None:
    with pytest.raises(ImplausiblePlanError, match="row 1"):
        decode_plan(plan_registers([(10, 1.0, 1.0), row]), "big")


def test_points_know_their_name() -> None:
    point: PolledChannel = compiled(channel("t_inner_ring_c", register=0)).points[0]
    assert point.label == "bench/t_inner_ring_c"
