"""Values in another unit are noticed by what no machine has, with the guess."""

import numpy as np
import pytest

from service.site.machines.bearings import named_bearing
from service.site.machines.plausibility import doubts_of_rows, doubts_of_values

BEARING = named_bearing("6311", {})
TIME_S = np.arange(270) * 60.0
RING, OTHER = "t_inner_ring_c", "t_outer_ring_c"


def said(**values: float) -> list[tuple[str, str]]:
    return [(one.text, one.weight) for one in doubts_of_values(BEARING, values)]


def of_rows(time_s: np.ndarray = TIME_S, **changes: float) -> list[tuple[str, str]]:
    values = {"speed_rpm": 1500.0, "load_n": 2650.0, "ambient_c": 23.0, RING: 40.0, OTHER: 38.0}
    columns = {name: np.full(270, value) for name, value in (values | changes).items()}
    return [(one.text, one.weight) for one in doubts_of_rows(BEARING, columns, time_s)]


def test_values_of_a_machine_raise_no_doubt() -> None:
    for speed_rpm, load_n, ambient_c in ((1500, 2650, 23), (0, 0, -40), (5, 0, 59), (-900, 100, 5)):
        assert said(speed_rpm=speed_rpm, load_n=load_n, ambient_c=ambient_c) == []
    assert of_rows() == []


@pytest.mark.parametrize(
    ("values", "text", "weight"),
    [
        (
            {"speed_rpm": 1500.0, "load_n": 2.65},
            "load_n: 2.65 at 1500 rpm; expected 45 N or more, 0.1 % of the static load rating; kN?",
            "not accepted",
        ),
        (
            {"speed_rpm": 1500.0, "load_n": 0.0},
            "load_n: 0 at 1500 rpm; expected 45 N or more, 0.1 % of the static load rating; "
            "no load, or not measured?",
            "said",
        ),
        ({"ambient_c": 296.15}, "ambient_c: 296.1; expected -60 to 60 °C; kelvin?", "refused"),
        ({"ambient_c": 73.4}, "ambient_c: 73.4; expected -60 to 60 °C; °F?", "said"),
        ({"ambient_c": 120.0}, "ambient_c: 120.0; expected -60 to 60 °C; °F?", "refused"),
        (
            {"ambient_c": -70},
            "ambient_c: -70.0; expected -60 to 60 °C; not measured there?",
            "refused",
        ),
    ],
)
def test_a_value_in_another_unit_is_said_with_the_guess(
    values: dict[str, float], text: str, weight: str
) -> None:
    assert said(**values) == [(text, weight)]


def test_nothing_is_known_of_the_load_on_a_network_of_ones_own() -> None:
    assert doubts_of_values(None, {"speed_rpm": 1500.0, "load_n": 0.0}) == []
    (hot,) = doubts_of_values(None, {"ambient_c": 296.15})
    assert hot.weight == "said"


def test_rows_are_judged_while_the_machine_turns() -> None:
    columns = {"speed_rpm": np.zeros(270), "load_n": np.zeros(270), "ambient_c": np.full(270, 23.0)}
    assert doubts_of_rows(BEARING, columns, TIME_S) == []
    columns["speed_rpm"][200:] = 1500.0
    columns["load_n"][200:] = 2.65
    columns["load_n"][200:210] = np.nan
    (doubt,) = doubts_of_rows(BEARING, columns, TIME_S)
    assert (doubt.channel, doubt.weight) == ("load_n", "not accepted")


def test_a_machine_may_idle_for_most_of_its_time_and_turn_either_way() -> None:
    speed_rpm = np.where(np.arange(270) % 2, 1500.0, -1500.0)
    load_n = np.where(np.arange(270) < 160, 20.0, 2650.0)
    columns = {"speed_rpm": speed_rpm, "load_n": load_n, "ambient_c": np.full(270, 23.0)}
    assert doubts_of_rows(BEARING, columns, TIME_S) == []
    columns["load_n"] = load_n / 1000.0
    (doubt,) = doubts_of_rows(BEARING, columns, TIME_S)
    assert (doubt.channel, doubt.weight) == ("load_n", "not accepted")


def test_rings_alone_in_kelvin_are_refused() -> None:
    ((text, weight),) = of_rows(**{OTHER: 311.15})
    assert text == f"{OTHER}: 311.1 and more; expected a start below 200 °C; kelvin?"
    assert weight == "refused"
    assert of_rows(**{OTHER: 190.0}) == []


@pytest.mark.parametrize(
    ("scale", "text", "weight"),
    [
        (1000.0, "time_s: rows 60000 s apart, 16.7 h; expected minutes; ms?", "refused"),
        (1e6, "time_s: rows 6e+07 s apart, 16666.7 h; expected minutes", "refused"),
        (1 / 60, "time_s: all rows within 269 s; expected hours; minutes?", "said"),
    ],
)
def test_times_in_another_unit_are_said_with_the_guess(
    scale: float, text: str, weight: str
) -> None:
    assert of_rows(TIME_S * scale) == [(text, weight)]
