"""Which sources may come from the page: less than the configuration file may hold.

Who writes the file owns the machine. Who has an administrator's key need not: he names devices on
the network and serial ports, not files of this machine or options of a field library.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from adapters.configuration import SourceConfig
from service.site.asset_section import ASSET_ID
from service.site.configuration import SettingsError, TomlTable
from service.site.wiring import source_of

DRIVERS: Final = ("modbus-tcp", "modbus-rtu", "can")
CAN_INTERFACES: Final = ("slcan", "socketcan", "socketcand", "udp_multicast")
#: Keys of a CAN source that the page may give; what a library makes of others is unknown.
_CAN_KEYS: Final = frozenset(
    {"name", "driver", "interface", "channel", "dbc", "host", "port", "bitrate", "sleep_after_open"}
)
_NAME: Final = re.compile(ASSET_ID)
_DEVICE: Final = re.compile(r"/dev/[A-Za-z0-9._/-]+")
_SOCKET: Final = re.compile(r"socket://[A-Za-z0-9.:\[\]_-]+")

#: A file next to the configuration: no folders, nothing hidden.
DBC_NAME: Final = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,59}\.dbc$"


def source_from_page(
    table: TomlTable, base_dir: Path, key: str = "source", in_file: Sequence[TomlTable] = ()
) -> SourceConfig:
    """Check a source that the page names.

    ``key``: begins each line of an error; ``in_file``: sources of the configuration file, which may
    be more than the page may give. Raises `SettingsError`: one line for each error.
    """
    wrong = [] if table in in_file else _wrong(table)
    if wrong:
        raise SettingsError(*(f"{key}.{line}" for line in wrong))
    return source_of(key, table, base_dir).config


def outside_folder(network: object) -> str | None:
    """Say why a network may not come from the page or by REST: its file lies elsewhere."""
    if isinstance(network, str) and (
        Path(network).is_absolute() or ".." in Path(network).parts or network.startswith("~")
    ):
        return "expected a file in the folder of the configuration file, or below it"
    return None


def _wrong(table: TomlTable) -> list[str]:
    driver, name = table.get("driver"), table.get("name")
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        return [f"name = {name!r}: expected letters, digits, '.', '_' and '-', 64 at most"]
    if driver not in DRIVERS:
        return [f"driver = {driver!r}: expected one of {', '.join(DRIVERS)} from the page"]
    if driver == "modbus-rtu":
        device = str(table.get("device"))
        return [] if _is_device(device) else [f"device = {device!r}: expected a path in /dev"]
    if driver != "can":
        return []
    wrong = [f"{name}: expected in the file alone" for name in sorted(set(table) - _CAN_KEYS)]
    interface, channel = table.get("interface", "slcan"), str(table.get("channel"))
    if interface not in CAN_INTERFACES:
        wrong.append(f"interface = {interface!r}: expected one of {', '.join(CAN_INTERFACES)}")
    if interface == "slcan" and not (_SOCKET.fullmatch(channel) or _is_device(channel)):
        wrong.append(f"channel = {channel!r}: expected socket://HOST:PORT or a path in /dev")
    dbc = str(table.get("dbc"))
    if not re.fullmatch(DBC_NAME, dbc):
        wrong.append(f"dbc = {dbc!r}: expected the name of an uploaded file that ends in .dbc")
    return wrong


def _is_device(path: str) -> bool:
    return bool(_DEVICE.fullmatch(path)) and ".." not in path
