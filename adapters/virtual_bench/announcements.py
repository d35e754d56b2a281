"""What virtual benches announce: where they listen, and what they run."""

from typing import TypedDict


class ModbusAddress(TypedDict):
    """A Modbus TCP server."""

    host: str
    port: int


class GatewayAddress(ModbusAddress):
    """A Modbus TCP gateway; its units are numbered from 1."""

    units: int


class CanAddress(TypedDict):
    """A CAN adapter: slcan over TCP; ``channel`` is what a driver opens."""

    host: str
    port: int
    channel: str


class BenchAnnouncement(TypedDict):
    """One bench."""

    modbus: ModbusAddress
    can: CanAddress
    scenario: str
    bearing: str
    rate: float
    seed: int


class FleetAnnouncement(TypedDict):
    """Many benches, each a unit of a gateway."""

    modbus: list[GatewayAddress]
    benches: int
    bearing: str
    rate: float
    seed: int
