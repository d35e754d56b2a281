"""CAN with a DBC file: a listening driver over any python-can interface."""

import sys

from adapters.drivers.can.config import CanChannel, CanSource
from adapters.protocol import DriverSpec

# python-can loads asammdf, where it is installed, and with that pandas: 60 MiB in each process, for
# files that no driver reads. Who reads such files takes the mark away.
sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]

CAN = DriverSpec(
    CanSource,
    CanChannel,
    plan_model=None,
    check_function="adapters.drivers.can.binding:check",
    driver_class="adapters.drivers.can.driver:CanDriver",
)
