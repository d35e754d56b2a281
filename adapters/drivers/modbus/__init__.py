"""Modbus: a polling driver that never turns a doubtful answer into a good value."""

from dataclasses import replace

from adapters.drivers.modbus.config import (
    ModbusChannel,
    ModbusPlan,
    ModbusRtuSource,
    ModbusTcpSource,
)
from adapters.protocol import DriverSpec

TCP = DriverSpec(
    ModbusTcpSource,
    ModbusChannel,
    ModbusPlan,
    check_function="adapters.drivers.modbus.mapping:check",
    driver_class="adapters.drivers.modbus.driver:ModbusDriver",
)
RTU = replace(TCP, source_model=ModbusRtuSource)
