"""The demo's configuration file, as a real bench of this kind would use it."""

from importlib.resources import as_file, files
from pathlib import Path

from adapters.virtual_bench.announcements import BenchAnnouncement

ASSET = "bench-1"

_TEMPLATE = """\
# Written by `bearing-twin demo`; a real bench of this kind needs nothing else.
[service]
host = "127.0.0.1"
port = {port}
data_dir = "data"

[clock]
rate = {rate}

[[sources]]
name = "pt100"
driver = "modbus-tcp"
host = "{modbus_host}"
port = {modbus_port}
unit = 1
poll_interval_s = 1.0
{timeout}
[[sources]]
name = "drive"
driver = "can"
interface = "slcan"
channel = "{can_channel}"
sleep_after_open = 0.1
dbc = "bench.dbc"

[[assets]]
id = "{asset}"
bearing = "6311"
network = "bearing-14"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}

[assets.limits]
t_inner_ring_c = {{ warning = 70, alarm = 95 }}
t_outer_ring_c = {{ warning = 65, alarm = 80 }}

[assets.channels]
{temperatures}
speed_rpm = {{ source = "drive", message = "DriveStatus", signal = "Speed" }}
load_n = {{ source = "drive", message = "LoadCell", signal = "RadialLoad" }}

[assets.controller]
phase = {{ source = "pt100", unit_id = 2, register = 0, kind = "holding", type = "uint16" }}
speed_setpoint_rpm = {{ source = "pt100", unit_id = 2, register = 2, kind = "holding", type = "float32" }}
load_setpoint_n = {{ source = "pt100", unit_id = 2, register = 4, kind = "holding", type = "float32" }}
plan = {{ source = "pt100", unit_id = 2, register = 100, rows = 16 }}

[assets.identification]
ladder = "apply"
"""  # noqa: E501 - TOML wants an inline table on one line

# A second of a busy processor is two minutes of the bench at rate 120, and no lost device: the
# time-out is as long as the age at which data are stale then (`service.live.readings`).
_SLOW_MACHINE = "timeout_s = 5.0\n"

_TEMPERATURE = (
    '{name} = {{ source = "pt100", register = {register}, kind = "input", type = "int16", '
    "scale = 0.1, sentinels = [-32768, 32767], valid_range = [-40, 200], "
    'status = {{ register = {status}, kind = "input", '
    'bits = {{ "0" = "wire break", "1" = "short circuit", "2" = "over range" }} }} }}'
)


def write_configuration(folder: Path, bench: BenchAnnouncement, rate: float, port: int) -> Path:
    """Write configuration and DBC for a bench that announced where it listens.

    Parameters
    ----------
    folder : pathlib.Path
        Existing directory; the data directory will be below it.
    bench : BenchAnnouncement
        What the virtual bench announced.
    rate : float
        Process seconds per wall second.
    port : int
        Port of the page; 0 takes a free one.
    """
    with as_file(files("adapters.virtual_bench") / "bench.dbc") as dbc:
        (folder / "bench.dbc").write_bytes(dbc.read_bytes())
    temperatures = [
        _TEMPERATURE.format(name=name, register=register, status=register + 10)
        for register, name in enumerate(("t_inner_ring_c", "t_outer_ring_c", "ambient_c"))
    ]
    path = folder / "bearing-twin.toml"
    path.write_text(
        _TEMPLATE.format(
            asset=ASSET,
            port=port,
            rate=float(rate),
            timeout=_SLOW_MACHINE if rate > 1.0 else "",
            modbus_host=bench["modbus"]["host"],
            modbus_port=bench["modbus"]["port"],
            can_channel=bench["can"]["channel"],
            temperatures="\n".join(temperatures),
        )
    )
    return path
