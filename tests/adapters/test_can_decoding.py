import math
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from adapters.configuration import ConfigurationError
from adapters.drivers.can.config import CanChannel, CanSource
from adapters.drivers.can.decoding import BoundMessage, bind, check
from adapters.protocol import ChannelBinding, PlanBinding
from adapters.samples import Quality, Sample

DBC = Path(__file__).parent / "bench.dbc"
SPEED = {"message": "DriveStatus", "signal": "Speed"}
LOAD = {"message": "LoadCell", "signal": "RadialLoad"}


def source(**keys: Any) -> CanSource:
    return CanSource.model_validate(
        {"name": "drive", "channel": "socket://127.0.0.1:1", "dbc": DBC, **keys}
    )


def channel(name: str, **keys: Any) -> ChannelBinding:
    return ChannelBinding("bench", name, CanChannel.model_validate({"source": "drive", **keys}))


def message(*channels: ChannelBinding) -> BoundMessage:
    (bound,) = bind(source(), channels).values()
    return bound


def decode_one(payload: bytes, **keys: Any) -> Sample:
    (sample,) = message(channel("c", **keys)).decode(payload, 1_000)
    return sample


def test_standard_and_extended_frames_are_told_apart() -> None:
    table = bind(source(), [channel("speed_rpm", **SPEED), channel("load_n", **LOAD)])
    speed, load = table.values()
    assert table.find(0x100, False) is speed
    assert table.find(0x18FEF100, True) is load
    assert table.find(0x100, True) is None
    assert table.find(0x101, False) is None


OIL = {"message": "EngineTemperature", "signal": "Oil"}


def test_a_j1939_message_is_known_by_its_group_whoever_sends_it_however_urgently() -> None:
    (oil,) = (table := bind(source(), [channel("t_node_1_c", **OIL)])).values()
    frame_id = oil.message.frame_id
    assert table.find(frame_id, True) is oil
    assert table.find(frame_id | 0x2A, True) is oil  # another sender
    assert table.find(frame_id & 0x03FFFFFF | 0x0C000000, True) is oil  # another priority
    assert table.find(frame_id ^ 0x100, True) is None  # another group
    assert table.find(frame_id & 0x7FF, False) is None


def test_a_mask_says_which_bits_of_the_identifier_count() -> None:
    masked = channel("speed_rpm", **SPEED, frame_id_mask=0x7F0)
    table = bind(source(), [masked])
    (speed,) = table.values()
    for _ in range(2):
        assert table.find(0x10F, False) is speed
        assert table.find(0x110, False) is None
    with pytest.raises(ConfigurationError, match="frame_id_mask"):
        bind(source(), [masked, channel("phase", message="DriveStatus", signal="State")])
    with pytest.raises(ValueError, match="frame_id_mask"):
        channel("speed_rpm", **SPEED, frame_id_mask=0)


def test_intel_and_motorola_signals_are_scaled() -> None:
    speed = decode_one(struct.pack("<Hhi", 33600, -12, 0), **SPEED)
    assert (speed.value, speed.quality) == (4200.0, Quality.GOOD)
    load = decode_one(struct.pack(">H", 26500) + bytes(6), **LOAD)
    assert (load.value, load.quality) == (pytest.approx(2650.0), Quality.GOOD)


def test_several_channels_of_a_frame_carry_its_time() -> None:
    both = message(
        channel("speed_rpm", **SPEED),
        channel("phase", message="DriveStatus", signal="State"),
    )
    samples = both.decode(struct.pack("<HhI", 8000, 0, 2), 77)
    assert samples == [
        Sample("bench", "speed_rpm", 77, 1000.0, 192, 77),
        Sample("bench", "phase", 77, 2.0, 192, 77),
    ]
    assert both.last_good_us == 77


@pytest.mark.parametrize(
    ("payload", "keys", "error"),
    [
        (b"\xff" * 8, SPEED, "not_available"),
        (b"\xff\xfe" + bytes(6), SPEED, "outside_dbc_limits"),
        (b"\xff" * 2 + bytes(6), LOAD, "not_available"),
        (struct.pack(">H", 60001) + bytes(6), LOAD, "outside_dbc_limits"),
        (
            bytes(4) + struct.pack("<f", 1000.5),
            {"message": "LoadCell", "signal": "Strain"},
            "outside_dbc_limits",
        ),
        (
            bytes(4) + struct.pack("<f", math.nan),
            {"message": "LoadCell", "signal": "Strain"},
            "not_a_number",
        ),
    ],
)
def test_what_the_dbc_does_not_allow_is_a_sensor_failure(
    payload: bytes, keys: dict[str, Any], error: str
) -> None:
    bound = message(channel("c", **keys))
    (sample,) = bound.decode(payload, 1)
    assert math.isnan(sample.value)
    assert sample.quality == Quality.SENSOR_FAILURE
    assert bound.errors == [error]
    assert bound.last_good_us == 0


def test_the_limits_themselves_are_good() -> None:
    assert decode_one(struct.pack("<H", 64255) + bytes(6), **SPEED).value == 8031.875
    # 0.1 * 60000 is a little more than 6000 in floating point
    assert decode_one(struct.pack(">H", 60000) + bytes(6), **LOAD).quality == Quality.GOOD
    at_limit = bytes(4) + struct.pack("<f", 1000.0)
    assert decode_one(at_limit, message="LoadCell", signal="Strain").quality == Quality.GOOD


