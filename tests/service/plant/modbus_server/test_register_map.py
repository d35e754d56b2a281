"""The map of a configuration that lists no tags: it has room for the first assets, and says so."""

import pytest
from site_files import asset_section

from service.plant import publishers
from service.plant.modbus_server.register_map import MOST_ASSETS, map_of
from service.site.configuration import SettingsError
from service.site.settings import ModbusServerSection, Settings


def site(count: int, *tags: str) -> Settings:
    channels = ("speed_rpm", "load_n", "ambient_c", "t_outer_ring_c")
    return Settings(
        assets=[asset_section(f"axle-{number}", channels) for number in range(count)],
        modbus_server=ModbusServerSection(enabled=True, tags=tags),
    )


def test_a_fleet_that_grows_keeps_its_map_and_is_warned() -> None:
    full, grown = site(MOST_ASSETS), site(MOST_ASSETS + 2)
    assert publishers.warnings(full) == []
    publishers.check_extras(grown)
    before, after = map_of(full), map_of(grown)
    assert (after.tags, after.version) == (before.tags, before.version)
    (warning,) = publishers.warnings(grown)
    assert warning == (
        "modbus_server: no room for 2 of 92 assets (axle-90, axle-91): expected at most 90 assets "
        "and 16359 tags; list in modbus_server.tags those that the PLC needs"
    )


def test_what_a_person_lists_is_refused_where_there_is_no_room() -> None:
    tags = [f"axle-{number}/speed_rpm" for number in range(MOST_ASSETS + 1)]
    assert publishers.warnings(site(MOST_ASSETS + 1, *tags)) == []
    with pytest.raises(SettingsError, match="91 assets; expected at most 90"):
        map_of(site(MOST_ASSETS + 1, *tags))
    with pytest.raises(SettingsError, match="is there twice; expected once"):
        map_of(site(2, tags[1], tags[0], tags[1]))
