"""GET measurements, on the real store."""

import asyncio
import base64
import csv
import io
import json
from typing import Any

import pyarrow.parquet as parquet
import pytest

from adapters.samples import Sample
from service.clock import from_rfc3339, rfc3339, rfc3339_exact
from service.documents.measurements import Measurements
from service.web.api.turns import HeldResponse

PATH = "/api/v1/assets/bench-1/measurements"
HOUR_US = 3_600_000_000
START_US = 1_795_248_000_000_000  # 2026-11-21T08:00:00Z
INNER, OUTER = "t_inner_ring_c", "t_outer_ring_c"


async def get(world: Any, **query: Any) -> dict[str, Any]:
    response = await world.client("viewer").get(PATH, params=query)
    assert response.status_code == 200, response.text
    document: dict[str, Any] = response.json()
    Measurements.model_validate(document)
    return document


def span(seconds: float, start_us: int = START_US) -> dict[str, str]:
    return {"start": rfc3339(start_us), "end": rfc3339(start_us + round(seconds * 1e6))}


async def test_raw_is_the_default_with_start_in_and_end_out(world: Any) -> None:
    world.write("bench-1", INNER, START_US, [60.0, 61.0, 62.0])
    document = await get(world, **span(2))
    assert document["resolution"] == "raw"
    assert document["next"] is None
    assert document["items"] == [
        {"channel": INNER, "time": rfc3339(START_US), "value": 60.0, "quality": 192},
        {"channel": INNER, "time": rfc3339(START_US + 1_000_000), "value": 61.0, "quality": 192},
    ]


async def test_bad_sample_has_no_value_but_its_quality(world: Any) -> None:
    world.write("bench-1", INNER, START_US, [float("nan")])
    (item,) = (await get(world, **span(2)))["items"]
    assert item["value"] is None
    assert item["quality"] < 64


async def test_channels_can_be_chosen(world: Any) -> None:
    for channel in (INNER, OUTER, "speed_rpm"):
        world.write("bench-1", channel, START_US, [1.0])
    items = (await get(world, channel=[OUTER, "speed_rpm", OUTER], **span(2)))["items"]
    assert [item["channel"] for item in items] == ["speed_rpm", OUTER]


async def test_channel_that_was_imported_can_be_read_though_not_configured(world: Any) -> None:
    world.write("bench-1", "t_node_3_c", START_US, [40.0])
    assert len((await get(world, channel="t_node_3_c", **span(2)))["items"]) == 1


@pytest.mark.parametrize("output", ["json", "csv"])
async def test_pages_hold_everything_once_and_in_order(world: Any, output: str) -> None:
    world.write("bench-1", INNER, START_US, list(range(10)))
    world.write("bench-1", OUTER, START_US, list(range(10)))
    client = world.client("viewer")
    times: list[tuple[str, str]] = []
    response = await client.get(PATH, params=span(60) | {"limit": 3, "format": output})
    for _ in range(7):
        if output == "json":
            rows = response.json()["items"]
        else:
            rows = list(csv.DictReader(io.StringIO(response.text)))
        times += [(row["time"], row["channel"]) for row in rows]
        if "next" not in response.links:
            break
        response = await client.get(response.links["next"]["url"])
    assert len(times) == 20
    assert times == sorted(set(times))


async def test_cursor_keeps_the_span_of_the_first_page(world: Any) -> None:
    now_us = world.clock.now_us()
    world.write("bench-1", INNER, now_us - 5_000_000, [1.0, 2.0, 3.0])
    first = await get(world, limit=2)
    second = await get(world, cursor=first["next"])
    assert [item["value"] for item in second["items"]] == [3.0]


async def test_without_a_span_the_last_hour_is_given(world: Any) -> None:
    now_us = world.clock.now_us()
    world.write("bench-1", INNER, now_us - HOUR_US - 60_000_000, [1.0])
    world.write("bench-1", INNER, now_us - HOUR_US + 60_000_000, [2.0])
    assert [item["value"] for item in (await get(world))["items"]] == [2.0]


async def test_end_alone_gives_the_hour_before_it(world: Any) -> None:
    world.write("bench-1", INNER, START_US, [1.0])
    items = (await get(world, end=rfc3339(START_US + HOUR_US)))["items"]
    assert [item["value"] for item in items] == [1.0]
    assert (await get(world, end=rfc3339(START_US + HOUR_US + 1_000)))["items"] == []


