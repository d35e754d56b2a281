import subprocess
import sys

import pytest
from pydantic import ValidationError

from adapters.drivers.modbus.config import ModbusChannel, ModbusPlan
from adapters.registry import DRIVERS, UnknownDriverError, driver_spec
from adapters.samples import Quality, is_bad, is_good


def test_an_unknown_driver_names_the_known() -> None:
    with pytest.raises(UnknownDriverError, match=r"'modbus-udp'.*'modbus-tcp'"):
        driver_spec("modbus-udp")
    with pytest.raises(UnknownDriverError, match=r"'x'.*can, modbus-rtu,.* opcua, replay"):
        driver_spec("x")


@pytest.mark.wires
def test_the_registry_imports_no_field_library() -> None:
    code = (
        "import sys, adapters.registry; "
        "libraries = 'pymodbus', 'asyncua', 'can', 'cantools', 'serial'; "
        "sys.exit(any(one in sys.modules for one in libraries))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_quality_classes() -> None:
    good = [q for q in Quality if is_good(q)]
    bad = [q for q in Quality if is_bad(q)]
    assert good == [Quality.GOOD, Quality.LOCAL_OVERRIDE]
    assert [q.name for q in Quality if q not in good + bad] == [
        "UNCERTAIN",
        "LAST_USABLE",
        "SENSOR_NOT_ACCURATE",
        "FROZEN",
        "EU_EXCEEDED",
        "SUB_NORMAL",
    ]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"regster": 1}, r"unknown key 'regster'; did you mean 'register'"),
        ({"register": 70000}, "register"),
        ({"register": 1, "kind": "coil", "type": "int16"}, "'int16' does not fit kind 'coil'"),
        ({"register": 1, "kind": "input", "type": "bool"}, "'bool' does not fit kind 'input'"),
        ({"register": 1, "scale": 0}, "scale must not be 0"),
        ({"register": 1, "valid_range": [5, 1]}, r"low < high, got \[5.0, 1.0\]"),
        ({"register": 1, "type": "int8"}, "type"),
        ({"register": 1, "status": {"register": 2, "bits": {"16": "x"}}}, "status.bits.16"),
        ({"register": 1, "status": {"register": 2, "bit": {}}}, "unknown key 'bit'"),
        ({"register": 1, "scale": float("nan")}, "finite"),
    ],
)
def test_a_wrong_modbus_channel_names_key_and_value(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        ModbusChannel.model_validate({"source": "plc", **wrong})


def test_modbus_defaults() -> None:
    channel = ModbusChannel.model_validate({"source": "plc", "register": 7})
    assert (channel.kind, channel.type, channel.word_order, channel.byte_order) == (
        "holding",
        "int16",
        "big",
        "big",
    )
    assert ModbusChannel.model_validate({"source": "p", "register": 1, "kind": "coil"}).type == (
        "bool"
    )
    with pytest.raises(ValidationError, match="rows"):
        ModbusPlan.model_validate({"source": "plc", "register": 7, "rows": 0})


def test_every_source_model_takes_its_driver_name() -> None:
    sources = {
        "modbus-tcp": {"host": "127.0.0.1"},
        "modbus-rtu": {"device": "/dev/ttyS0"},
        "opcua": {"endpoint": "opc.tcp://127.0.0.1:4840"},
        "replay": {"file": "run.csv"},
        "can": {"channel": "can0", "dbc": "bench.dbc", "interface": "socketcan", "bitrate": 5},
    }
    assert set(sources) == set(DRIVERS)
    for driver, keys in sources.items():
        source = DRIVERS[driver].source_model.model_validate(
            {"name": "s", "driver": driver, **keys}, context={"base_dir": "/etc/bearing"}
        )
        assert source.model_dump()["driver"] == driver
    assert str(source.model_dump()["dbc"]) == "/etc/bearing/bench.dbc"
