"""Who sends a message counts where its identifier is not wholly given."""

import math
from pathlib import Path

import pytest

from adapters.configuration import ConfigurationError
from adapters.drivers.can.binding import MessageTable, bind
from adapters.samples import Quality
from tests.adapters.can_frames import (
    ANY,
    SPEED,
    A,
    B,
    channel,
    group,
    source,
    temperature,
)

OIL = {"message": "EngineTemperature", "signal": "Oil"}


def test_a_j1939_message_is_known_by_its_group_not_by_its_sender_or_priority() -> None:
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
