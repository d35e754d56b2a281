import math
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from cantools.database.can import Message

from adapters.configuration import ConfigurationError
from adapters.drivers.can.binding import MessageTable, bind, check
from adapters.drivers.can.config import CanChannel, CanSource
from adapters.drivers.can.decoding import BoundMessage
from adapters.drivers.can.scan import described_signals
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


@pytest.mark.parametrize("length", [2, 7, 12, 64])
def test_a_frame_of_another_length_gives_the_signals_that_lie_whole_in_it(length: int) -> None:
    """A sender may leave bytes out, and CAN FD pads; `Torque` ends with the fourth byte."""
    bound = message(
        channel("speed_rpm", **SPEED), channel("torque", message="DriveStatus", signal="Torque")
    )
    frame = (struct.pack("<HhI", 8000, -12, 0) + bytes([0x55]) * 56)[:length]
    speed, torque = bound.decode(frame, 5)
    assert (speed.value, speed.quality) == (1000.0, Quality.GOOD)
    if length < 4:
        assert math.isnan(torque.value)
        assert torque.quality == Quality.COMM_FAILURE
        assert bound.errors == ["wrong_length"]
        assert [one.problem for one in bound.signals] == ["", "not in a frame of 2 bytes"]
    else:
        assert (torque.value, bound.errors) == (pytest.approx(-1.2), [])


@pytest.mark.parametrize(("length", "whole"), [(0, 0), (1, 0), (2, 1), (5, 1), (6, 2)])
def test_motorola_signals_of_a_short_frame(tmp_path: Path, length: int, whole: int) -> None:
    dbc = described(
        tmp_path,
        "BO_ 512 M: 8 A\n"
        ' SG_ First : 7|16@0+ (1,0) [0|0] "" A\n'
        ' SG_ Later : 39|16@0+ (1,0) [0|0] "" A\n',
    )
    channels = [channel(name, message="M", signal=name) for name in ("First", "Later")]
    (bound,) = bind(source(dbc=dbc), channels).values()
    samples = bound.decode(bytes([1, 2, 3, 4, 5, 6, 7, 8])[:length], 1)
    values = [one.value for one in samples if one.quality == Quality.GOOD]
    assert values == [0x0102, 0x0506][:whole]
    assert len(samples) == 2


def test_only_the_signals_of_the_present_page_are_there() -> None:
    pages = message(
        channel("ambient_c", message="Pages", signal="Cold"),
        channel("t_node_1_c", message="Pages", signal="Warm"),
    )
    frame = struct.pack("<Bh", 0, 415) + bytes(5)
    assert [(s.channel, s.value) for s in pages.decode(frame, 1)] == [("t_node_1_c", 41.5)]
    frame = struct.pack("<Bh", 1, -55) + bytes(5)
    assert [(s.channel, s.value) for s in pages.decode(frame, 2)] == [("ambient_c", -5.5)]
    assert pages.decode(struct.pack("<B", 9) + bytes(7), 3) == []  # a page of another version
    assert [one.quality for one in pages.decode(b"", 4)] == [Quality.COMM_FAILURE] * 2


def test_a_page_that_is_not_in_the_file_says_nothing_of_the_signals_outside(tmp_path: Path) -> None:
    dbc = described(
        tmp_path,
        "BO_ 512 M: 8 A\n"
        ' SG_ Page M : 0|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ Inner m1M : 8|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ Always : 48|16@1+ (0.1,0) [0|0] "" A\n'
        ' SG_ Outer m1 : 16|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ Deep m3 : 24|8@1+ (1,0) [0|0] "" A\n'
        "SG_MUL_VAL_ 512 Inner Page 1-1;\n"
        "SG_MUL_VAL_ 512 Outer Page 1-1, 4-5;\n"
        "SG_MUL_VAL_ 512 Deep Inner 3-3;\n",
    )
    names = ("Always", "Outer", "Deep")
    channels = [channel(name, message="M", signal=name) for name in names]
    (bound,) = bind(source(dbc=dbc), channels).values()

    def seen(page: int, inner: int) -> list[tuple[str, float]]:
        frame = struct.pack("<BBBBHH", page, inner, 20, 30, 0, 415)
        return [(one.channel, one.value) for one in bound.decode(frame, 1)]

    assert seen(1, 3) == [("Always", 41.5), ("Outer", 20.0), ("Deep", 30.0)]
    assert seen(1, 9) == [("Always", 41.5), ("Outer", 20.0)]
    assert seen(4, 3) == [("Always", 41.5), ("Outer", 20.0)]
    assert seen(9, 3) == [("Always", 41.5)]


HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: A B\n'
J1939 = (
    'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'
)


def described(folder: Path, text: str) -> Path:
    dbc = folder / "file.dbc"
    dbc.write_text(HEAD + text)
    return dbc


