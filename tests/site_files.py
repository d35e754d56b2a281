"""Configuration files for tests: a service, and assets whose values are pushed."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from processes import free_port

from service.site.asset_section import AssetSection

COLUMNS = ("speed_rpm", "load_n", "ambient_c")
MACHINE = (*COLUMNS, "t_inner_ring_c")
CHANNELS = (*MACHINE, "t_outer_ring_c")
#: Keys of an asset and of a pushed channel.
OBSERVE = 'identification = { ladder = "observe" }'
UNCHECKED = "max_jump = 0, max_rate_per_s = 0, flat_line_s = 0"


def pushed(names: Iterable[str] = MACHINE, keys: str = "") -> str:
    """Lines of channels that are pushed, each with the same keys."""
    more = f", {keys}" if keys else ""
    return "".join(f'{name} = {{ source = "push"{more} }}\n' for name in names)


def asset_text(
    name: str,
    channels: str | Iterable[str] = MACHINE,
    *lines: str,
    machine: str = 'bearing = "6311"',
    low_risk: tuple[float, float] = (4300, 3400),
) -> str:
    """An asset as text; channels are names, which are pushed, or lines."""
    speed_rpm, load_n = low_risk
    return "\n".join(
        (
            f'\n[[assets]]\nid = "{name}"\n{machine}',
            f"low_risk = {{ speed_rpm_max = {speed_rpm}, load_n_max = {load_n} }}",
            *lines,
            "[assets.channels]",
            channels if isinstance(channels, str) else pushed(channels),
        )
    )


def asset_table(name: str = "bench-1", channels: Iterable[str] = CHANNELS) -> dict[str, Any]:
    """The same as a table of keys."""
    return {
        "id": name,
        "bearing": "6311",
        "low_risk": {"speed_rpm_max": 4300, "load_n_max": 3400},
        "channels": {channel: {"source": "push"} for channel in channels},
    }


def asset_section(
    name: str = "bench-1", channels: Iterable[str] = CHANNELS, **changes: Any
) -> AssetSection:
    """The same as the service reads it, with other keys or more."""
    return AssetSection.model_validate(asset_table(name, channels) | changes)


def write_site(folder: Path, text: str, *service: str) -> tuple[Path, int]:
    """Write a configuration file, with lines of its section for the service; and its port."""
    file, port = folder / "site.toml", free_port()
    lines = "\n".join(("[service]", f"port = {port}", 'data_dir = "data"', *service))
    file.write_text(f"{lines}\n{text}")
    return file, port
