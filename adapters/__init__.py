"""The data acquisition layer: field-bus drivers, and a virtual bench that talks real Modbus and CAN."""
