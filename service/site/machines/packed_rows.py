"""The minute rows of an identification, packed into one text of a few tens of kilobytes.

With them a model can be played as the target of its sisters; see `twin_core.sisters`. Compressed
NumPy arrays in base64: every reader checks their sums, and no code is read from them.
"""

import base64
import binascii
import io
import zipfile
import zlib
from typing import Any

import numpy as np

from twin_core.identification import IdentificationData, IdentificationWindow
from twin_core.windows import MinuteData

_OPERATING = ("speed_rpm", "load_n", "ambient_c")


def pack_rows(data: IdentificationData) -> list[dict[str, Any]]:
    """Return the good rows of all windows as plain JSON types. Values are kept to seven figures."""
    return [_pack(window) for window in data.windows]


def unpack_rows(document: list[dict[str, Any]]) -> IdentificationData:
    """Take back what `pack_rows` gave. Raises `ValueError` if it is damaged."""
    try:
        return IdentificationData(tuple(_unpack(window) for window in document))
    except (
        KeyError, TypeError, ValueError, AttributeError, EOFError, OSError,
        binascii.Error, zipfile.BadZipFile, zlib.error,
    ) as error:  # fmt: skip
        raise ValueError(f"minute rows are damaged ({error})") from error


def _pack(window: IdentificationWindow) -> dict[str, Any]:
    rows = window.minutes.take(window.minutes.good)
    columns = {name: getattr(rows, name) for name in _OPERATING} | {
        f"{kind}.{name}": values
        for kind, of in (("temperature", rows.temperatures_c), ("input", rows.inputs))
        for name, values in of.items()
    }
    file = io.BytesIO()
    narrow = {name: values.astype(np.float32) for name, values in columns.items()}
    np.savez_compressed(file, allow_pickle=False, time_s=rows.time_s, **narrow)
    return {
        "at_rest": window.at_rest,
        "revolutions": float(window.revolutions),
        "rows": rows.size,
        "columns": base64.b64encode(file.getvalue()).decode("ascii"),
    }


def _unpack(document: dict[str, Any]) -> IdentificationWindow:
    packed = base64.b64decode(document["columns"], validate=True)
    with np.load(io.BytesIO(packed), allow_pickle=False) as file:
        columns = {name: file[name].astype(np.float64) for name in file.files}
    of: dict[str, dict[str, Any]] = {"temperature": {}, "input": {}}
    for name, values in columns.items():
        kind, found, own_name = name.partition(".")
        if found:
            of[kind][own_name] = values
    time_s = columns["time_s"]
    if time_s.shape != (int(document["rows"]),):
        raise ValueError(f"{time_s.size} rows, expected {document['rows']}")
    minutes = MinuteData(
        time_s,
        columns["speed_rpm"],
        columns["load_n"],
        columns["ambient_c"],
        of["temperature"],
        np.ones(time_s.size, np.bool_),
        of["input"],
    )
    return IdentificationWindow(minutes, bool(document["at_rest"]), float(document["revolutions"]))
