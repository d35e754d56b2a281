"""Units that a source states are turned into those of the channels, or refused by name."""

import struct
from pathlib import Path

import pytest

from adapters.configuration import ConfigurationError
from adapters.drivers.can.binding import bind
from adapters.drivers.can.config import CanChannel, CanSource
from adapters.drivers.replay.config import ReplayChannel, ReplaySource
from adapters.drivers.replay.driver import check
from adapters.protocol import ChannelBinding
from adapters.samples import Quality
from adapters.units import into_unit, kelvin_doubt, unit_in
from service.domain.channels import unit_of

DBC = """VERSION ""
BU_: DRIVE TWIN
BO_ 256 Bench: 8 DRIVE
 SG_ Value : 0|16@1+ (0.01,0) [0|600] "{unit}" TWIN
"""


def decoded(tmp_path: Path, channel: str, stated: str, raw: int, **keys: object) -> float:
    """Decode one frame of a signal in a unit for a channel."""
    path = tmp_path / "bench.dbc"
    path.write_text(DBC.format(unit=stated), encoding="cp1252")
    source = CanSource.model_validate({"name": "drive", "channel": "c", "dbc": path})
    config = CanChannel.model_validate(
        {"source": "drive", "message": "Bench", "signal": "Value", **keys}
    )
    (message,) = bind(source, [ChannelBinding("a", channel, config, unit_of(channel))]).values()
    (sample,) = message.decode(struct.pack("<H6x", raw), 1_000)
    assert sample.quality == Quality.GOOD
    return sample.value


@pytest.mark.parametrize(
    ("channel", "unit", "raw", "value"),
    [
        ("ambient_c", "K", 29615, 23.0),
        ("t_inner_ring_c", "Kelvin", 31315, 40.0),
        ("t_inner_ring_c", "°F", 10400, 40.0),
        ("t_inner_ring_c", "deg F", 10400, 40.0),
        ("t_inner_ring_c", "°C", 4000, 40.0),
        ("t_inner_ring_c", "deg_C", 4000, 40.0),
        ("load_n", "kN", 265, 2650.0),
        ("load_n", "N", 26500, 265.0),
        ("load_n", "", 26500, 265.0),
        ("speed_rpm", "1/s", 2500, 1500.0),
        ("speed_rpm", "RPM", 15000, 150.0),
        ("i_rms_a", "kA", 100, 1.0),
    ],
)
def test_a_signal_is_turned_from_the_unit_of_its_file(
    tmp_path: Path, channel: str, unit: str, raw: int, value: float
) -> None:
    assert decoded(tmp_path, channel, unit, raw) == pytest.approx(value)


def test_a_signal_in_a_unit_of_another_quantity_is_refused_unless_the_file_is_wrong(
    tmp_path: Path,
) -> None:
    expected = (
        r"channel a/load_n: signal 'Value' is in 'V'; expected N, daN, kN, lbf, "
        r'or unit = "N" where the DBC file is wrong'
    )
    with pytest.raises(ConfigurationError, match=expected):
        decoded(tmp_path, "load_n", "V", 265)
    assert decoded(tmp_path, "load_n", "V", 265, unit="N") == pytest.approx(2.65)
    assert decoded(tmp_path, "load_n", "N", 265, unit="kN") == pytest.approx(2650.0)
    with pytest.raises(ConfigurationError, match="unit 'bar'; expected N, daN"):
        decoded(tmp_path, "load_n", "N", 265, unit="bar")


def test_limits_of_the_file_are_in_its_unit_and_those_of_the_channel_in_ours(
    tmp_path: Path,
) -> None:
    assert decoded(tmp_path, "ambient_c", "K", 29615, valid_range=[-40, 80]) == pytest.approx(23.0)


