"""The data acquisition layer: field-bus drivers and a virtual bench on real Modbus and CAN."""


class AdapterError(Exception):
    """The root of all errors of the drivers."""