def group(folder: Path, **identifiers: int) -> Path:
    """A file with these messages of a J1939 group, each with a signal `T` of 16 bits."""
    messages = "".join(
        f'BO_ {number | 1 << 31} {name}: 8 A\n SG_ T : 0|16@1+ (0.1,-40) [0|0] "degC" A\n'
        for name, number in identifiers.items()
    )
    ends = "".join(f'BA_ "VFrameFormat" BO_ {n | 1 << 31} 3;\n' for n in identifiers.values())
    return described(folder, messages + J1939 + ends)


def temperature(value_c: float) -> bytes:
    return struct.pack("<H", round((value_c + 40) * 10)) + b"\xff" * 6


A, B, ANY = 0x18FF2080, 0x18FF2081, 0x18FF20FE
S = 1_000_000


def hear(table: MessageTable, *frames: tuple[int, float, int]) -> list[tuple[str, float, int]]:
    """What comes of frames (identifier, temperature, time in microseconds)."""
    found = []
    for frame_id, value_c, time_us in frames:
        bound = table.find(frame_id, True)
        samples = [] if bound is None else bound.receive(frame_id, temperature(value_c), time_us)
        found += [(one.channel, round(one.value, 3), one.quality) for one in samples]
    return found


def test_the_sender_counts_where_the_file_has_two_messages_of_a_group(tmp_path: Path) -> None:
    file = source(dbc=group(tmp_path, First=A, Second=B))
    inner, outer = (channel(name, message=name, signal="T") for name in ("First", "Second"))
    frames = [(A, 62.0, S), (B, 58.0, S), (0x0CFF2081, 58.5, 2 * S), (0x18FF2082, 99.0, S)]
    wanted = [("First", 62.0, 192), ("Second", 58.0, 192), ("Second", 58.5, 192)]
    assert hear(bind(file, [inner, outer]), *frames) == wanted
    assert hear(bind(file, [inner]), *frames) == wanted[:1]
    assert hear(bind(file, [outer]), *frames) == wanted[1:]


def test_a_message_of_any_sender_does_not_take_the_frames_of_one_that_is_named(
    tmp_path: Path,
) -> None:
    file = source(dbc=group(tmp_path, Whoever=ANY, First=A))
    table = bind(file, [channel("c", message="Whoever", signal="T")])
    assert hear(table, (A, 62.0, S), (B, 58.0, S), (B, 58.5, 4 * S)) == [
        ("c", pytest.approx(math.nan, nan_ok=True), 32),
        ("c", 58.5, 192),
    ]


def test_messages_that_only_the_addressee_tells_apart(tmp_path: Path) -> None:
    to_one, to_other = 0x18EF1080, 0x18EF1180
    file = source(dbc=group(tmp_path, One=to_one, Other=to_other))
    channels = [channel(name, message=name, signal="T") for name in ("One", "Other")]
    table = bind(file, channels)
    assert hear(table, (to_one, 10.0, S), (to_other, 20.0, S)) == [
        ("One", 10.0, 192),
        ("Other", 20.0, 192),
    ]


def test_messages_of_any_sender_that_only_the_addressee_tells_apart(tmp_path: Path) -> None:
    file = source(dbc=group(tmp_path, One=0x18EF10FE, Other=0x18EF11FE))
    table = bind(file, [channel(name, message=name, signal="T") for name in ("One", "Other")])
    hear(table, (0x18EF1080, 10.0, S), (0x18EF1181, 20.0, S))
    assert hear(table, (0x18EF1080, 10.0, 4 * S), (0x18EF1181, 20.0, 4 * S)) == [
        ("One", 10.0, 192),
        ("Other", 20.0, 192),
    ]


def test_a_sender_that_the_file_does_not_name_is_taken_as_long_as_it_is_the_only_one(
    tmp_path: Path,
) -> None:
    file = source(dbc=group(tmp_path, First=A))
    table = bind(file, [channel("c", message="First", signal="T")])
    (bound,) = table.values()
    waits = ("c", pytest.approx(math.nan, nan_ok=True), Quality.WAITING_FOR_INITIAL_DATA)
    alone = hear(table, (B, 58.0, S), (B, 58.0, 2 * S), (B, 58.1, 3 * S), (B, 58.2, 4 * S))
    assert alone == [waits, waits, ("c", 58.1, 192), ("c", 58.2, 192)]
    assert bound.senders is not None
    assert bound.senders.note() == ""
    third = 0x18FF2082
    assert hear(table, (third, 70.0, 5 * S), (B, 58.3, 6 * S)) == [
        ("c", 70.0, Quality.UNCERTAIN),
        ("c", 58.3, Quality.UNCERTAIN),
    ]
    assert "several senders (0x81, 0x82)" in bound.signals[0].problem
    # The one of the file is heard: the others are strangers from now on, also when it falls silent.
    assert hear(table, (A, 62.0, 7 * S), (B, 58.4, 8 * S), (B, 58.4, 9999 * S)) == [
        ("c", 62.0, 192)
    ]
    assert bound.errors == ["other_sender"]
    assert "that of the DBC file (0x80) counts" in bound.senders.note()