@pytest.mark.parametrize(
    ("heading", "channel", "unit"),
    [
        ("Load [kN]", "load_n", "kN"),
        ("Load (kN)", "load_n", "kN"),
        ("Load [bar]", "load_n", "bar"),
        ("Temperature (inner)", "t_inner_ring_c", ""),
        ("Temperature (K) ", "t_inner_ring_c", "K"),
        ("Temperature [2]", "t_inner_ring_c", ""),
        ("Temperature [°F]", "t_inner_ring_c", "°F"),
        ("kN", "load_n", ""),
        ("Load [kN] raw", "load_n", ""),
        ("Load [%]", "load_n", "%"),
        ("Load (%)", "load_n", "%"),
        ("Outer ring (F)", "t_outer_ring_c", ""),
        ("Outer ring (°F)", "t_outer_ring_c", "°F"),
    ],
)
def test_a_heading_states_a_unit_at_its_end(heading: str, channel: str, unit: str) -> None:
    assert unit_in(heading, unit_of(channel)) == unit


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [
        ("°C", "ºC", 1.0),
        ("°C", "degree_Celsius", 1.0),
        ("°C", "degrees Celsius", 1.0),
        ("°C", "\N{DEGREE CELSIUS}", 1.0),
        ("°C", "øC", 1.0),
        ("°C", "°K", 1.0),
        ("rpm", "min⁻¹", 1.0),
        ("rpm", "s⁻¹", 60.0),
        ("rpm", "r.p.m.", 1.0),
        ("N", "newtons", 1.0),
        ("rpm", "Hz", None),
        ("N", "MN", None),
        ("N", "N/mm2", None),
        ("N", "Nm", None),
        ("°C", "mK", None),
    ],
)
def test_a_unit_is_known_as_people_write_it(ours: str, theirs: str, expected: float | None) -> None:
    found = into_unit(ours, theirs)
    assert (found if found is None else found[0]) == expected


def test_what_has_no_unit_of_ours_is_taken_as_it_is() -> None:
    assert into_unit("", "furlong") == (1.0, 0.0)
    assert into_unit("°C", " ") == (1.0, 0.0)
    assert into_unit("°C", "V") is None


@pytest.mark.parametrize(
    ("heading", "ours", "is_doubtful"),
    [
        ("TC3 (K)", "°C", True),
        ("NiCr-Ni 4 (K)", "°C", True),
        ("Thermoelement 2 (k)", "°C", True),
        ("TC3 [K]", "°C", False),
        ("TC3 (°C)", "°C", False),
        ("TC3 (J)", "°C", False),
        ("Temperature (K)", "°C", False),
        ("Catch tank (K)", "°C", False),
        ("Typical (K)", "°C", False),
        ("Outer ring, type-K (K)", "°C", True),
        ("Bearing type 6205 outer ring (K)", "°C", False),
        ("T case Tc (K)", "°C", False),
        ("TE101 (K)", "°C", False),
        ("TC3 (K)", "N", False),
    ],
)
def test_a_type_of_thermocouple_may_look_like_a_unit(
    heading: str, ours: str, is_doubtful: bool
) -> None:
    plain = ReplayChannel.model_validate({"source": "old", "column": heading})
    scaled = ReplayChannel.model_validate({"source": "old", "column": heading, "scale": 1.0})
    assert bool(kelvin_doubt(plain, ours, heading)) == is_doubtful
    assert not kelvin_doubt(scaled, ours, heading)


def test_a_replayed_column_of_a_thermocouple_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time_s,TC3 (K)\n0,240\n")
    source = ReplaySource.model_validate({"name": "old", "file": path})
    config = ReplayChannel.model_validate({"source": "old", "column": "TC3 (K)"})
    wanted = r"column 'TC3 \(K\)': \(K\) is kelvin or the type of a thermocouple; expected"
    with pytest.raises(ConfigurationError, match=wanted):
        check(source, [ChannelBinding("a", "ambient_c", config, "°C")], [])


def test_a_replayed_column_in_a_unit_of_another_quantity_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time_s,Load [bar]\n0,1\n")
    source = ReplaySource.model_validate({"name": "old", "file": path})

    def bound(**keys: object) -> list[ChannelBinding]:
        config = ReplayChannel.model_validate({"source": "old", "column": "Load [bar]", **keys})
        return [ChannelBinding("a", "load_n", config, "N")]

    with pytest.raises(ConfigurationError, match=r"column 'Load \[bar\]' is in 'bar'; expected N"):
        check(source, bound(), [])
    check(source, bound(scale=200.0), [])