@pytest.mark.parametrize(("resolution", "buckets"), [("1s", 120), ("1min", 2), ("1h", 1)])
async def test_rollups_have_mean_extremes_and_count(
    world: Any, resolution: str, buckets: int
) -> None:
    world.write("bench-1", INNER, START_US, list(range(120)))
    document = await get(world, resolution=resolution, **span(3600))
    assert document["resolution"] == resolution
    assert len(document["items"]) == buckets
    assert sum(item["count"] for item in document["items"]) == 120
    first = document["items"][0]
    size = 120 // buckets
    assert first == {
        "channel": INNER,
        "time": rfc3339(START_US),
        "mean": (size - 1) / 2,
        "min": 0.0,
        "max": size - 1.0,
        "count": size,
        "quality": 192,
    }


async def test_auto_gives_raw_samples_while_they_are_few(world: Any) -> None:
    world.write("bench-1", INNER, START_US, list(range(1400)))
    document = await get(world, resolution="auto", **span(7 * 86400))
    assert document["resolution"] == "raw"
    assert len(document["items"]) == 1400


@pytest.mark.parametrize(("seconds", "resolution"), [(1501, "2s"), (4000, "5s"), (20_000, "15s")])
async def test_auto_gives_about_1500_rows_at_most(
    world: Any, seconds: int, resolution: str
) -> None:
    world.write("bench-1", INNER, START_US, list(range(seconds)))
    document = await get(world, resolution="auto", channel=INNER, **span(30 * 86400))
    assert document["resolution"] == resolution
    assert 500 <= len(document["items"]) <= 1501
    assert sum(item["count"] for item in document["items"]) == seconds


async def test_auto_keeps_its_choice_over_pages(world: Any) -> None:
    world.write("bench-1", INNER, START_US, list(range(4000)))
    query = {"resolution": "auto", "channel": INNER, "limit": 500} | span(86400)
    first = await get(world, **query)
    second = await get(world, **query, cursor=first["next"])
    assert first["resolution"] == second["resolution"] == "5s"
    assert second["items"][0]["time"] == rfc3339(START_US + 2_500_000_000)


async def test_every_form_of_the_answer_is_documented(world: Any) -> None:
    client = world.client("viewer")
    operation = (await client.get("/openapi.json")).json()["paths"][
        "/api/v1/assets/{asset_id}/measurements"
    ]["get"]
    documented = set(operation["responses"]["200"]["content"])
    (form,) = (one for one in operation["parameters"] if one["name"] == "format")
    given = set()
    for name in form["schema"]["enum"]:
        response = await client.get(PATH, params=span(60) | {"format": name})
        given.add(response.headers["content-type"].split(";")[0])
    assert given == documented


async def test_csv_is_long_with_an_empty_cell_for_no_value(world: Any) -> None:
    world.write("bench-1", INNER, START_US, [60.25, float("nan")])
    response = await world.client("viewer").get(PATH, params=span(60) | {"format": "csv"})
    assert response.headers["content-type"] == "text/csv; charset=utf-8"
    lines = response.text.split("\r\n")
    assert lines[:2] == [
        "time,channel,value,quality",
        "2026-11-21T08:00:00.000Z,t_inner_ring_c,60.25,192",
    ]
    assert lines[2].startswith("2026-11-21T08:00:01.000Z,t_inner_ring_c,,")
    rollup = await world.client("viewer").get(
        PATH, params=span(60) | {"format": "csv", "resolution": "1min"}
    )
    assert rollup.text.split("\r\n")[:2] == [
        "time,channel,mean,min,max,count,quality",
        "2026-11-21T08:00:00.000Z,t_inner_ring_c,60.25,60.25,60.25,1,192",
    ]


