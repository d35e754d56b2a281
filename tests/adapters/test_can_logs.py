"""Recorded CAN logs that were cut, damaged or written by another tool."""

import gzip
import struct
import zlib
from pathlib import Path

import can
import pytest
from can.io.blf import (
    FILE_HEADER_SIZE,
    LOG_CONTAINER,
    LOG_CONTAINER_STRUCT,
    OBJ_HEADER_BASE_STRUCT,
    ZLIB_DEFLATE,
)

from adapters.configuration import ConfigurationError
from adapters.drivers.replay.can_logs import open_log

BEGIN_S = 1_800_000_000.0
Frame = tuple[float, bytes]


def read(path: Path) -> tuple[list[Frame], str]:
    """The frames of a log, and what is said at its end."""
    frames: list[Frame] = []
    try:
        with open_log(path, needs_dates=True) as log:
            for one in log:
                frames.append((one.timestamp, bytes(one.data)))
    except ConfigurationError as error:
        return frames, str(error)
    return frames, ""


ASC = """\
date Fri Mar 20 08:00:00.000 2026
base hex  timestamps absolute
   1.000000 1  100             Rx   d 2 12 34
   2.000000 1  100             Rx   d 2 56 78
"""


def asc(tmp_path: Path, content: str | bytes) -> Path:
    path = tmp_path / "run.asc"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_the_line_behind_the_header_of_an_asc_log_is_a_frame(tmp_path: Path) -> None:
    frames, said = read(asc(tmp_path, ASC))
    assert ([data for _, data in frames], said) == ([b"\x12\x34", b"\x56\x78"], "")
    with_events = ASC.replace("absolute\n", "absolute\ninternal events logged\n// Vector\n")
    assert read(asc(tmp_path, with_events)) == (frames, "")
    assert read(asc(tmp_path, ASC.encode("utf-16"))) == (frames, "")


@pytest.mark.parametrize(
    "between", ["", "; written by hand", "version 8", "internal events logged"]
)
def test_no_line_of_a_header_hides_the_base(tmp_path: Path, between: str) -> None:
    content = ASC.replace("base hex", f"{between}\nbase dec").replace("hex", "dec")
    frames, _ = read(asc(tmp_path, content))
    assert [data for _, data in frames] == [bytes((12, 34)), bytes((56, 78))]
    relative = ASC.replace(
        "base hex  timestamps absolute", f"{between}\nbase hex timestamps relative"
    )
    assert "times count from frame to frame" in read(asc(tmp_path, relative))[1]
    odd = asc(tmp_path, ASC.replace("base hex", "base oct"))
    assert "'base oct timestamps absolute': expected base hex or dec" in read(odd)[1]


def test_a_last_line_without_its_end_is_whole_with_all_its_bytes(tmp_path: Path) -> None:
    frames, said = read(asc(tmp_path, ASC[:-1]))
    assert (len(frames), said) == (2, "")
    more = ASC[:-1] + "  Length = 1 BitCount = 64"
    assert read(asc(tmp_path, more)) == (frames, "")
    decimal = ASC[:-1].replace("base hex", "base dec")
    assert "is cut behind 1 frames" in read(asc(tmp_path, decimal))[1], "78 may have been 178"


def test_an_asc_log_that_is_cut_anywhere_gives_no_frame_that_was_not_recorded(
    tmp_path: Path,
) -> None:
    whole, _ = read(asc(tmp_path, ASC))
    begin = ASC.index("   1.000000")
    for end in range(begin, len(ASC)):
        frames, said = read(asc(tmp_path, ASC[:end]))
        assert frames == whole[: len(frames)], ASC[:end]
        is_whole = ASC[:end].endswith((" 12 34", " 56 78"))
        if ASC[:end].rpartition("\n")[2].strip() and not is_whole:
            assert f"is cut behind {len(frames)} frames" in said, ASC[:end]


def blf(tmp_path: Path, count: int) -> Path:
    path = tmp_path / "run.blf"
    with can.BLFWriter(path, max_container_size=400) as log:
        for k in range(count):
            log.on_message_received(
                can.Message(timestamp=BEGIN_S + k, arbitration_id=0x100, data=bytes([k, 1, 2]))
            )
    return path


