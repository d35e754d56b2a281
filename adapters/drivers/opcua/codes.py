"""OPC UA status codes and our quality bytes, both ways; for the driver and the OPC UA server."""

from collections.abc import Mapping
from typing import Final

from adapters.samples import Quality, is_bad, is_good

_GOOD, _UNCERTAIN, _BAD = 0x0000_0000, 0x4000_0000, 0x8000_0000

_STATUS_CODES: Final[Mapping[int, int]] = {
    Quality.BAD: _BAD,
    Quality.CONFIG_ERROR: 0x8089_0000,  # BadConfigurationError
    Quality.NOT_CONNECTED: 0x808A_0000,  # BadNotConnected
    Quality.DEVICE_FAILURE: 0x808B_0000,  # BadDeviceFailure
    Quality.SENSOR_FAILURE: 0x808C_0000,  # BadSensorFailure
    Quality.LAST_KNOWN: 0x8031_0000,  # BadNoCommunication
    Quality.COMM_FAILURE: 0x8005_0000,  # BadCommunicationError
    Quality.OUT_OF_SERVICE: 0x808D_0000,  # BadOutOfService
    Quality.WAITING_FOR_INITIAL_DATA: 0x8032_0000,  # BadWaitingForInitialData
    Quality.UNCERTAIN: _UNCERTAIN,
    Quality.LAST_USABLE: 0x4090_0000,  # UncertainLastUsableValue
    Quality.SENSOR_NOT_ACCURATE: 0x4093_0000,  # UncertainSensorNotAccurate
    Quality.EU_EXCEEDED: 0x4094_0000,  # UncertainEngineeringUnitsExceeded
    Quality.SUB_NORMAL: 0x4095_0000,  # UncertainSubNormal
    Quality.GOOD: _GOOD,
    Quality.LOCAL_OVERRIDE: 0x0096_0000,  # GoodLocalOverride
}
_QUALITIES: Final[Mapping[int, int]] = {
    **{code: int(quality) for quality, code in _STATUS_CODES.items()},
    0x8033_0000: int(Quality.CONFIG_ERROR),  # BadNodeIdInvalid
    0x8034_0000: int(Quality.CONFIG_ERROR),  # BadNodeIdUnknown
    0x8035_0000: int(Quality.CONFIG_ERROR),  # BadAttributeIdInvalid
    0x803A_0000: int(Quality.CONFIG_ERROR),  # BadNotReadable
    0x801F_0000: int(Quality.CONFIG_ERROR),  # BadUserAccessDenied
}
_LIMIT_BITS = 0x03
_INFO_OF_A_VALUE = 0x0400
_INFO_TYPE = 0x0C00
_OVERFLOW = 0x0080
_SEMANTICS_CHANGED = 0x4000


def status_code(quality: int) -> int:
    """OPC UA status code of an OPC DA quality byte, limit bits (low, high, constant) included."""
    limits = quality & _LIMIT_BITS
    code = _STATUS_CODES.get(quality - limits)
    if code is None:
        code = _GOOD if is_good(quality) else _BAD if is_bad(quality) else _UNCERTAIN
    return code | _INFO_OF_A_VALUE | limits << 8 if limits else code


def quality_of(code: int) -> int:
    """OPC DA quality byte of an OPC UA status code; of a code that we do not know its severity."""
    quality = _QUALITIES.get(code & 0xFFFF_0000)
    if quality is None:
        quality = {_GOOD: Quality.GOOD, _UNCERTAIN: Quality.UNCERTAIN}.get(
            code & 0xC000_0000, Quality.BAD
        )
    limits = code >> 8 & _LIMIT_BITS if code & _INFO_TYPE == _INFO_OF_A_VALUE else 0
    return int(quality) | limits


def with_overflow(code: int) -> int:
    """Status code of a value before which the server lost some, as its queue was full."""
    return code | _INFO_OF_A_VALUE | _OVERFLOW


def has_changed_meaning(code: int) -> bool:
    """Whether the server says that its unit or range is another one since (Part 4, 7.39.1)."""
    return bool(code & _SEMANTICS_CHANGED)


def has_overflown(code: int) -> bool:
    """Whether the server lost values before this one, as its queue was full."""
    return code & _INFO_TYPE == _INFO_OF_A_VALUE and bool(code & _OVERFLOW)
