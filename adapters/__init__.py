"""The data acquisition layer: field-bus drivers and a virtual bench on real Modbus and CAN."""
