"""Pushes of gateways that speak for many assets: JSON, and InfluxDB's line protocol."""

import gzip
import json
from typing import Any

import httpx2
import pytest

from adapters.samples import Sample
from service.bus.asking import caller_role
from service.clock import rfc3339
from service.documents.measurements import Pushed
from service.features.gateways.judging import JudgedPush
from service.store import Retention
from service.web.api.own_writes import OwnWrites

MANY = "/api/v1/measurements"
WRITE = "/api/v1/write"
INNER = "t_inner_ring_c"


def sample(world: Any, seconds_ago: float = 0, **changes: Any) -> dict[str, Any]:
    time_us = world.clock.now_us() - round(seconds_ago * 1e6)
    whole = {"asset": "rig-2", "channel": INNER, "time": rfc3339(time_us), "value": 60.0}
    return whole | changes


async def push(world: Any, *samples: Any) -> Pushed:
    response = await world.client("gateway").post(MANY, json={"samples": samples})
    assert response.status_code == 200, response.text
    return Pushed.model_validate(response.json())


async def write(world: Any, *lines: str, role: str = "gateway", **options: Any) -> Any:
    headers = {"Content-Type": "text/plain; charset=utf-8"} | options.pop("headers", {})
    content = options.pop("content", "\n".join(lines).encode())
    return await world.client(role).post(WRITE, content=content, headers=headers, params=options)


def stored(world: Any, asset: str = "rig-2") -> list[tuple[str, float | None, int]]:
    now_us = world.clock.now_us()
    rows = world.store.samples.read(asset, None, 0, now_us + 10**12, 100)
    return [(row.channel, row.value, row.quality) for row in rows]


async def test_each_sample_is_judged_for_its_asset(world: Any) -> None:
    answer = await push(
        world,
        sample(world, 1),
        sample(world, asset="no-such"),
        sample(world, asset=7),
        sample(world, asset="bench-1"),
        sample(world, channel="nowhere"),
        "no object",
        sample(world, channel="ambient_c", value=21, quality=80),
    )
    assert (answer.accepted, answer.duplicates) == (2, 0)
    details = {one.index: one.detail for one in answer.rejected}
    assert sorted(details) == [1, 2, 3, 4, 5]
    assert details[1].startswith("asset 'no-such': not followed here")
    assert "'pt100' and takes no pushes" in details[3]
    assert "pushed channels are: t_inner_ring_c, ambient_c" in details[4]
    assert '"asset", "channel"' in details[5]
    assert stored(world) == [(INNER, 60.0, 192), ("ambient_c", 21.0, 80)]
    assert [(one.asset, one.channel) for one in world.taken] == [
        ("rig-2", INNER),
        ("rig-2", "ambient_c"),
    ]


async def test_the_same_again_changes_nothing_whichever_way_it_comes(world: Any) -> None:
    first = sample(world, 5)
    await push(world, first)
    one_asset = "/api/v1/assets/rig-2/measurements"
    again = [{name: first[name] for name in ("channel", "time", "value")}]
    response = await world.client("gateway").post(one_asset, json={"samples": again})
    assert response.json()["duplicates"] == 1
    assert (await push(world, first, first | {"value": 99.0})).duplicates == 2
    assert stored(world) == [(INNER, 60.0, 192)]


async def test_samples_in_any_order_reach_the_store_and_the_twin_in_order(world: Any) -> None:
    samples = [sample(world, seconds, value=seconds) for seconds in (3, 1, 2, 5, 4)]
    assert (await push(world, *samples)).accepted == 5
    assert [one.value for one in world.taken] == [5, 4, 3, 2, 1]


async def test_twenty_thousand_compressed_samples_in_one_call(world: Any) -> None:
    begin_us = world.clock.now_us() - 40_000_000
    samples = [
        sample(world) | {"time": rfc3339(begin_us + n * 1000), "value": n} for n in range(20_000)
    ]
    body = gzip.compress(json.dumps({"samples": samples}).encode())
    headers = {"Content-Type": "application/json", "Content-Encoding": "gzip"}
    response = await world.client("gateway").post(MANY, content=body, headers=headers)
    assert response.status_code == 200, response.text
    assert response.json() == {"accepted": 20_000, "duplicates": 0, "rejected": []}
    response = await world.client("gateway").post(MANY, json={"samples": [1] * 20_001})
    assert response.status_code == 422
    assert "/samples" in {error["pointer"] for error in response.json()["errors"]}


async def test_what_is_too_old_is_rejected_and_counted(world: Any) -> None:
    day_s = 86_400
    await push(world, sample(world, 50 * day_s), sample(world, 1))
    world.store.rollups.expire(Retention(raw_days=10.0), world.clock.now_us())
    answer = await push(world, sample(world, 60 * day_s), sample(world))
    assert (answer.accepted, [one.index for one in answer.rejected]) == (1, [0])
    assert "too old, history before" in answer.rejected[0].detail
    skipped = world.health.registry.get_sample_value(
        "bearing_twin_samples_skipped_total", {"reason": "too_old"}
    )
    assert skipped == 1


async def test_an_asset_that_was_removed_meanwhile_takes_nothing_with_it(world: Any) -> None:
    now_us = world.clock.now_us()

    def make(asset: str) -> Sample:
        return Sample(asset, INNER, now_us, 60.0, 192, now_us)

    push = JudgedPush()
    for index, asset in enumerate(("gone", "rig-2", "gone")):
        push.take(index, lambda asset=asset: make(asset))  # type: ignore[misc]
    push.pack()
    caller_role.set("gateway")
    counts, left = await world.context.ingest.accept_all(*push.packed, now_us, 5.0)
    assert (counts.stored, list(left)) == (1, ["gone"])
    push.leave(left)
    assert [one.index for one in push.rejected] == [0, 2]
    assert push.count == 1
    assert stored(world) == [(INNER, 60.0, 192)]


