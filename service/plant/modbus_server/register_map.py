"""Which register holds what: fixed by the configuration, and known by its version.

Addresses are those of the protocol, counted from 0.
"""

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from adapters.configuration import listed
from service.domain.channels import unit_of
from service.site.asset_section import ASSET_ID, AssetSection
from service.site.configuration import SettingsError
from service.site.required_channels import required_channels
from service.site.settings import Settings

#: Registers before the tags.
HEARTBEAT, VERSION, STATUS, TAG_COUNT, TIME = 0, 1, 2, 3, 4
#: One word for each asset from here on, and for as many assets as there is room before the tags.
PERMISSIVE: Final = 10
FIRST_TAG: Final = 100
MOST_ASSETS: Final = FIRST_TAG - PERMISSIVE
#: Value (2), quality, age.
TAG_REGISTERS: Final = 4
_ADDRESSES: Final = 65536
MOST_TAGS: Final = (_ADDRESSES - FIRST_TAG) // TAG_REGISTERS
#: Tags that every asset has, after those of its temperatures.
_OF_EVERY_ASSET: Final = (
    "verdict.now",
    "verdict.present_step",
    "verdict.next_step",
    "alarms.active",
    "alarms.unacknowledged",
    "model.version",
    "model.trusted",
)
_OF_A_LIMIT: Final = ("twin", "forecast_max", "time_to_warning_s", "time_to_alarm_s")
_TAG: Final = re.compile(r"[a-z0-9_]+(\.[a-z0-9_]+)?")


class MappedTag(NamedTuple):
    """A tag in the map."""

    asset: str
    tag: str


class Entry(NamedTuple):
    """One line of the printed map: registers, or the bit of a permissive."""

    #: ``register`` (input and holding) or ``bit`` (discrete input and coil).
    table: str
    address: int
    size: int
    type: str
    name: str
    unit: str


@dataclass(frozen=True, slots=True)
class RegisterMap:
    """The registers of a configuration.

    - ``assets``: assets with a permissive, in its order, each with the channels that a verdict
      needs.
    - ``version``: 1 to 65535; another one when anything in the map changes (but for one change of
      65,535).
    """

    assets: Mapping[str, tuple[str, ...]]
    tags: Sequence[MappedTag]
    version: int

    @property
    def end(self) -> int:
        """The first address behind the registers."""
        return FIRST_TAG + TAG_REGISTERS * len(self.tags)

    def entries(self) -> list[Entry]:
        """All lines of the map."""
        return _entries(list(self.assets), self.tags)


def map_of(settings: Settings) -> RegisterMap:
    """Make the map of a configuration.

    Raises `SettingsError` if a tag cannot be one, or there are too many; names the key.
    """
    known = {asset.id: asset for asset in settings.assets}
    given = settings.modbus_server.tags
    if given:
        tags = [_tag(text, number, known) for number, text in enumerate(given)]
    else:
        tags = [MappedTag(asset.id, tag) for asset in _with_room(settings) for tag in _usual(asset)]
    seen: set[MappedTag] = set()
    for number, tag in enumerate(tags):
        if given and tag in seen:
            raise SettingsError(
                f"modbus_server.tags[{number}] = {given[number]!r}: is there twice; expected once"
            )
        seen.add(tag)
    names = list(dict.fromkeys(tag.asset for tag in tags))
    for what, count, most in (("assets", len(names), MOST_ASSETS), ("tags", len(tags), MOST_TAGS)):
        if count > most:
            raise SettingsError(
                f"modbus_server.tags: {count} {what}; expected at most {most}: "
                "list the tags that the PLC needs"
            )
    text = repr(_entries(names, tags)).encode()
    version = int.from_bytes(hashlib.blake2b(text, digest_size=2).digest(), "big") or 1
    needed = {name: tuple(required_channels(known[name])) for name in names}
    return RegisterMap(needed, tags, version)


def without_room(settings: Settings) -> list[str]:
    """Name the assets that have no place where the configuration lists no tags, in one line."""
    if settings.modbus_server.tags:
        return []
    left = [one.id for one in settings.assets[len(_with_room(settings)) :]]
    if not left:
        return []
    return [
        f"modbus_server: no room for {len(left)} of {len(settings.assets)} assets "
        f"({listed(left, 3)}): expected at most {MOST_ASSETS} assets and {MOST_TAGS} tags; list in "
        "modbus_server.tags those that the PLC needs"
    ]


def _with_room(settings: Settings) -> Sequence[AssetSection]:
    """The first assets of the file, as many as there is room for with their usual tags."""
    room = MOST_TAGS
    for number, asset in enumerate(settings.assets[:MOST_ASSETS]):
        room -= len(_usual(asset))
        if room < 0:
            return settings.assets[:number]
    return settings.assets[:MOST_ASSETS]


def _tag(text: str, number: int, known: Mapping[str, AssetSection]) -> MappedTag:
    asset, _, tag = text.partition("/")
    if not (re.fullmatch(ASSET_ID, asset) and _TAG.fullmatch(tag)):
        expected = "ASSET/TAG, such as 'bench-1/t_inner_ring_c.twin'"
    elif asset not in known:
        expected = f"an asset of this file ({', '.join(known) or 'it has none'})"
    else:
        return MappedTag(asset, tag)
    raise SettingsError(f"modbus_server.tags[{number}] = {text!r}: expected {expected}")


def _usual(asset: AssetSection) -> list[str]:
    """What is shown of an asset where the configuration lists no tags."""
    limited = [f"{name}.{what}" for name in asset.limits for what in _OF_A_LIMIT]
    twins = [f"{name}.twin" for name in asset.sensor_names]
    return list(dict.fromkeys((*asset.channels, *limited, *twins, *_OF_EVERY_ASSET)))


def _entries(assets: Sequence[str], tags: Sequence[MappedTag]) -> list[Entry]:
    head = [
        Entry("register", HEARTBEAT, 1, "uint16", "heartbeat", "1/s"),
        Entry("register", VERSION, 1, "uint16", "map version", ""),
        Entry("register", STATUS, 1, "bits", "status", ""),
        Entry("register", TAG_COUNT, 1, "uint16", "number of tags", ""),
        Entry("register", TIME, 2, "uint32", "time", "s since 1970 UTC"),
    ]
    for number, asset in enumerate(assets):
        name = f"{asset}/permissive"
        head.append(Entry("bit", number, 1, "bit", name, ""))
        head.append(Entry("register", PERMISSIVE + number, 1, "uint16", name, ""))
    for number, (asset, tag) in enumerate(tags):
        begin = FIRST_TAG + TAG_REGISTERS * number
        head += [
            Entry("register", begin, 2, "float32", f"{asset}/{tag}", unit_of(tag)),
            Entry("register", begin + 2, 1, "uint16", f"{asset}/{tag} quality", ""),
            Entry("register", begin + 3, 1, "uint16", f"{asset}/{tag} age", "s"),
        ]
    return head