async def test_received_times_are_shown_on_request_over_pages_and_in_files(world: Any) -> None:
    samples = [
        Sample("bench-1", INNER, START_US + k * 1_000_000, 60.0 + k, 192, START_US + 10**7 + k)
        for k in range(5)
    ]
    world.store.samples.write(samples)
    expected = [rfc3339_exact(one.received_us) for one in samples]
    wanted = span(60) | {"received": "true"}
    items = (await get(world, **wanted, resolution="auto", limit="3"))["items"]
    assert items[0] == {
        "channel": INNER,
        "time": rfc3339(START_US),
        "value": 60.0,
        "quality": 192,
        "received": expected[0],
    }
    client = world.client("viewer")
    first = await client.get(PATH, params=wanted | {"limit": 3})
    second = await client.get(first.links["next"]["url"])
    found = [*first.json()["items"], *second.json()["items"]]
    assert [item["received"] for item in found] == expected
    text = (await client.get(PATH, params=wanted | {"format": "csv"})).text
    assert text.startswith("time,channel,value,quality,received\r\n")
    assert [row["received"] for row in csv.DictReader(io.StringIO(text))] == expected
    file = await client.get(PATH, params=wanted | {"format": "parquet"})
    column = parquet.read_table(io.BytesIO(file.content))["received"].cast("int64")
    assert column.to_pylist() == [one.received_us for one in samples]
    with world.store._database.writing() as connection:  # as an earlier version stored it
        connection.exec_driver_sql("UPDATE samples SET received_us = NULL")
    assert {item["received"] for item in (await get(world, **wanted))["items"]} == {None}
    text = (await client.get(PATH, params=wanted | {"format": "csv"})).text
    assert {row["received"] for row in csv.DictReader(io.StringIO(text))} == {""}
    refused = await client.get(PATH, params=wanted | {"resolution": "1min"})
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["parameter"] == "received"


async def test_csv_without_limit_is_the_whole_span(world: Any) -> None:
    world.write("bench-1", INNER, START_US, list(range(12_345)))
    response = await world.client("viewer").get(PATH, params=span(86400) | {"format": "csv"})
    values = [float(row["value"]) for row in csv.DictReader(io.StringIO(response.text))]
    assert values == [float(number) for number in range(12_345)]


async def test_json_without_limit_is_a_page(world: Any) -> None:
    world.write("bench-1", INNER, START_US, list(range(10_001)))
    document = await get(world, **span(86400))
    assert len(document["items"]) == 10_000
    assert document["next"]


@pytest.mark.parametrize(
    "cursor",
    [
        "",
        "%%%",
        "bnVsbA",
        "eyJyZXNvbHV0aW9uIjoicmF3In0",
        # a resolution that was never offered, and a start before all time
        "eyJyZXNvbHV0aW9uIjoiM3MiLCJzdGFydF91cyI6MCwiZW5kX3VzIjoxLCJjaGFubmVscyI6bnVsbH0",
        "eyJyZXNvbHV0aW9uIjoicmF3Iiwic3RhcnRfdXMiOi0xLCJlbmRfdXMiOjEsImNoYW5uZWxzIjpudWxsfQ",
    ],
)
async def test_cursor_that_is_not_ours_is_refused(world: Any, cursor: str) -> None:
    response = await world.client("viewer").get(PATH, params={"cursor": cursor})
    assert response.status_code == 422
    assert response.json()["errors"][0]["parameter"] == "cursor"


async def test_parquet_gives_the_whole_span_in_one_file(world: Any) -> None:
    world.write("bench-1", INNER, START_US, [60.0, float("nan"), 62.0])
    response = await world.client("viewer").get(PATH, params={"format": "parquet"} | span(60))
    assert response.status_code == 200
    assert response.headers["content-type"] == "application/vnd.apache.parquet"
    assert "bench-1-measurements.parquet" in response.headers["content-disposition"]
    table = parquet.read_table(io.BytesIO(response.content))
    assert table["value"].to_pylist() == [60.0, None, 62.0]
    assert table.schema.metadata[b"unit:t_inner_ring_c"].decode() == "°C"


async def test_the_small_files_of_the_page_come_packed(world: Any) -> None:
    """A page is many of them; an answer of that size that is polled is sooner sent as it is."""
    client = world.client("viewer")
    module = await client.get("/js/fleet/marks.js")
    assert module.headers["content-encoding"] == "gzip"
    assert 1024 <= len(module.content) < 4096
    answer = await client.get("/api/v1/alarms/statistics")
    assert "content-encoding" not in answer.headers


async def test_a_long_answer_comes_packed_and_in_pieces(world: Any) -> None:
    world.write("bench-1", "t_inner_ring_c", START_US, [60.0 + n for n in range(2500)])
    client = world.client("viewer")
    query = {**span(3600), "channel": "t_inner_ring_c"}
    async with client.stream("GET", PATH, params=query) as response:
        assert response.headers["content-encoding"] == "gzip"
        assert "content-length" not in response.headers
        packed = sum([len(piece) async for piece in response.aiter_raw()])
    plain = await client.get(PATH, params=query, headers={"Accept-Encoding": "identity"})
    assert "content-encoding" not in plain.headers
    assert packed < len(plain.content) / 5
    values = [item["value"] for item in plain.json()["items"]]
    assert values == [60.0 + n for n in range(2500)]
    assert plain.json()["next"] is None


