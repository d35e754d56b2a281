"""What OPC UA says in the place of our quality bytes and unit names."""

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
_LIMIT_BITS = 0x03
_INFO_OF_A_VALUE = 0x0400

UNECE_CODES: Final[Mapping[str, str]] = {"°C": "CEL", "rpm": "RPM", "N": "NEW", "s": "SEC"}
"""UNECE Recommendation 20 code of each unit, as OPC UA clients look it up."""


def status_code(quality: int) -> int:
    """OPC UA status code of an OPC DA quality byte, limit bits (low, high, constant) included."""
    limits = quality & _LIMIT_BITS
    code = _STATUS_CODES.get(quality - limits)
    if code is None:
        code = _GOOD if is_good(quality) else _BAD if is_bad(quality) else _UNCERTAIN
    return code | _INFO_OF_A_VALUE | limits << 8 if limits else code


def unit_id(unit: str) -> int:
    """Number of a unit in OPC UA's EUInformation: its UNECE code read as bytes; -1 for none."""
    code = UNECE_CODES.get(unit)
    return -1 if code is None else int.from_bytes(code.encode(), "big")