async def test_a_push_makes_only_the_copies_of_its_own_assets_old(world: Any) -> None:
    changed: list[Any] = []
    transport = httpx2.ASGITransport(OwnWrites(world.app, changed.append))
    headers = {"X-API-Key": world.keys["gateway"], "Content-Type": "text/plain"}
    async with httpx2.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
        many = {"samples": [sample(world), sample(world, asset="bench-1"), "no object"]}
        options = {"headers": headers | {"Content-Type": "application/json"}}
        assert (await client.post(MANY, json=many, **options)).status_code == 200
        answer = await client.post(WRITE, content=b"rig-2 ambient_c=1", headers=headers)
        assert answer.status_code == 204
        one = {"samples": [{"channel": INNER, "time": sample(world)["time"], "value": 1}]}
        path = "/api/v1/assets/rig-2/measurements"
        assert (await client.post(path, json=one, **options)).status_code == 200
    assert [set(names) for names in changed] == [{"rig-2"}] * 3


# ---------------------------------------------------------------- line protocol
async def test_lines_of_telegraf_are_stored(world: Any) -> None:
    now_ns = world.clock.now_us() * 1000
    response = await write(
        world,
        "# a comment",
        f"rig-2,host=gateway,line=3 {INNER}=63.5,ambient_c=21i {now_ns - 2_000_000_000}",
        f"rig-2 {INNER}=64 {now_ns - 1_000_000_000}\r",
        "",
        f"rig-2 {INNER}=65",
        db="telegraf",
    )
    assert (response.status_code, response.content) == (204, b"")
    assert stored(world) == [
        ("ambient_c", 21.0, 192),
        (INNER, 63.5, 192),
        (INNER, 64.0, 192),
        (INNER, 65.0, 192),
    ]


@pytest.mark.parametrize(
    ("precision", "per_s"), [("s", 1), ("ms", 1e3), ("us", 1e6), ("u", 1e6), ("ns", 1e9)]
)
async def test_times_have_the_unit_that_is_given(world: Any, precision: str, per_s: float) -> None:
    at_s = world.clock.now_us() // 1_000_000 - 10
    response = await write(world, f"rig-2 {INNER}=1 {at_s * int(per_s)}", precision=precision)
    assert response.status_code == 204, response.text
    [row] = world.store.samples.read("rig-2", None, 0, 10**18, 9)
    assert row.time_us == at_s * 1_000_000


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("rig-2", "Failed to parse measurement"),
        (f"rig-2 {INNER}=1 12x", "timestamp"),
        (f"rig-2 {INNER}=nan", "field value"),
        (f'rig-2 {INNER}="hot"', "expected a number"),
        (f"rig-2 {INNER}=true", "expected a number"),
        (f"rig-2 {INNER}=1 -5", "1970 to 2999"),
        (f"rig-2 {INNER}=1 9000000000000000000", "1990 to tomorrow"),
        ("rig-2 nowhere=1", "pushed channels are"),
        (f"no-such {INNER}=1", "asset 'no-such': not followed"),
        (f"bench-1 {INNER}=1", "takes no pushes"),
        (f"rig\x00-2 {INNER}=1", "NUL"),
    ],
)
async def test_a_wrong_line_is_named_and_its_neighbours_are_stored(
    world: Any, line: str, said: str
) -> None:
    response = await write(world, f"rig-2 {INNER}=1", line, "rig-2 ambient_c=2")
    assert response.status_code == 400
    problem = response.json()
    assert problem["detail"].startswith("line 2: ")
    assert said in problem["detail"]
    assert "partial write: 1 of 3 lines" in problem["detail"]
    assert [one["parameter"] for one in problem["errors"]] == ["line 2"]
    assert len(stored(world)) == 2


async def test_the_good_fields_of_a_wrong_line_are_stored(world: Any) -> None:
    response = await write(world, f'rig-2 {INNER}=1,state="ok",nowhere=2')
    assert response.status_code == 400
    assert [row[0] for row in stored(world)] == [INNER]


async def test_lines_that_cannot_be_text_or_are_too_many_are_refused_whole(world: Any) -> None:
    response = await write(world, content=b"rig-2 ambient_c=1\nrig-2 \xff=1")
    assert response.status_code == 400
    assert response.json()["detail"] == "line 2: not UTF-8; nothing was stored"
    response = await write(world, *[f"rig-2 {INNER}=1"] * 20_001)
    assert response.status_code == 413
    assert stored(world) == []


async def test_who_may_not_push_may_not_write(world: Any) -> None:
    for role in ("viewer", "operator", "engineer"):
        assert (await write(world, "rig-2 ambient_c=1", role=role)).status_code == 403
    response = await write(world, "rig-2 ambient_c=1", precision="week")
    assert response.status_code == 422
    html = {"Content-Type": "text/html"}
    response = await write(world, "rig-2 ambient_c=1", headers=html)
    assert response.status_code == 415
    assert stored(world) == []


async def test_a_key_as_password_writes_as_clients_of_influxdb_1_do(world: Any) -> None:
    key = world.keys["gateway"]
    client = world.client()
    response = await client.post(
        WRITE,
        content=gzip.compress(b"rig-2 ambient_c=1"),
        headers={"Content-Type": "text/plain", "Content-Encoding": "gzip"},
        params={"db": "telegraf", "precision": "ns", "rp": "", "consistency": "any"},
        auth=("telegraf", key),
    )
    assert response.status_code == 204, response.text
