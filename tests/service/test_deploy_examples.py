"""What `deploy/` ships must load, and fit the virtual bench that it says it fits."""

import configparser
from pathlib import Path

import pytest
import yaml

from adapters.drivers.can.config import CanChannel, CanSource
from adapters.drivers.modbus.config import ModbusChannel, ModbusPlan, ModbusTcpSource
from adapters.virtual_bench.modbus_server import (
    CONTROLLER_UNIT,
    PLAN_ADDRESS,
    PLAN_ROWS,
    STATUS_ADDRESS,
    TRANSMITTER_UNIT,
)
from adapters.virtual_bench.sensors import PT100_CHANNELS
from service.domain.channels import OPERATING_CHANNELS, RING_SENSORS
from service.site.settings import Settings, load_settings
from service.site.wiring import SourceWiring, wire
from service.waiting import LEAVE_S

DEPLOY = Path(__file__).parents[2] / "deploy"
EXAMPLE = DEPLOY / "bearing-twin.example.toml"


@pytest.fixture(scope="module")
def settings() -> Settings:
    return load_settings(EXAMPLE)


@pytest.fixture(scope="module")
def sources(settings: Settings) -> dict[str, SourceWiring]:
    return {source.name: source for source in wire(settings).sources}


def test_the_example_wires_every_sensor_and_the_controller(settings: Settings) -> None:
    assert set(wire(settings).channels["bench-1"]) == {
        *OPERATING_CHANNELS,
        *RING_SENSORS,
        "phase",
        "speed_setpoint_rpm",
        "load_setpoint_n",
    }


def test_the_example_listens_on_loopback_at_real_time(settings: Settings) -> None:
    assert settings.service.host == "127.0.0.1"
    assert settings.clock.rate == 1.0
    assert settings.data_dir == DEPLOY / "var"


def test_the_modbus_side_is_the_virtual_bench_s_register_map(
    sources: dict[str, SourceWiring],
) -> None:
    source = sources["pt100"]
    assert isinstance(source.config, ModbusTcpSource)
    assert (source.config.port, source.config.unit) == (5020, TRANSMITTER_UNIT)
    channels = {}
    for binding in source.channels:
        assert isinstance(binding.config, ModbusChannel)
        channels[binding.channel] = binding.config
    for register, name in enumerate(PT100_CHANNELS):
        channel = channels.pop(name)
        assert (channel.address, channel.kind, channel.scale) == (register, "input", 0.1)
        assert channel.status is not None
        assert channel.status.address == STATUS_ADDRESS + register
    assert {(name, channel.unit_id, channel.address) for name, channel in channels.items()} == {
        ("phase", CONTROLLER_UNIT, 0),
        ("speed_setpoint_rpm", CONTROLLER_UNIT, 2),
        ("load_setpoint_n", CONTROLLER_UNIT, 4),
    }
    (plan,) = source.plans
    assert isinstance(plan.config, ModbusPlan)
    assert (plan.config.unit_id, plan.config.address, plan.config.rows) == (
        CONTROLLER_UNIT,
        PLAN_ADDRESS,
        PLAN_ROWS,
    )


def test_the_can_side_is_the_virtual_bench_s(sources: dict[str, SourceWiring]) -> None:
    source = sources["drive"]
    assert isinstance(source.config, CanSource)
    assert source.config.channel == "socket://127.0.0.1:5021"
    signals = set()
    for binding in source.channels:
        assert isinstance(binding.config, CanChannel)
        signals.add((binding.channel, binding.config.message, binding.config.signal))
    assert signals == {
        ("speed_rpm", "DriveStatus", "Speed"),
        ("load_n", "LoadCell", "RadialLoad"),
    }


def test_the_unit_watches_over_the_service_and_bounds_it() -> None:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(DEPLOY / "systemd" / "bearing-twin.service")
    service = unit["Service"]
    # `service.service_manager` speaks to it.
    assert (service["Type"], service["WatchdogSec"]) == ("notify", "30")
    # What passes by itself is tried again, without limit; what a person must mend is not.
    assert service["Restart"] == "on-failure"
    assert service["RestartPreventExitStatus"] == "2"
    assert unit["Unit"]["StartLimitIntervalSec"] == "0"
    assert float(service["TimeoutStartSec"]) > LEAVE_S
    assert (service["LimitNOFILE"], service["UMask"]) == ("65536", "0077")
    assert service["MemoryMax"]
    assert service["TasksMax"]


def test_the_container_is_watched_and_bounded() -> None:
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    service = compose["services"]["bearing-twin"]
    assert service["restart"] == "unless-stopped"
    assert service["healthcheck"]["test"][:3] == ["CMD", "python", "-c"]
    compile(service["healthcheck"]["test"][3], "healthcheck", "exec")
    assert service["mem_limit"]
    assert service["pids_limit"]
    assert service["ulimits"]["nofile"] == 65536
    # What it writes lies on volumes: data, compiled kernels; all else is read-only.
    assert service["read_only"] is True
    assert service["tmpfs"] == ["/tmp"]
    mounted = {volume.split(":")[0] for volume in service["volumes"]}
    assert mounted >= set(compose["volumes"]) == {"data", "cache"}
