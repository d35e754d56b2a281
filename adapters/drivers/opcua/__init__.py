"""OPC UA servers as sources: subscriptions, and history of what was missed (extra ``opcua``)."""

from adapters.drivers.opcua.config import OpcUaChannel, OpcUaSource
from adapters.protocol import DriverSpec

OPCUA = DriverSpec(
    OpcUaSource,
    OpcUaChannel,
    plan_model=None,
    check_function="adapters.drivers.opcua.config:check",
    driver_class="adapters.drivers.opcua.driver:OpcUaDriver",
)
