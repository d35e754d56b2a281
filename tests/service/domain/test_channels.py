"""The table of standard channels, and the places that take theirs from it."""

import pytest

from service.domain.channels import (
    CHANNEL_NEEDS,
    CONTROLLER_CHANNELS,
    OPERATING_CHANNELS,
    RING_SENSORS,
    STANDARD,
    importance,
    label,
    unit_of,
)
from service.site.asset_section import ControllerSection
from service.web.pages import channels as pages


@pytest.mark.parametrize(
    ("name", "said", "unit"),
    [
        ("speed_rpm", "Speed", "rpm"),
        ("load_setpoint_n", "Load set-point", "N"),
        ("ambient_c", "Ambient", "°C"),
        ("t_inner_ring_c", "Inner ring", "°C"),
        ("t_outer_ring_c", "Outer ring", "°C"),
        ("t_node_7_c", "Node 7", "°C"),
        ("load_n", "Load", "N"),
        ("phase", "Phase", ""),
        ("t_gearbox_oil_c", "Gearbox oil", "°C"),
        ("fan_current", "Fan current", ""),
    ],
)
def test_a_channel_has_one_name_for_people_and_one_unit(name: str, said: str, unit: str) -> None:
    assert (label(name), unit_of(name)) == (said, unit)
    assert unit_of(f"{name}.twin") == unit
    assert unit_of(f"{name}.time_to_alarm_s") == "s"


def test_the_units_of_the_table_are_those_of_the_names() -> None:
    assert {one.name: one.unit for one in STANDARD} == {
        one.name: unit_of(one.name) for one in STANDARD
    }


def test_a_full_spool_gives_up_what_can_be_had_again_first() -> None:
    ranks = {name: importance(name) for name in ("t_node_7_c", "phase", "no_such_channel")}
    assert set(ranks.values()) == {1}
    assert {importance(name) for name in RING_SENSORS} == {3}
    assert {importance(name) for name in OPERATING_CHANNELS} == {2}
    assert importance("t_inner_ring_c.twin") == 0


def test_the_controller_has_the_channels_of_the_table_and_a_plan() -> None:
    assert set(ControllerSection.model_fields) == {*CONTROLLER_CHANNELS, "plan"}


def test_what_is_needed_is_in_the_table() -> None:
    needed = {one.channel for one in CHANNEL_NEEDS if one.need != "optional"}
    assert needed - {"a temperature"} == set(OPERATING_CHANNELS)


def test_the_dashboard_has_the_same_table() -> None:
    told = "run python -m service.web.pages.channels"
    assert pages.FILE.read_text(encoding="utf-8") == pages.module(), told
