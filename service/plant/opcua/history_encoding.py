"""Values of a history as OPC UA sends them (Part 6, binary), all of a page at once.

The library encodes value by value, ten times slower than the store is read.
"""

from typing import Any, Final

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from service.plant.opcua.codes import status_code

#: Microseconds from 1601, from which OPC UA counts in steps of 100 ns, to 1970.
_FROM_1601_US: Final = 11_644_473_600_000_000
_HAS_VALUE, _HAS_STATUS, _HAS_SOURCE_TIME = 0x01, 0x02, 0x04
_END: Final = [("status", "<u4"), ("time", "<i8")]
_WITHOUT_VALUE: Final = np.dtype([("mask", "u1"), *_END])
_HISTORY_DATA: Final = ua.NodeId(ua.ObjectIds.HistoryData_Encoding_DefaultBinary)
_STATUS_CODES: Final = np.array([status_code(quality) for quality in range(256)], np.uint32)


def status_codes(qualities: NDArray[np.uint16]) -> NDArray[np.uint32]:
    """Status codes of quality bytes; see `service.plant.opcua.codes.status_code`."""
    return _STATUS_CODES[qualities]


def history_data(
    times_us: NDArray[np.int64],
    values: NDArray[np.float64] | NDArray[np.int32],
    statuses: NDArray[np.uint32],
) -> ua.ExtensionObject:
    """Encode a ``HistoryData``: of each value itself, its status and its source time.

    ``values``: doubles, or integers of 32 bits; what is not a number is sent without a value.
    """
    whole = values.dtype == np.int32
    number, kind = ("<i4", ua.VariantType.Int32) if whole else ("<f8", ua.VariantType.Double)
    with_value = np.dtype([("mask", "u1"), ("type", "u1"), ("value", number), *_END])
    has_value = ~np.isnan(values)
    lengths = np.where(has_value, with_value.itemsize, _WITHOUT_VALUE.itemsize)
    begins = np.cumsum(lengths) - lengths
    encoded = np.empty(int(lengths.sum()), np.uint8)
    for layout, chosen in ((with_value, has_value), (_WITHOUT_VALUE, ~has_value)):
        records: NDArray[Any] = np.zeros(int(chosen.sum()), layout)
        records["mask"] = _HAS_STATUS | _HAS_SOURCE_TIME
        records["status"] = statuses[chosen]
        records["time"] = (times_us[chosen] + _FROM_1601_US) * 10
        if layout is with_value:
            records["mask"] |= _HAS_VALUE
            records["type"] = kind.value
            records["value"] = values[chosen]
        places = begins[chosen][:, None] + np.arange(layout.itemsize)
        encoded[places] = records.view(np.uint8).reshape(places.shape)
    body = np.int32(times_us.size).tobytes() + encoded.tobytes()
    return ua.ExtensionObject(TypeId=_HISTORY_DATA, Body=body)