def test_a_mask_that_was_asked_for_takes_all_and_names_them(tmp_path: Path) -> None:
    file = source(dbc=group(tmp_path, First=A, Second=B))
    asked = channel("c", message="First", signal="T", frame_id_mask=0x03FFFF00)
    table = bind(file, [asked])
    assert hear(table, (A, 62.0, S), (B, 58.0, S)) == [("c", 62.0, 192), ("c", 58.0, 192)]
    (bound,) = table.values()
    assert bound.senders is not None
    assert "several identifiers (0x80, 0x81)" in bound.senders.note()
    only = channel("c", message="First", signal="T", frame_id_mask=0x1FFFFFFF)
    assert hear(bind(file, [only]), (A, 62.0, S), (B, 58.0, S)) == [("c", 62.0, 192)]


TWICE = (
    'BO_ 512 Old: 8 A\n SG_ T : 0|8@1+ (1,-40) [0|0] "degC" A\n'
    'BO_ 512 New: 8 A\n SG_ T : 16|16@1+ (0.1,-40) [0|0] "degC" A\n'
    'BO_ 513 Same: 8 A\n SG_ T : 0|8@1+ (1,-40) [0|0] "degC" A\n'
    'BO_ 514 Same: 8 A\n SG_ T : 0|8@1+ (1,-40) [0|0] "degC" A\n'
    'BO_ 515 Over: 8 A\n SG_ T : 0|8@1+ (1,0) [0|0] "" A\n SG_ U : 4|8@1+ (1,0) [0|0] "" A\n'
    'BO_ 516 Long: 2 A\n SG_ T : 0|32@1+ (1,0) [0|0] "" A\n'
    'BO_ 517 Two: 8 A\n SG_ T : 0|8@1+ (1,0) [0|0] "" A\n SG_ T : 8|8@1+ (1,0) [0|0] "" A\n'
    'BO_ 518 Right: 8 A\n SG_ T : 0|8@1+ (1,0) [0|0] "" A\n'
)


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["Old", "New"], "channel bench/New: messages 'Old' and 'New' .* one identifier .0x200."),
        (["Same"], "message 'Same' of .*: the name is there 2 times .identifiers 0x201, 0x202."),
        (["Over"], "message 'Over' of .*: The signals U and T are overlapping"),
        (["Long"], "message 'Long' of .*: The signal T does not fit"),
        (["Two"], "message 'Two' of .*: it has several signals of one name .T."),
    ],
)
def test_a_message_that_cannot_be_read_for_certain_is_refused_by_name_where_it_is_asked_for(
    tmp_path: Path, names: list[str], text: str
) -> None:
    file = source(dbc=described(tmp_path, TWICE))
    bind(file, [channel("c", message="Right", signal="T")])
    with pytest.raises(ConfigurationError, match=text):
        bind(file, [channel(name, message=name, signal="T") for name in names])
    one = bind(file, [channel("c", message="New", signal="T")]).find(512, False)
    assert one is not None
    assert one.decode(struct.pack("<BBHHxx", 102, 98, 1020, 980), 1)[0].value == 62.0
    # Where the signals are chosen, the others are shown, and these with the reason.
    shown = {one.message: one.detail for one in described_signals(file)}
    assert shown["Right"] == "no frame came"
    assert all(shown[name] != "no frame came" for name in names)


def test_each_message_of_a_large_file_is_examined_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commissioning binds all signals of a file; by each one anew it took half a minute."""
    examined: list[str] = []
    refresh = Message.refresh

    def count(this: Message, strict: bool | None = None) -> None:
        if strict:
            examined.append(this.name)
        refresh(this, strict)

    monkeypatch.setattr(Message, "refresh", count)
    names = ("Speed", "Torque", "State")
    bind(source(), [channel(name, message="DriveStatus", signal=name) for name in names])
    assert examined == ["DriveStatus"]


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


def test_the_limits_that_make_a_value_bad_are_named() -> None:
    bound = message(channel("load_n", **LOAD))
    bound.decode(struct.pack(">H", 60001) + bytes(6), 1)
    (signal,) = bound.signals
    assert signal.problem == "6000.1 is outside of the DBC file's limits [0, 6000]"
    ranged = message(channel("load_n", **LOAD, valid_range=[0, 10]))
    ranged.decode(struct.pack(">H", 200) + bytes(6), 1)
    assert ranged.signals[0].problem == "20 is outside of valid_range [0, 10]"
    ranged.decode(struct.pack(">H", 20) + bytes(6), 2)
    assert ranged.signals[0].problem == ""


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
