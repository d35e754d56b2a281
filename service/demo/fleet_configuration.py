"""Configuration of a service that reads a fleet of virtual benches."""

from pathlib import Path

from adapters.virtual_bench.announcements import FleetAnnouncement

_HEAD = """\
# Written for {count} virtual benches behind {ports} Modbus gateway(s).
[service]
host = "127.0.0.1"
port = {port}
data_dir = "data"

[clock]
rate = {rate}
"""

_SOURCE = """
[[sources]]
name = "{source}"
driver = "modbus-tcp"
host = "{host}"
port = {port}
poll_interval_s = {interval}
"""

_ASSET = """
[[assets]]
id = "{asset}"
bearing = "{bearing}"
network = "bearing-14"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
[assets.limits]
t_inner_ring_c = {{ warning = 90, alarm = 105 }}
t_outer_ring_c = {{ warning = 80, alarm = 95 }}
[assets.channels]
{channels}
"""

_CHANNELS = (
    ("t_inner_ring_c", 0, "int16", 0.1),
    ("t_outer_ring_c", 1, "int16", 0.1),
    ("ambient_c", 2, "int16", 0.1),
    ("speed_rpm", 3, "uint16", 0.25),
    ("load_n", 4, "uint16", 0.25),
)
CHANNELS = tuple(name for name, *_ in _CHANNELS)
"""What is read of every bench, with one request."""


def fleet_assets(count: int) -> list[str]:
    """Ids of the assets, in the order of the benches."""
    return [f"bench-{number:05d}" for number in range(1, count + 1)]


def write_fleet_configuration(
    path: Path, fleet: FleetAnnouncement, *, port: int = 0, poll_interval_s: float = 1.0
) -> Path:
    """Write the configuration for a fleet that announced where it listens.

    One source per port: all assets behind it share one connection.
    """
    gateways = fleet["modbus"]
    names = iter(fleet_assets(fleet["benches"]))
    parts = [
        _HEAD.format(
            count=fleet["benches"], ports=len(gateways), port=port, rate=float(fleet["rate"])
        )
    ]
    assets = []
    for number, gateway in enumerate(gateways, 1):
        source = f"gateway-{number}"
        parts.append(
            _SOURCE.format(
                source=source,
                host=gateway["host"],
                port=gateway["port"],
                interval=float(poll_interval_s),
            )
        )
        for unit in range(1, gateway["units"] + 1):
            channels = "\n".join(
                f'{name} = {{ source = "{source}", unit_id = {unit}, register = {register}, '
                f'kind = "input", type = "{type_}", scale = {scale} }}'
                for name, register, type_, scale in _CHANNELS
            )
            assets.append(
                _ASSET.format(asset=next(names), bearing=fleet["bearing"], channels=channels)
            )
    path.write_text("".join([*parts, *assets]))
    return path