def test_a_blf_log_that_is_cut_anywhere_says_so(tmp_path: Path) -> None:
    path = blf(tmp_path, 40)
    whole, said = read(path)
    assert (len(whole), said) == (40, "")
    content = path.read_bytes()
    for end in range(FILE_HEADER_SIZE + 1, len(content) - 3):  # at most so much is padding
        path.write_bytes(content[:end])
        frames, said = read(path)
        assert frames == whole[: len(frames)]
        assert said, end


def test_a_blf_log_of_a_recorder_that_stopped_in_the_middle_says_so(tmp_path: Path) -> None:
    """Its head was never completed and says nothing."""
    path = blf(tmp_path, 40)
    whole, _ = read(path)
    content = bytearray(path.read_bytes())
    file_size = content.index(struct.pack("<Q", len(content)))
    struct.pack_into("<Q", content, file_size, 0)
    path.write_bytes(content)
    assert read(path) == (whole, "")
    path.write_bytes(content[:-50])
    frames, said = read(path)
    assert frames == whole[: len(frames)]
    assert f"is cut behind {len(frames)} frames" in said


@pytest.mark.parametrize("count", [1, 8, 15, 16, 4096])
def test_zeros_behind_a_blf_log_are_padding(tmp_path: Path, count: int) -> None:
    path = blf(tmp_path, 40)
    whole, _ = read(path)
    path.write_bytes(path.read_bytes() + bytes(count))
    assert read(path) == (whole, "")
    path.write_bytes(path.read_bytes() + b"x" * 20)
    frames, said = read(path)
    assert frames == whole
    assert "cannot be read further than 40 frames (" in said
    assert "()" not in said


def test_a_blf_log_that_ends_between_two_containers_says_so(tmp_path: Path) -> None:
    path = blf(tmp_path, 40)
    content = bytearray(path.read_bytes())
    struct.pack_into("<Q", content, content.index(struct.pack("<Q", len(content))), 0)
    end = content.index(b"LOBJ", content.index(b"LOBJ", FILE_HEADER_SIZE + 4) + 4)
    path.write_bytes(content[:end])
    frames, said = read(path)
    assert 0 < len(frames) < 40
    assert f"is cut behind {len(frames)} frames" in said


@pytest.mark.parametrize("size", [0, 8, 15])
def test_an_object_without_a_length_ends_a_blf_log(tmp_path: Path, size: int) -> None:
    path = blf(tmp_path, 3)
    content = path.read_bytes()
    head = OBJ_HEADER_BASE_STRUCT.size
    _, _, _, container, _ = OBJ_HEADER_BASE_STRUCT.unpack_from(content, FILE_HEADER_SIZE)
    begin = FILE_HEADER_SIZE + head + LOG_CONTAINER_STRUCT.size
    inner = bytearray(zlib.decompress(content[begin : FILE_HEADER_SIZE + container]))
    second = inner.index(b"LOBJ", 4)
    struct.pack_into("<L", inner, second + 8, size)
    packed = zlib.compress(bytes(inner))
    container = head + LOG_CONTAINER_STRUCT.size + len(packed)
    path.write_bytes(
        content[:FILE_HEADER_SIZE]
        + OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", head, 1, container, LOG_CONTAINER)
        + LOG_CONTAINER_STRUCT.pack(ZLIB_DEFLATE, len(inner))
        + packed
    )
    _, said = read(path)
    assert f"an object of {size} bytes" in said


def test_an_outer_object_without_a_length_is_named(tmp_path: Path) -> None:
    path = blf(tmp_path, 40)
    content = bytearray(path.read_bytes())
    struct.pack_into("<L", content, FILE_HEADER_SIZE + 8, 0)
    path.write_bytes(content)
    assert read(path)[1]


def test_a_compressed_asc_log_holds_no_frame(tmp_path: Path) -> None:
    assert read(asc(tmp_path, gzip.compress(ASC.encode()))) == ([], "")