async def test_a_key_has_so_many_long_reads_at_once(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, end = asyncio.Semaphore(0), asyncio.Event()
    answer = HeldResponse.__call__

    async def answer_late(response: HeldResponse, *arguments: Any) -> None:
        begun.release()
        await end.wait()
        await answer(response, *arguments)

    monkeypatch.setattr(HeldResponse, "__call__", answer_late)
    world.write("bench-1", "t_inner_ring_c", world.clock.now_us() - 3_000_000_000, [60.0] * 20_000)
    span = {"start": "2020-01-01T00:00:00Z", "end": "2040-01-01T00:00:00Z"}
    for wanted in ({"format": "csv"}, {"format": "parquet"}, {"limit": 50_000}):
        end.clear()
        asking = [
            asyncio.create_task(world.client("viewer").get(PATH, params=span | wanted))
            for _ in range(12)
        ]
        ended = asyncio.as_completed(asking)
        for refused in [await next(ended) for _ in range(4)]:
            assert refused.status_code == 503, "two of one key at once, and six that wait"
            assert "Retry-After" in refused.headers
            assert "long reads" in refused.json()["detail"]
        other = asyncio.create_task(world.client("admin").get(PATH, params=span | wanted))
        for _ in range(3):
            await begun.acquire()  # two of one key, and another key has a share of its own
        end.set()
        assert [(await one).status_code for one in (other, *ended)] == [200] * 9
        for _ in range(6):
            await begun.acquire()
        # Short reads wait for their turn instead.
        answers = await asyncio.gather(
            *(world.client("viewer").get(PATH, params=span | {"limit": 100}) for _ in range(12))
        )
        assert {one.status_code for one in answers} == {200}


@pytest.mark.parametrize("time_us", [2**63 - 1, 2**62, -1, 10**30])
@pytest.mark.parametrize("resolution", ["raw", "1s", "28d"])
async def test_a_made_up_cursor_is_refused(world: Any, time_us: int, resolution: str) -> None:
    world.write("bench-1", INNER, world.clock.now_us() - 10**7, [1.0])
    place = {
        "resolution": resolution, "start_us": 0, "end_us": 2**61, "channels": None,
        "after": [time_us, INNER],
    }  # fmt: skip
    cursor = base64.urlsafe_b64encode(json.dumps(place).encode()).decode().rstrip("=")
    for output in ("json", "csv"):
        response = await world.client("viewer").get(
            PATH, params={"cursor": cursor, "format": output}
        )
        assert response.status_code == 422
        assert response.json()["errors"][0]["parameter"] == "cursor"


async def test_the_largest_times_of_cursors_are_answered(world: Any) -> None:
    world.write("bench-1", INNER, world.clock.now_us() - 10**7, [1.0])
    for resolution in ("raw", "1s", "28d"):
        place = {
            "resolution": resolution, "start_us": 0, "end_us": 2**62 - 1, "channels": None,
            "after": [2**62 - 1, INNER],
        }  # fmt: skip
        cursor = base64.urlsafe_b64encode(json.dumps(place).encode()).decode().rstrip("=")
        response = await world.client("viewer").get(PATH, params={"cursor": cursor})
        assert response.status_code == 200, response.text
    journal = base64.urlsafe_b64encode(json.dumps({"before": 2**63 - 1}).encode()).decode()
    for path in ("/api/v1/alarms/journal", "/api/v1/audit"):
        answer = await world.client("admin").get(path, params={"cursor": journal.rstrip("=")})
        assert answer.status_code == 200, answer.text


async def test_samples_some_microseconds_apart_have_times_of_their_own(world: Any) -> None:
    start_us = (world.clock.now_us() - 10**7) // 1000 * 1000
    world.store.samples.write(
        [Sample("bench-1", INNER, start_us + 30 * k, float(k), 192, 0) for k in range(40)]
    )
    found = await get(world, start=rfc3339_exact(start_us + 30), end=rfc3339_exact(start_us + 90))
    times = [item["time"] for item in found["items"]]
    assert [from_rfc3339(text) for text in times] == [start_us + 30, start_us + 60]
    whole = await get(world, start=rfc3339_exact(start_us), limit=1)
    assert len(whole["items"][0]["time"]) == len("2026-11-21T08:00:00.000Z"), "no more than it has"
