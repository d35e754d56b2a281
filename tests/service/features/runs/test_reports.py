"""A report says what is in the store, in the same bytes for the same data."""

import csv
import io
from datetime import UTC, datetime
from zoneinfo import ZoneInfo

import numpy as np
from matplotlib.image import imread

from service.features.runs.report.contents import Report, contents
from service.features.runs.report.files import FORMATS, report_file
from service.features.runs.report.tables import (
    Moment,
    csv_bytes,
    heading,
    moment,
    printed,
    tables,
    wrapped,
)
from service.features.runs.runs import Run, Runs
from service.site.asset_section import AssetSection
from service.store import Store
from tests.service.features.runs.conftest import NOBODY, START_US, US

Machine = tuple[Store, AssetSection]
NOW_US = START_US + 3 * 3600 * US


def the_run(machine: Machine) -> Run:
    store, asset = machine
    store.part(Runs).refresh(asset.id, NOW_US)
    (run,) = store.part(Runs).page(asset.id, 10).items
    return run


def made(machine: Machine) -> Report:
    store, asset = machine
    return contents(store, asset, the_run(machine), NOW_US)


def test_the_same_data_give_the_same_bytes_at_any_time(machine: Machine) -> None:
    store, asset = machine
    run = the_run(machine)
    for format in FORMATS:
        file = report_file(store, asset, run, format, NOW_US)
        assert file == report_file(store, asset, run, format, NOW_US + 12345 * US)
        assert len(file) < 2_000_000
    assert report_file(store, asset, run, "pdf", NOW_US).startswith(b"%PDF-")
    pixels = imread(io.BytesIO(report_file(store, asset, run, "png", NOW_US)))
    assert np.mean(pixels < 0.5) > 0.005, "something is drawn"
    store.part(Runs).rename(asset.id, run.id, "run-in", NOBODY)
    named = the_run(machine)
    assert report_file(store, asset, named, "csv", NOW_US) != report_file(
        store, asset, run, "csv", NOW_US
    )
    store.part(Runs).rename(asset.id, run.id, "", NOBODY)


def test_it_tells_of_everything_that_happened(machine: Machine) -> None:
    report = made(machine)
    inner = report.curves["t_inner_ring_c"]
    assert inner.peak is not None
    assert 81 < inner.peak < 83
    assert inner.longest_gap_s == 300
    assert abs(inner.good_share - 115 / 120) < 1e-9
    assert report.curves["t_outer_ring_c"].good_share == 1
    (alarm,) = report.alarms
    assert (alarm.raised_us, alarm.acknowledged_by) == (START_US + 2400 * US, NOBODY)
    assert alarm.returned_us == START_US + 7140 * US
    leads = {line.lead_time_s: line.scores for line in report.forecasts}
    assert leads[1800].n == sum(at + 1800 <= 7200 for at in range(0, 7200, 600))
    assert (leads[3600].coverage_95, round(leads[3600].bias_k, 2)) == (1.0, 0.2)
    assert report.ahead is not None
    assert report.ahead.lead_time_s == 3600
    assert [one.version for one in report.models] == [1]
    assert len(report.annotations) == 3


def test_local_time_stands_next_to_utc_on_paper_also_where_the_zone_changes(
    machine: Machine,
) -> None:
    summer_us, winter_us = (
        int(datetime(2026, 10, 25, hour, 30, tzinfo=UTC).timestamp()) * US for hour in (0, 1)
    )
    assert moment(summer_us, "Europe/Berlin") == "2026-10-25 00:30 (02:30)"
    assert moment(winter_us, "Europe/Berlin") == "2026-10-25 01:30 (02:30)"
    store, asset = machine
    run = the_run(machine)
    local = contents(store, asset, run, NOW_US, "Europe/Berlin")
    start = datetime.fromtimestamp(START_US / US, ZoneInfo("Europe/Berlin"))
    cells = dict(heading(local))
    assert printed(cells["Start"], 0).endswith(f" ({start:%H:%M})")
    (titles, *_) = [[column.title for column in table.columns] for table in tables(local)]
    assert "At UTC (local)" in titles
    moments = [
        cell
        for table in tables(local)
        for row in table.rows
        for cell in row
        if isinstance(cell, Moment)
    ]
    assert len(moments) > 5
    assert {one.time_zone for one in moments} == {"Europe/Berlin"}
    # A program reads the CSV: in UTC, whatever the zone.
    assert csv_bytes(local) == report_file(store, asset, run, "csv", NOW_US)
    assert report_file(store, asset, run, "pdf", NOW_US, "Europe/Berlin") != report_file(
        store, asset, run, "pdf", NOW_US
    )


def test_red_is_drawn_for_what_is_over_a_limit_alone(machine: Machine) -> None:
    """As on the page: measured lines are black, forecasts blue, and red is an alarm."""
    store, asset = machine

    def reds(asset: AssetSection) -> int:
        image = imread(io.BytesIO(report_file(store, asset, the_run(machine), "png", NOW_US)))
        red, green = image[..., 0], image[..., 1]
        return int(np.sum((red > green + 0.3) & (image[..., 2] < red)))

    assert reds(asset) > 0
    far = {"t_inner_ring_c": {"warning": 150, "alarm": 200}}
    far["t_outer_ring_c"] = far["t_inner_ring_c"]
    table = asset.model_dump(exclude={"limits", "network", "bearing", "alarms"})
    assert reds(AssetSection.model_validate(table | {"bearing": "6311", "limits": far})) == 0


def test_the_csv_says_the_same_and_holds_no_formula(machine: Machine) -> None:
    store, asset = machine
    text = report_file(store, asset, the_run(machine), "csv", NOW_US).decode("utf-8-sig")
    rows = list(csv.reader(io.StringIO(text)))
    parts = dict.fromkeys(row[0] for row in rows)
    assert list(parts) == ["Run", *(table.title for table in tables(made(machine)))]
    assert '\'=HYPERLINK("x") \u0007 new belt' in [cell for row in rows for cell in row]
    assert not [cell for row in rows for cell in row if cell[:1] in ("=", "@")]
    peak = next(row for row in rows if row[1] == "Inner ring" and row[3] == "°C")
    assert float(peak[7]) < 0, "it was over its alarm limit"


def test_a_run_without_anything_but_speed_has_a_report_too(machine: Machine) -> None:
    store, _ = machine
    table = machine[1].model_dump(exclude={"network", "bearing", "alarms"}) | {"bearing": "6311"}
    asset = AssetSection.model_validate(table | {"id": "empty"})
    run = Run("empty", "x", START_US, None, "", "name\u2028\u0000 with $\\frac$ 軸受", "nobody")
    for format in FORMATS:
        assert report_file(store, asset, run, format, START_US + 600 * US)


def test_long_words_are_cut() -> None:
    assert list(wrapped("a " + "x" * 25 + " b", 10)) == ["a", "x" * 10, "x" * 10, "xxxxx b"]
