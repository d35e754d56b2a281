"""The demo's configuration file, as a real bench of this kind would use it."""

from collections.abc import Sequence
from importlib.resources import as_file, files
from pathlib import Path

from adapters.virtual_bench.announcements import BenchAnnouncement

ASSET = "bench-1"
FAMILY = "6311 on the virtual bench"

_TEMPLATE = """\
# Written by `bearing-twin demo`; a real bench of this kind needs nothing else.
[service]
host = "127.0.0.1"
port = {port}
data_dir = "data"

[clock]
rate = {rate}
"""

_BENCH = """
[[sources]]
name = "pt100{suffix}"
driver = "modbus-tcp"
host = "{modbus_host}"
port = {modbus_port}
unit = 1
poll_interval_s = 1.0
{timeout}
[[sources]]
name = "drive{suffix}"
driver = "can"
interface = "slcan"
channel = "{can_channel}"
sleep_after_open = 0.1
dbc = "bench.dbc"

[[assets]]
id = "{asset}"
{family}bearing = "6311"
network = "bearing-14"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}

[assets.limits]
t_inner_ring_c = {{ warning = 70, alarm = 95 }}
t_outer_ring_c = {{ warning = 65, alarm = 80 }}

[assets.channels]
{temperatures}
speed_rpm = {{ source = "drive{suffix}", message = "DriveStatus", signal = "Speed" }}
load_n = {{ source = "drive{suffix}", message = "LoadCell", signal = "RadialLoad" }}

[assets.controller]
phase = {{ source = "pt100{suffix}", unit_id = 2, register = 0, kind = "holding", type = "uint16" }}
speed_setpoint_rpm = {{ source = "pt100{suffix}", unit_id = 2, register = 2, kind = "holding", type = "float32" }}
load_setpoint_n = {{ source = "pt100{suffix}", unit_id = 2, register = 4, kind = "holding", type = "float32" }}
plan = {{ source = "pt100{suffix}", unit_id = 2, register = 100, rows = 16 }}

[assets.identification]
ladder = "apply"
"""  # noqa: E501 - TOML wants an inline table on one line

# A second of a busy processor is two minutes of the bench at rate 120, and no lost device: the
# time-out is as long as the age at which data are stale then (`service.live.readings`).
_SLOW_MACHINE = "timeout_s = 5.0\n"

_TEMPERATURE = (
    '{name} = {{ source = "pt100{suffix}", register = {register}, kind = "input", type = "int16", '
    "scale = 0.1, sentinels = [-32768, 32767], valid_range = [-40, 200], "
    'status = {{ register = {status}, kind = "input", '
    'bits = {{ "0" = "wire break", "1" = "short circuit", "2" = "over range" }} }} }}'
)


def asset_of(number: int) -> str:
    """Name the asset of a bench, counted from 1."""
    return f"bench-{number}"


def write_configuration(
    folder: Path, benches: Sequence[BenchAnnouncement], rate: float, port: int
) -> Path:
    """Write configuration and DBC for benches that announced where they listen.

    Several benches are of one family. The data directory will be below the folder.
    """
    with as_file(files("adapters.virtual_bench") / "bench.dbc") as dbc:
        (folder / "bench.dbc").write_bytes(dbc.read_bytes())
    parts = [_TEMPLATE.format(port=port, rate=float(rate))]
    for number, bench in enumerate(benches, start=1):
        suffix = "" if len(benches) == 1 else f"-{number}"
        temperatures = [
            _TEMPERATURE.format(name=name, register=register, status=register + 10, suffix=suffix)
            for register, name in enumerate(("t_inner_ring_c", "t_outer_ring_c", "ambient_c"))
        ]
        parts.append(
            _BENCH.format(
                suffix=suffix,
                asset=asset_of(number),
                family=f'family = "{FAMILY}"\n' if len(benches) > 1 else "",
                timeout=_SLOW_MACHINE if rate > 1.0 else "",
                modbus_host=bench["modbus"]["host"],
                modbus_port=bench["modbus"]["port"],
                can_channel=bench["can"]["channel"],
                temperatures="\n".join(temperatures),
            )
        )
    path = folder / "bearing-twin.toml"
    path.write_text("".join(parts))
    return path
