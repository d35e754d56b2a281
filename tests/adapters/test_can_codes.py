"""A code such as 'error' or 'not available' is no measurement."""

import math
import struct
from pathlib import Path
from typing import Any

import pytest

from adapters.configuration import ConfigurationError
from adapters.drivers.can.binding import bind
from adapters.samples import Quality, Sample
from tests.adapters.can_frames import (
    J1939,
    A,
    channel,
    decode_one,
    described,
    source,
)


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


def code_of(folder: Path, signal: str, table: str, raw: bytes, **keys: Any) -> Sample:
    dbc = described(folder, f'BO_ 512 M: 8 A\n SG_ T : {signal} [0|0] "" A\n{table}')
    (bound,) = bind(source(dbc=dbc), [channel("c", message="M", signal="T", **keys)]).values()
    (sample,) = bound.decode(raw.ljust(8, b"\0"), 1)
    assert (bound.signals[0].problem == "") == (sample.quality == Quality.GOOD)
    return sample


WIDE = "0|16@1+ (1,0)"


SIGNED = "0|16@1- (0.01,0)"


@pytest.mark.parametrize(
    ("signal", "table", "raw"),
    [
        ("0|8@1+ (1,-40)", '254 "Error" 255 "SNA"', b"\xfe"),
        (WIDE, '65534 "Fault" 65535 "SNA"', b"\xfe\xff"),
        (WIDE, '0 "SensorNotAvailable"', b"\0\0"),
        (WIDE, '4000 "n/a"', struct.pack("<H", 4000)),
        (WIDE, '4001 "SIG_INVALID"', struct.pack("<H", 4001)),
        (WIDE, '0 "Standstill" 1 "Creeping" 65534 "Error"', b"\xfe\xff"),
        (WIDE, '250 "Max" 251 "reserved" 252 "short_circuit"', b"\xfc\0"),
        (SIGNED, '32766 "Error" 32767 "SNA"', struct.pack("<h", 32766)),
        (SIGNED, '-32768 "SNA"', struct.pack("<h", -32768)),
        (SIGNED, '65000 "undefined"', struct.pack("<H", 65000)),  # written as if unsigned
        (SIGNED, "", struct.pack("<h", 32767)),
        (SIGNED, "", struct.pack("<h", -32768)),
        (SIGNED, "", b"\xff" * 8),
        ("0|12@1+ (0.1,-40)", '4094 "ERR" 4095 "SNA"', struct.pack("<H", 4094)),
    ],
)
def test_a_code_is_no_measurement(tmp_path: Path, signal: str, table: str, raw: bytes) -> None:
    values = f"VAL_ 512 T {table} ;\n" if table else ""
    sample = code_of(tmp_path, signal, values, raw)
    assert math.isnan(sample.value)
    assert sample.quality == Quality.SENSOR_FAILURE


@pytest.mark.parametrize(
    ("signal", "table", "raw", "value"),
    [
        (WIDE, '0 "off" 1 "running" 2 "Fault" 65535 "SNA"', b"\2\0", 2.0),  # a state
        ("0|2@1+ (1,0)", '0 "ok" 1 "Error"', b"\1", 1.0),
        (WIDE, '65535 "Full scale"', b"\xff\xff", 65535.0),  # the file says what it is
        (WIDE, '0 "Standstill" 65535 "SNA"', b"\0\0", 0.0),
        (SIGNED, "", struct.pack("<h", -1), -0.01),
        (SIGNED, '-1 "just below zero"', b"\xff" * 8, -0.01),
        (WIDE, '3 "Information"', b"\3\0", 3.0),
        ("0|8@1+ (1,0)", '0 "No_Error" 1 "Error"', b"\0", 0.0),
        (WIDE, '0 "fault free" 65534 "fault"', b"\0\0", 0.0),
    ],
)
def test_a_label_is_not_always_a_code(
    tmp_path: Path, signal: str, table: str, raw: bytes, value: float
) -> None:
    values = f"VAL_ 512 T {table} ;\n" if table else ""
    sample = code_of(tmp_path, signal, values, raw)
    assert (sample.value, sample.quality) == (pytest.approx(value), Quality.GOOD)


def test_sentinels_are_raw_values(tmp_path: Path) -> None:
    raw = struct.pack("<h", -999)
    assert code_of(tmp_path, SIGNED, "", raw).value == pytest.approx(-9.99)
    sample = code_of(tmp_path, SIGNED, "", raw, sentinels=[-999])
    assert sample.quality == Quality.SENSOR_FAILURE
    for sentinels in ([40_000], [-9.99]):
        with pytest.raises(ConfigurationError, match="whole numbers from -32768 to 32767"):
            code_of(tmp_path, SIGNED, "", raw, sentinels=sentinels)


@pytest.mark.parametrize(
    ("signal", "raw", "quality"),
    [
        ("0|16@1+ (1,0)", 0xFAFF, Quality.GOOD),
        ("0|16@1+ (1,0)", 0xFB00, Quality.SENSOR_FAILURE),
        ("0|24@1+ (1,0)", 0xFAFFFF, Quality.GOOD),
        ("0|24@1+ (1,0)", 0xFE0000, Quality.SENSOR_FAILURE),
        ("0|2@1+ (1,0)", 1, Quality.GOOD),
        ("0|2@1+ (1,0)", 2, Quality.SENSOR_FAILURE),
        ("0|16@1- (1,0)", 0x7FFC, Quality.GOOD),
        ("0|16@1- (1,0)", 0x7FFD, Quality.SENSOR_FAILURE),
        ("0|16@1- (1,0)", 0x8000, Quality.SENSOR_FAILURE),
        ("0|16@1- (1,0)", 0xFFFF, Quality.SENSOR_FAILURE),
    ],
)
def test_j1939_reserves_by_length(tmp_path: Path, signal: str, raw: int, quality: Quality) -> None:
    head = f'BO_ {A | 1 << 31} M: 8 A\n SG_ T : {signal} [0|0] "" A\n'
    dbc = described(tmp_path, f'{head}{J1939}BA_ "VFrameFormat" BO_ {A | 1 << 31} 3;\n')
    (bound,) = bind(source(dbc=dbc), [channel("c", message="M", signal="T")]).values()
    (sample,) = bound.decode(raw.to_bytes(8, "little"), 1)
    assert sample.quality == quality
