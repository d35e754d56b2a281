"""CAN with a DBC file: a listening driver over any python-can interface."""

from adapters.drivers.can.config import CanChannel, CanSource
from adapters.protocol import DriverSpec

CAN = DriverSpec(
    CanSource,
    CanChannel,
    plan_model=None,
    check_function="adapters.drivers.can.decoding:check",
    driver_class="adapters.drivers.can.driver:CanDriver",
)
