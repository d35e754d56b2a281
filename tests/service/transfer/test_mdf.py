"""MDF 4 out and in: units, quality, times; files of others, and what cannot be used."""

import math
import random
import sys
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.samples import Sample
from service.clock import from_rfc3339
from service.store import Store
from service.transfer import mdf
from service.transfer.mdf import load_asammdf

from .conftest import Run, stored

# As the product does: a plain import fails once the CAN driver has barred the library.
asammdf = load_asammdf()


START = "2026-03-01T12:00:00.250001Z"
START_US = from_rfc3339(START)


@pytest.fixture(autouse=True, params=["whole", "in blocks"])
def blocks(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a file says does not depend on where the blocks begin in which it is read."""
    if request.param == "in blocks":
        monkeypatch.setattr(mdf, "BLOCK_RECORDS", 2)


def fill(tmp_path: Path, samples: Sequence[Sample]) -> None:
    with Store.open("", tmp_path / "data") as store:
        store.samples.write(samples)


def record(path: Path, *groups: list[Any], start: datetime | None = None) -> Path:
    """A file of another measurement system."""
    with asammdf.MDF(version="4.10") as mdf:
        mdf.header.start_time = start or datetime(2026, 3, 1, 12, tzinfo=UTC)
        for group in groups:
            mdf.append(group, common_timebase=True)
        mdf.save(path)
    return path


def signal(name: str, unit: str, values: Sequence[float], bad: Sequence[int] = ()) -> Any:
    bits = np.isin(np.arange(len(values)), bad)
    times = np.arange(len(values)) * 0.5
    return asammdf.Signal(np.array(values), times, unit=unit, name=name, invalidation_bits=bits)


def axis(tmp_path: Path, change: Callable[[Any], None], steps: Sequence[float]) -> Path:
    """A file whose axis is changed to something else."""
    path = tmp_path / "axis.mf4"
    with asammdf.MDF(version="4.10") as mdf:
        mdf.header.start_time = datetime(2026, 3, 1, 12, tzinfo=UTC)
        values = 60.0 + np.arange(len(steps))
        ring = asammdf.Signal(values, np.array(steps), unit="°C", name="t_inner_ring_c")
        mdf.append([ring], common_timebase=True)
        change(mdf.groups[0].channels[0])
        mdf.save(path, overwrite=True)
    return path


def of(**attributes: object) -> Callable[[Any], None]:
    def change(master: Any) -> None:
        for name, value in attributes.items():
            setattr(master, name, value)

    return change


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (of(sync_type=2, name="shaft", unit="rad"), "'shaft' (angle in 'rad'); expected a time"),
        (of(sync_type=3, name="way", unit="m"), "'way' (distance in 'm'); expected a time axis"),
        (of(sync_type=4, name="row", unit=""), "'row' (index); expected a time axis"),
        (of(unit="rev"), "(time in 'rev'); expected a time axis, in s"),
        (of(unit="[Ms]"), "(time in '[Ms]'); expected a time axis, in s"),
        (of(unit="[s"), "(time in '[s'); expected a time axis, in s"),
        (of(unit="msec", sync_type=0), "(no time in 'msec'); expected a time axis, in s"),
        (of(channel_type=0, sync_type=0, name="n"), "is in group 0, which has no time axis"),
    ],
)
def test_an_axis_that_is_no_time_stops_the_import(
    tmp_path: Path, run: Run, change: Callable[[Any], None], complaint: str
) -> None:
    path = axis(tmp_path, change, [0.0, 1.0, 2.0])
    mapping = tmp_path / "m.toml"
    mapping.write_text('[channels.t_inner_ring_c]\ncolumn = "t_inner_ring_c"\n')
    text = run("import", path, "--mapping", mapping)[2]
    assert complaint in text
    assert stored(tmp_path) == []


@pytest.mark.parametrize(
    ("unit", "per_s"),
    [
        *((unit, 1.0) for unit in ("", "s", "sec", "Sec", "[s]", "(sec)", "second", "Sekunden")),
        *((unit, 1e3) for unit in ("ms", "msec", "[ms]", " [ ms ] ", "milliseconds")),
        *((unit, 1e6) for unit in ("us", "µs", "usec", "[µs]")),
        *((unit, 1e9) for unit in ("ns", "nsec")),
        ("min", 1 / 60),
    ],
)
def test_the_unit_of_an_axis_counts(tmp_path: Path, run: Run, unit: str, per_s: float) -> None:
    path = axis(tmp_path, of(unit=unit), [0.0, 0.5 * per_s, 3.0 * per_s])
    assert run("import", path)[0] == 0
    noon_us = from_rfc3339("2026-03-01T12:00:00Z")
    assert [row[1] - noon_us for row in stored(tmp_path)] == [0, 500_000, 3_000_000]


def test_the_axis_of_another_group_counts_with_its_unit(tmp_path: Path, run: Run) -> None:
    """A remote master: the group has no axis, and names the group that has it."""
    path = tmp_path / "remote.mf4"
    times = np.array([0.0, 500.0, 3000.0])
    with asammdf.MDF(version="4.20") as file:
        file.header.start_time = datetime(2026, 3, 1, 12, tzinfo=UTC)
        for name in ("t_inner_ring_c", "t_outer_ring_c"):
            file.append([asammdf.Signal(40.0 + times / 1e3, times, unit="°C", name=name)])
        file.groups[0].channels[0].unit = "ms"
        group, column = file.groups[1].channel_group, file.groups[1].channels[0]
        constants = asammdf.blocks.v4_constants
        group.flags, group.cg_master_index = constants.FLAG_CG_REMOTE_MASTER, 0
        group.block_len, group.links_nr = constants.CG_RM_BLOCK_SIZE, 7
        of(channel_type=0, sync_type=0, name="speed_rpm", unit="rpm")(column)
        file.save(path)
    assert run("import", path)[0] == 0
    noon_us = from_rfc3339("2026-03-01T12:00:00Z")
    for channel in ("t_inner_ring_c", "t_outer_ring_c", "speed_rpm"):
        found = [row[1] - noon_us for row in stored(tmp_path) if row[0] == channel]
        assert found == [0, 500_000, 3_000_000]


def test_times_that_cannot_be_are_refused_by_sample(tmp_path: Path, run: Run) -> None:
    path = axis(tmp_path, of(), [0.0, math.nan, 1e300, -math.inf, 2e9, 5.0])
    status, report, text = run("import", path)
    assert (status, report["stored"], report["rejected"]) == (2, 2, 4)
    assert [one["line"] for one in report["errors"]] == [2, 3, 4, 5]
    assert "line 5: t_inner_ring_c: 2089-" in text
    assert "expected a time from 1990 to tomorrow" in text


def test_a_channel_that_stops_the_import_stops_it_before_the_first(
    tmp_path: Path, run: Run
) -> None:
    good, wrong = signal("t_inner_ring_c", "°C", [40.0]), signal("speed_rpm", "kWh", [1.0])
    assert (
        "'speed_rpm' is in 'kWh'" in run("import", record(tmp_path / "f.mf4", [good], [wrong]))[2]
    )
    assert stored(tmp_path) == []


def test_what_is_exported_can_be_imported_again(tmp_path: Path, run: Run) -> None:
    dice = random.Random(3)
    samples = [
        Sample(
            "a",
            dice.choice(["t_inner_ring_c", "speed_rpm", "phase", "t_inner_ring_c.twin"]),
            START_US + k * 137_013,
            dice.choice([dice.uniform(20, 80), math.nan]),
            dice.choice([0, 24, 64, 192, 216]),
            0,
        )
        for k in range(2000)
    ]
    fill(tmp_path, samples)
    before = stored(tmp_path)
    out = tmp_path / "out.mf4"
    assert run("export", "--out", out)[1]["rows"] == 2000
    (tmp_path / "data").rename(tmp_path / "elsewhere")
    status, report, _ = run("import", out)
    assert (status, report["stored"], report["rejected"]) == (0, 2000, 0)
    # A bad value is never sent as a number; its time and its quality are.
    assert stored(tmp_path) == [
        (name, time_us, value if quality >= 64 else None, quality)
        for name, time_us, value, quality in before
    ]
    assert run("import", out)[1]["duplicates"] == 2000
    assert run("import", out, "--dry-run")[1]["samples"] == 2000


def test_other_programs_read_units_times_and_quality(tmp_path: Path, run: Run) -> None:
    qualities = [192, 64, 12, 192]
    fill(
        tmp_path,
        [
            Sample("a", "t_inner_ring_c", START_US + k * 1_000_000, 40.0 + k, quality, 0)
            for k, quality in enumerate(qualities)
        ]
        + [Sample("a", "speed_rpm", START_US + 700_000, 1500.0, 192, 0)],
    )
    out = tmp_path / "out.mf4"
    assert run("export", "--out", out)[0] == 0
    with asammdf.MDF(out) as mdf:
        assert mdf.header.start_time == datetime(2026, 3, 1, 12, tzinfo=UTC)
        ring = mdf.get("t_inner_ring_c", ignore_invalidation_bits=True)
        assert ring.unit == "°C"
        assert np.asarray(ring.invalidation_bits).tolist() == [False, False, True, False]
        assert np.isnan(ring.samples).tolist() == [False, False, True, False]
        np.testing.assert_allclose(ring.timestamps, np.arange(4) + 0.250001, rtol=0, atol=1e-9)
        assert mdf.get("t_inner_ring_c.quality").samples.tolist() == qualities
        assert mdf.get("speed_rpm").unit == "rpm"
        # What knows the bits leaves the bad value out.
        assert mdf.get("t_inner_ring_c").samples.tolist() == [40.0, 41.0, 43.0]
    minutes = tmp_path / "minutes.mf4"
    part = ("--channel", "t_inner_ring_c", "--resolution", "1min")
    assert run("export", "--out", minutes, *part)[1]["rows"] == 1
    with asammdf.MDF(minutes) as mdf:
        assert mdf.get("t_inner_ring_c.max").samples.tolist() == [43.0]
        assert mdf.get("t_inner_ring_c.max").unit == "°C"
        assert mdf.get("t_inner_ring_c.count").samples.tolist() == [2.0]
    assert "unknown channel 't_inner_ring_c.min'" in run("import", minutes)[2]
    refused = run("export", "--out", minutes, "--resolution", "minutes")[2]
    assert "expected a name that ends in .csv" in refused


def test_a_file_of_another_system_is_mapped_and_its_units_are_ours(
    tmp_path: Path, run: Run
) -> None:
    path = record(
        tmp_path / "bench.mf4",
        [
            signal("T1", "K", [293.15, 300.0, 9.0, math.nan], bad=[2]),
            signal("noise", "V", [1.0] * 4),
        ],
        [signal("F", "kN", [1.5, 2.0, 2.5, 3.0]), signal("n", "rad/s", [100.0, math.pi, 0.0, 1.0])],
        [signal("T2", "°F", [212.0, 32.0]), signal("T3", "ohm", [100.0, 110.0])],
        [signal("T1", "degC", [1.0, 2.0])],
        start=datetime(2026, 3, 1, 13, tzinfo=timezone(timedelta(hours=1))),
    )
    mapping = tmp_path / "m.toml"
    mapping.write_text(
        '[channels.t_inner_ring_c]\ncolumn = "T1"\ngroup = 0\n'
        '[channels.load_n]\ncolumn = "F"\n[channels.speed_rpm]\ncolumn = "n"\n'
        '[channels.ambient_c]\ncolumn = "T2"\n'
        '[channels.t_node_5_c]\ncolumn = "T3"\nscale = 2.5\noffset = -250\n'
    )
    status, report, _ = run("import", path, "--mapping", mapping)
    assert (status, report["stored"]) == (0, 15)
    assert report["conversions"] == [
        "t_inner_ring_c: 'K' - 273.15 -> °C",
        "load_n: 'kN' × 1000 -> N",
        "speed_rpm: 'rad/s' × 9.549296586 -> rpm",
        "ambient_c: '°F' × 0.5555555556 - 17.77777778 -> °C",
        "t_node_5_c: 'ohm' × 2.5 - 250 -> °C (scale and offset of the mapping)",
    ]
    zero_us = from_rfc3339("2026-03-01T12:00:00Z")
    rows = {(name, (time_us - zero_us) // 500_000): (value, quality)
            for name, time_us, value, quality in stored(tmp_path)}  # fmt: skip
    assert rows["t_inner_ring_c", 0] == (pytest.approx(20.0), 192)
    # An invalid value is stored as bad without its number; a valid one that is none is missing.
    assert rows["t_inner_ring_c", 2] == (None, 0)
    assert ("t_inner_ring_c", 3) not in rows
    assert rows["load_n", 0] == (1500.0, 192)
    assert rows["speed_rpm", 1] == (pytest.approx(30.0), 192)
    assert rows["ambient_c", 0] == (pytest.approx(100.0), 192)
    assert rows["t_node_5_c", 1] == (pytest.approx(25.0), 192)


@pytest.mark.parametrize(
    ("mapping", "said"),
    [
        ('[channels.t_inner_ring_c]\ncolumn = "T1"', "'T1' is in the groups 0, 1; expected"),
        ('[channels.t_inner_ring_c]\ncolumn = "T1"\ngroup = 7', "channels.t_inner_ring_c.group"),
        ('[channels.ambient_c]\ncolumn = "p"', "'p' is in 'bar'; expected °C, K, °F for ambient_c"),
        ('[channels.ambient_c]\ncolumn = "gear"', "channel 'gear' holds no numbers"),
        ('[channels.ambient_c]\ncolumn = "T9"', "missing channel 'T9'; the mapping names T9"),
        ('[time]\ncolumn = "t"\n[channels.ambient_c]\ncolumn = "p"', "a mapping without [time]"),
        (None, "unknown channel 'T1'; expected speed_rpm, load_n"),
    ],
)
def test_a_channel_that_cannot_be_used_is_named_and_nothing_is_stored(
    tmp_path: Path, run: Run, mapping: str | None, said: str
) -> None:
    times = np.arange(2) * 0.5
    gears = asammdf.Signal(np.array([b"first", b"idle"]), times, name="gear", encoding="utf-8")
    path = record(
        tmp_path / "bench.mf4",
        [signal("T1", "K", [293.15, 300.0])],
        [signal("T1", "K", [293.15, 300.0])],
        [signal("p", "bar", [1.0, 2.0]), gears],
    )
    options = []
    if mapping is not None:
        (tmp_path / "m.toml").write_text(mapping)
        options = ["--mapping", tmp_path / "m.toml"]
    status, _, text = run("import", path, *options)
    assert status == 2
    assert said in text
    assert stored(tmp_path) == []


def test_impossible_values_are_told_with_their_number(tmp_path: Path, run: Run) -> None:
    path = record(tmp_path / "bench.mf4", [signal("ambient_c", "°C", [20.0, 3276.7, 21.0])])
    status, report, text = run("import", path)
    assert (status, report["stored"], report["rejected"]) == (2, 2, 1)
    assert "line 2: ambient_c = 3276.7: expected -100 to 500" in text


def test_a_time_of_no_zone_is_asked_for(tmp_path: Path, run: Run) -> None:
    path = record(
        tmp_path / "local.mf4",
        [signal("ambient_c", "", [20.0, 21.0])],
        start=datetime(2026, 3, 1, 12),
    )
    assert "of an unknown time zone; expected --start" in run("import", path)[2]
    assert run("import", path, "--start", START)[0] == 0
    assert [row[1] for row in stored(tmp_path)] == [START_US, START_US + 500_000]


class _NotInstalled:
    """Finds no asammdf."""

    def find_spec(self, name: str, *_: object) -> None:
        if name == "asammdf":
            raise ModuleNotFoundError(name)


def test_a_file_that_is_none_and_a_missing_library_are_one_line(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = record(tmp_path / "bench.mf4", [signal("ambient_c", "°C", [20.0] * 1000)])
    whole = path.read_bytes()
    for content, said in (
        (b"time,ambient_c\n", "not a finished MDF 3 or MDF 4 file"),
        (b"", "not a finished MDF 3 or MDF 4 file"),
        (b"UnFinMF " + whole[8:], "not a finished MDF 3 or MDF 4 file"),
        (whole[:100], "damaged MDF file (cut off at 100 bytes)"),
        (whole[:200], "damaged MDF file (cut off at 200 bytes)"),
        (whole[: len(whole) // 2], "damaged MDF file"),
    ):
        path.write_bytes(content)
        status, _, text = run("import", path)
        assert (status, said in text) == (2, True), text
    assert "cannot be read" in run("import", tmp_path / "none.mf4")[2]
    monkeypatch.setattr(sys, "meta_path", [_NotInstalled(), *sys.meta_path])
    monkeypatch.delitem(sys.modules, "asammdf")
    for command in (("import", path), ("export", "--out", tmp_path / "out.mf4")):
        assert run(*command)[2] == "MDF 4 needs asammdf: pip install 'bearing-twin[mdf]'"
    assert not (tmp_path / "out.mf4").exists()


def test_an_older_file_is_known_by_its_first_bytes(tmp_path: Path, run: Run) -> None:
    file = tmp_path / "old.mdf"
    with asammdf.MDF(version="3.30") as mdf:
        mdf.append([signal("t_inner_ring_c", "K", [300.0, 301.0])], common_timebase=True)
        mdf.save(file)
    status, _, error = run("import", file)
    assert status == 2
    assert error == "old.mdf: MDF 3.30 knows no time zone; expected --start with the time of 0 s"
    status, report, _ = run("import", file, "--start", START)
    assert (status, report["stored"]) == (0, 2)
    assert [(time, value) for _, time, value, _ in stored(tmp_path)] == [
        (START_US, pytest.approx(26.85)),
        (START_US + 500_000, pytest.approx(27.85)),
    ]
    cut = tmp_path / "cut.dat"
    cut.write_bytes(file.read_bytes()[:100])
    status, _, error = run("import", cut, "--start", START)
    assert (status, error) == (2, "cut.dat: damaged MDF file (cut off at 100 bytes)")


def test_two_channels_of_one_name_in_one_group_are_told_apart_by_their_index(
    tmp_path: Path, run: Run
) -> None:
    first, second = signal("T_IR", "°C", [40.0, 41.0]), signal("T_IR", "°C", [50.0, 51.0])
    file = record(tmp_path / "two.mf4", [first, second])
    mapping = tmp_path / "m.toml"
    lines = '[channels.t_inner_ring_c]\ncolumn = "T_IR"\n'
    for given in ("", "group = 0\n"):
        mapping.write_text(lines + given)
        status, _, error = run("import", file, "--mapping", mapping)
        assert status == 2
        assert error == (
            "two.mf4: channel 'T_IR' is in the groups 0 (index 1), 0 (index 2); expected "
            "channels.t_inner_ring_c.group and index = one of them"
        )
    mapping.write_text(lines + "group = 0\nindex = 2\n")
    assert run("import", file, "--mapping", mapping)[1]["stored"] == 2
    assert [value for _, _, value, _ in stored(tmp_path)] == [50.0, 51.0]
    named = record(tmp_path / "named.mf4", [signal("speed_rpm", "rpm", [1.0])] * 2)
    status, _, error = run("import", named)
    assert (status, error) == (
        2,
        "named.mf4: channel 'speed_rpm' is in group 0 several times (index 1, 2); expected a "
        "mapping with group and index",
    )


def test_times_that_step_back_leave_no_value_unsaid(tmp_path: Path, run: Run) -> None:
    times = np.array([0.0, 1.0, 2.0, 1.0, 2.0, 3.0])
    values = np.array([20.0, 21.0, 22.0, 91.0, 22.0, 23.0])
    file = record(
        tmp_path / "back.mf4", [asammdf.Signal(values, times, unit="°C", name="t_inner_ring_c")]
    )
    status, report, error = run("import", file)
    assert (status, report["stored"], report["duplicates"], report["rejected"]) == (2, 4, 1, 1)
    assert report["errors"] == [
        {
            "line": 4,
            "detail": "t_inner_ring_c = 91 at 2026-03-01T12:00:01.000Z: same time, another "
            "value: not taken; 21 is stored",
        }
    ]
    assert "line 4: t_inner_ring_c = 91" in error
