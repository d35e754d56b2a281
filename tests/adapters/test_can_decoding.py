import math
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from cantools.database.can import Message
from patience import patience

from adapters.configuration import ConfigurationError
from adapters.drivers.can.binding import bind, check
from adapters.drivers.can.config import CanChannel
from adapters.drivers.can.scan import described_signals
from adapters.protocol import PlanBinding
from adapters.samples import Quality, Sample
from tests.adapters.can_frames import (
    LOAD,
    SPEED,
    channel,
    decode_one,
    described,
    message,
    source,
)


def test_standard_and_extended_frames_are_told_apart() -> None:
    table = bind(source(), [channel("speed_rpm", **SPEED), channel("load_n", **LOAD)])
    speed, load = table.values()
    assert table.find(0x100, False) is speed
    assert table.find(0x18FEF100, True) is load
    assert table.find(0x100, True) is None
    assert table.find(0x101, False) is None


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


NO_LENGTH = "The signal T length 0 is not greater than 0 in message X."
RIGHT = 'BO_ 518 Right: 8 A\n SG_ T : 0|8@1+ (1,0) [0|0] "" A\nVAL_ 518 T 255 "error" ;\n'
X = 'BO_ 4096 X: 8 A\n SG_ T : 0|8@1+ (1,0) [0|0] "" A\nVAL_ 4096 T 1 "a; \\"b\\"" ;\n'


@pytest.mark.parametrize(
    ("others", "flaw"),
    [
        (X, "Standard frame id 0x1000 is more than 11 bits in message X."),
        (
            'BO_ 513 X: 8 A\n SG_ T : 0|0@1+ (1,0) [0|0] "" A\n',
            NO_LENGTH,
        ),
        (
            'BO_ 513 X: 8 A\n SG_ T m1 : 8|0@1+ (1,0) [0|0] "" A\n',
            NO_LENGTH,
        ),
        (
            f'BO_ {0x18FF2080 | 1 << 31} X: 8 A\n SG_ T : 0|0@1+ (1,0) [0|0] "" A\n'
            f'VAL_ {0x18FF2080 | 1 << 31} T 1 "a" ;\nSIG_VALTYPE_ {0x18FF2080 | 1 << 31} T : 1;\n',
            NO_LENGTH,
        ),
        ('VAL_ 518 Gone 0 "a;" 1 "b"\n 2 "c" ;\nVAL_ 999 Gone 0 "a" ;\n', ""),
        ("SIG_VALTYPE_ 518 Gone : 1;\n", ""),
        ('BA_ "Nowhere" BO_ 518 "VAL_ 518 T 1;";\n', ""),
    ],
)
def test_a_flaw_of_what_no_channel_reads_refuses_nothing(
    tmp_path: Path, others: str, flaw: str
) -> None:
    file = source(dbc=described(tmp_path, RIGHT + others))
    (bound,) = bind(file, [channel("c", message="Right", signal="T")]).values()
    assert bound.decode(bytes([61] * 8), 1)[0].value == 61.0
    # What the file says of it otherwise is still there.
    assert bound.decode(bytes([255, *[0] * 7]), 2)[0].quality == Quality.SENSOR_FAILURE
    with pytest.raises(ConfigurationError, match=f"message 'X' .*{flaw}"):
        bind(file, [channel("c", message="X", signal="T")])


def test_what_is_left_out_for_a_flaw_changes_nothing_else(tmp_path: Path) -> None:
    """Receivers on a line of their own, numbers with zeros before them: the types still count."""
    text = (
        'BO_ 518 M: 8 A\n SG_ S : 0|32@1+ (1,0) [0|0] ""\n  A,\n  B\n'
        ' SG_ T : 32|32@1+ (1,0) [0|0] "" A\nSIG_VALTYPE_ 0518 T : 1;\nVAL_ 518 Gone 0 "a" ;\n'
    )
    file = source(dbc=described(tmp_path, text))
    (bound,) = bind(file, [channel("c", message="M", signal="T")]).values()
    assert bound.decode(struct.pack("<If", 7, 61.5), 1)[0].value == 61.5


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
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=patience(60),
        check=True,
    )
    assert told.stdout == "False\n"
