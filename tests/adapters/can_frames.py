"""DBC files, channels and frames for the tests of what a CAN frame says."""

import struct
from pathlib import Path
from typing import Any

from adapters.drivers.can.binding import bind
from adapters.drivers.can.config import CanChannel, CanSource
from adapters.drivers.can.decoding import BoundMessage
from adapters.protocol import ChannelBinding
from adapters.samples import Sample

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


HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: A B\n'


J1939 = (
    'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'
)


#: Identifiers of one J1939 group: of two senders, and of any.
A, B, ANY = 0x18FF2080, 0x18FF2081, 0x18FF20FE


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
