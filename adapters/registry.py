"""The registry of drivers: one line for each name that a configuration may give."""

from collections.abc import Mapping
from pkgutil import resolve_name
from types import MappingProxyType

from adapters.configuration import ConfigurationError, suggestion
from adapters.protocol import DriverSpec

_SPECS = {
    "can": "adapters.drivers.can:CAN",
    "modbus-rtu": "adapters.drivers.modbus:RTU",
    "modbus-tcp": "adapters.drivers.modbus:TCP",
    "opcua": "adapters.drivers.opcua:OPCUA",
    "replay": "adapters.drivers.replay:REPLAY",
}

DRIVERS: Mapping[str, DriverSpec] = MappingProxyType(
    {name: resolve_name(place) for name, place in _SPECS.items()}
)


class UnknownDriverError(ConfigurationError):
    """There is no driver of that name."""


def driver_spec(name: str) -> DriverSpec:
    """Look up a driver by its name in the configuration. Raises `UnknownDriverError`."""
    try:
        return DRIVERS[name]
    except KeyError:
        raise UnknownDriverError(f"unknown driver {name!r}; {suggestion(name, DRIVERS)}") from None
