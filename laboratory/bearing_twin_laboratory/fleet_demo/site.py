"""The configuration of the demo's fleet: polled benches, pushed machines, machines of the night."""

from pathlib import Path

from adapters.virtual_bench.announcements import FleetAnnouncement
from bearing_twin_laboratory.benchmarks.fleet_identification import STAGES, run_of_machine
from service.clock import MINUTE_US, wall_us
from service.demo.fleet_configuration import write_fleet_configuration
from service.store import Store

PUSHED_CHANNEL = "load_n"
#: Pushed with it, above its warning limit: an alarm that must outlive its cell.
HOT_CHANNEL = "t_outer_ring_c"
HOT_C = 85.0
#: A pushed value is this plus a thousandth of its number.
BASE = 3000.0
NIGHT_FAMILY = "night shift"

_PUSHED = """
[[assets]]
id = "{asset}"
bearing = "6311"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
[assets.limits]
{hot} = {{ warning = 80, alarm = 95 }}
[assets.channels]
{numbered} = {{ source = "push" }}
{hot} = {{ source = "push" }}
[assets.identification]
ladder = "observe"
"""

_NIGHT = """
[[assets]]
id = "{asset}"
bearing = "6311"
family = "{family}"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
[assets.channels]
{channels}
[assets.identification]
ladder = "observe"
"""

_NIGHT_CHANNELS = ("speed_rpm", "load_n", "ambient_c", "t_inner_ring_c", "t_outer_ring_c")

_FLEET = """
[fleet]
database_url = "{database_url}"
nats_url = "{nats_url}"
scheduler = "{scheduler}"
"""


def pushed_assets(count: int) -> list[str]:
    """Ids of the assets that the pusher feeds."""
    return [f"pushed-{number}" for number in range(1, count + 1)]


def night_assets(count: int) -> list[str]:
    """Ids of the assets that are identified."""
    return [f"night-{number}" for number in range(1, count + 1)]


def write_site(
    path: Path,
    benches: FleetAnnouncement,
    pushed: int,
    nights: int,
    database_url: str,
    nats_url: str,
    scheduler: str,
) -> Path:
    """Write the configuration of all cells and web processes of the fleet.

    Port and data directory differ between them; the environment says them.

    - ``benches``: what the virtual fleet announced.
    - ``pushed``, ``nights``: how many assets are pushed to, and how many are identified.
    - ``database_url``, ``nats_url``, ``scheduler``: addresses of PostgreSQL, NATS and the Dask
      scheduler.
    """
    write_fleet_configuration(path, benches)
    channels = "\n".join(f'{name} = {{ source = "push" }}' for name in _NIGHT_CHANNELS)
    parts = [
        path.read_text(),
        *(
            _PUSHED.format(asset=asset, numbered=PUSHED_CHANNEL, hot=HOT_CHANNEL)
            for asset in pushed_assets(pushed)
        ),
        *(
            _NIGHT.format(asset=asset, family=NIGHT_FAMILY, channels=channels)
            for asset in night_assets(nights)
        ),
        _FLEET.format(database_url=database_url, nats_url=nats_url, scheduler=scheduler),
    ]
    path.write_text("".join(parts))
    return path


def write_histories(store: Store, count: int) -> None:
    """Store some hours of data of the machines that are identified; they end ten minutes ago."""
    start_us = wall_us() - (sum(minutes for _, minutes in STAGES) + 10) * MINUTE_US
    start_us -= start_us % MINUTE_US
    for number, asset in enumerate(night_assets(count)):
        store.samples.write(run_of_machine(asset, number, start_us))
