"""Recorded data played as if they came now: tables (CSV, Parquet) and CAN logs (ASC, BLF)."""

from adapters.drivers.replay.config import ReplayChannel, ReplaySource
from adapters.protocol import DriverSpec

REPLAY = DriverSpec(
    ReplaySource,
    ReplayChannel,
    plan_model=None,
    check_function="adapters.drivers.replay.driver:check",
    driver_class="adapters.drivers.replay.driver:ReplayDriver",
)
