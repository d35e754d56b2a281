"""What OPC UA says in the place of our quality bytes and unit names."""

from collections.abc import Mapping
from typing import Final

from adapters.drivers.opcua.codes import status_code, with_overflow

__all__ = ["UNECE_CODES", "status_code", "unit_id", "with_overflow"]

UNECE_CODES: Final[Mapping[str, str]] = {"°C": "CEL", "rpm": "RPM", "N": "NEW", "s": "SEC"}
"""UNECE Recommendation 20 code of each unit, as OPC UA clients look it up."""


def unit_id(unit: str) -> int:
    """Number of a unit in OPC UA's EUInformation: its UNECE code read as bytes; -1 for none."""
    code = UNECE_CODES.get(unit)
    return -1 if code is None else int.from_bytes(code.encode(), "big")