def test_all_ones_is_an_ordinary_value_where_it_is_minus_one_or_a_flag() -> None:
    torque = decode_one(b"\x00\x00\xff\xff" + bytes(4), message="DriveStatus", signal="Torque")
    assert (torque.value, torque.quality) == (pytest.approx(-0.1), Quality.GOOD)
    state = decode_one(bytes(4) + b"\x03" + bytes(3), message="DriveStatus", signal="State")
    assert (state.value, state.quality) == (3.0, Quality.GOOD)


@pytest.mark.parametrize(
    ("byte", "quality"),
    [(0xFA, Quality.GOOD), (0xFB, Quality.SENSOR_FAILURE), (0xFE, Quality.SENSOR_FAILURE)],
)
def test_j1939_reserves_the_codes_above_fa(byte: int, quality: Quality) -> None:
    oil = {"message": "EngineTemperature", "signal": "Oil"}
    assert decode_one(bytes([byte]) + bytes(7), **oil).quality == quality
    fault = {"message": "EngineTemperature", "signal": "Fault"}
    assert decode_one(bytes([0, 3]) + bytes(6), **fault).quality == Quality.SENSOR_FAILURE


def test_outside_the_channels_valid_range_the_value_is_kept_but_uncertain() -> None:
    sample = decode_one(struct.pack("<H", 48000) + bytes(6), **SPEED, valid_range=[0, 5000])
    assert (sample.value, sample.quality) == (6000.0, Quality.EU_EXCEEDED)


@pytest.mark.parametrize("length", [0, 7, 12])
def test_a_frame_of_the_wrong_length_is_no_value(length: int) -> None:
    bound = message(channel("speed_rpm", **SPEED))
    (sample,) = bound.decode(b"\x10" * length, 5)
    assert math.isnan(sample.value)
    assert sample.quality == Quality.COMM_FAILURE
    assert bound.errors == ["wrong_length"]


def test_only_the_signals_of_the_present_page_are_there() -> None:
    pages = message(
        channel("ambient_c", message="Pages", signal="Cold"),
        channel("t_node_1_c", message="Pages", signal="Warm"),
    )
    frame = struct.pack("<Bh", 0, 415) + bytes(5)
    assert [(s.channel, s.value) for s in pages.decode(frame, 1)] == [("t_node_1_c", 41.5)]
    frame = struct.pack("<Bh", 1, -55) + bytes(5)
    assert [(s.channel, s.value) for s in pages.decode(frame, 2)] == [("ambient_c", -5.5)]
    assert pages.decode(struct.pack("<B", 9) + bytes(7), 3)[0].quality == Quality.COMM_FAILURE


def test_frames_of_one_moment_get_times_that_differ() -> None:
    bound = message(channel("speed_rpm", **SPEED))
    times = [bound.decode(bytes(8), 10_000_000)[0].time_us for _ in range(3)]
    assert times == [10_000_000, 10_000_001, 10_000_002]
    # a clock that was set back by far is followed
    assert bound.decode(bytes(8), 5_000_000)[0].time_us == 5_000_000


def test_a_message_is_stale_after_three_periods_or_its_age_limit() -> None:
    announced = message(channel("speed_rpm", **SPEED))
    assert announced.age_limit_us(1.0) == 1.5e6  # never tighter than 1.5 s of wall time
    assert announced.age_limit_us(120.0) == 180e6
    seen = message(channel("load_n", **LOAD))
    for tick in range(50):
        seen.decode(bytes(8), 1 + tick * 2_000_000)
    assert seen.age_limit_us(1.0) == pytest.approx(6e6)
    seen.decode(bytes(8), 10_000_000_000)  # an outage says nothing about the period
    assert seen.age_limit_us(1.0) == pytest.approx(6e6)
    limited = message(channel("load_n", **LOAD, max_age_s=30))
    assert limited.age_limit_us(1.0) == 30e6


@pytest.mark.parametrize(
    ("keys", "channel_keys", "text"),
    [
        ({"dbc": "/nowhere/bench.dbc"}, SPEED, "dbc '/nowhere/bench.dbc' cannot be read: No such"),
        ({"dbc": __file__}, SPEED, "is not a valid DBC file"),
        ({"interface": "slcam"}, SPEED, "interface 'slcam' is unknown.*'slcan'"),
        (
            {},
            {"message": "DriveState", "signal": "Speed"},
            "channel bench/c: message 'DriveState' is not in .*bench.dbc'; .*'DriveStatus'",
        ),
        (
            {},
            {"message": "DriveStatus", "signal": "Sped"},
            "channel bench/c: signal 'Sped' is not in message 'DriveStatus'; .*'Speed'",
        ),
        (
            {},
            {"message": "DriveStatus", "signal": "xyz"},
            "signal 'xyz' .* expected one of Speed, State, Torque",
        ),
    ],
)
def test_a_wrong_configuration_names_key_value_and_what_there_is(
    keys: dict[str, Any], channel_keys: dict[str, Any], text: str
) -> None:
    with pytest.raises(ConfigurationError, match=text) as caught:
        check(source(**keys), [channel("c", **channel_keys)], [])
    assert "\n" not in str(caught.value)


def test_a_channel_is_bound_once_and_a_plan_not_at_all() -> None:
    with pytest.raises(ConfigurationError, match="bench/c is bound twice"):
        check(source(), [channel("c", **SPEED), channel("c", **LOAD)], [])
    with pytest.raises(ConfigurationError, match="a plan needs a Modbus source"):
        check(source(), [], [PlanBinding("bench", CanChannel(source="drive", **SPEED))])


@pytest.mark.wires
def test_the_library_does_not_load_what_no_driver_needs() -> None:
    """python-can would load asammdf, and that pandas: 60 MiB in every process of a service."""
    program = "import sys, adapters.drivers.can.driver; print('pandas' in sys.modules)"
    told = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True
    )
    assert told.stdout == "False\n"
