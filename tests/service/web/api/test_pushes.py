"""POST measurements, through the real ingest into the real store."""

import asyncio
import gzip
import json
import zlib
from typing import Any

import pytest
from structlog.testing import capture_logs

from service.clock import from_rfc3339, rfc3339
from service.documents.measurements import Pushed
from service.store import Retention, Store

PATH = "/api/v1/assets/rig-2/measurements"
INNER = "t_inner_ring_c"


def sample(world: Any, seconds_ago: float = 0, **changes: Any) -> dict[str, Any]:
    time_us = world.clock.now_us() - round(seconds_ago * 1e6)
    return {"channel": INNER, "time": rfc3339(time_us), "value": 60.0} | changes


async def push(world: Any, *samples: Any) -> Pushed:
    response = await world.client("gateway").post(PATH, json={"samples": samples})
    assert response.status_code == 200, response.text
    return Pushed.model_validate(response.json())


def stored(world: Any) -> list[tuple[str, float | None, int]]:
    now_us = world.clock.now_us()
    rows = world.store.samples.read("rig-2", None, 0, now_us + 10**12, 100)
    return [(row.channel, row.value, row.quality) for row in rows]


async def test_pushed_samples_are_stored_when_the_answer_comes(world: Any) -> None:
    answer = await push(
        world,
        sample(world, 2),
        sample(world, 1, value=61.5, quality=80),
        sample(world, 0, channel="ambient_c", value=21),
    )
    assert (answer.accepted, answer.duplicates, answer.rejected) == (3, 0, [])
    assert stored(world) == [(INNER, 60.0, 192), (INNER, 61.5, 80), ("ambient_c", 21.0, 192)]


async def test_the_live_twin_gets_them_too(world: Any) -> None:
    await push(world, sample(world, value=63.0))
    assert [(s.asset, s.channel, s.value) for s in world.taken] == [("rig-2", INNER, 63.0)]


async def test_sending_again_is_counted_and_changes_nothing(world: Any) -> None:
    first = sample(world, 5)
    await push(world, first)
    answer = await push(world, first, first | {"value": 99.0})
    assert (answer.accepted, answer.duplicates) == (0, 2)
    assert stored(world) == [(INNER, 60.0, 192)]


async def test_a_good_sample_mends_a_bad_one_of_the_same_time(world: Any) -> None:
    first = sample(world, 5)
    await push(world, first | {"value": None, "quality": 24})
    answer = await push(world, first)
    assert answer.accepted == 1
    assert stored(world) == [(INNER, 60.0, 192)]


async def test_sample_without_value_is_bad(world: Any) -> None:
    await push(world, sample(world, 1, value=None), sample(world, 0, value=5.0, quality=16))
    assert stored(world) == [(INNER, None, 0), (INNER, None, 16)]


@pytest.mark.parametrize(
    ("wrong", "detail"),
    [
        ({"channel": "t_missing_c"}, "pushed channels are: t_inner_ring_c, ambient_c"),
        ({"channel": 7}, "unknown"),
        ({"time": "2026-11-21T08:00:00"}, "offset"),
        ({"time": None}, "RFC 3339"),
        ({"value": "60"}, "number or null"),
        ({"value": True}, "number or null"),
        ({"value": 10**400}, "finite"),
        ({"value": None, "quality": 192}, "expected a number with quality 192"),
        ({"quality": 256}, "0 to 255"),
        ({"quality": "good"}, "0 to 255"),
    ],
)
async def test_wrong_sample_is_rejected_and_its_neighbours_are_not(
    world: Any, wrong: dict[str, Any], detail: str
) -> None:
    answer = await push(world, sample(world, 2), sample(world, 1, **wrong), sample(world, 0))
    assert answer.accepted == 2
    (rejected,) = answer.rejected
    assert rejected.index == 1
    assert detail in rejected.detail


async def test_no_sample_can_be_of_the_day_after_tomorrow(world: Any) -> None:
    answer = await push(world, sample(world, -2 * 86_400), sample(world, 60), "no object")
    assert answer.accepted == 1
    assert [rejected.index for rejected in answer.rejected] == [0, 2]
    assert "expected a time from 1990 to tomorrow" in answer.rejected[0].detail


@pytest.mark.parametrize("ahead_s", [40.0, 280.0, 7200.0])
@pytest.mark.parametrize("path", [PATH, "/api/v1/measurements"])
async def test_the_samples_of_a_clock_that_is_ahead_are_of_now_and_uncertain(
    world: Any, path: str, ahead_s: float
) -> None:
    of_asset = {"asset": "rig-2"} if path != PATH else {}
    samples = [
        sample(world, -ahead_s + 2) | of_asset,
        sample(world, -ahead_s, value=61.0) | of_asset,
        sample(world, 1, channel="ambient_c", value=21.0) | of_asset,
    ]
    before_us = world.clock.now_us()
    for count in ({"accepted": 3, "duplicates": 0}, {"accepted": 0, "duplicates": 3}):
        response = await world.client("gateway").post(path, json={"samples": samples})
        answer = response.json()
        assert answer == count | {"rejected": [], "clock_ahead_s": answer["clock_ahead_s"]}
        assert answer["clock_ahead_s"] == pytest.approx(ahead_s, abs=5.0)
    assert stored(world) == [(INNER, 60.0, 64), ("ambient_c", 21.0, 192), (INNER, 61.0, 64)]
    rows = world.store.samples.read("rig-2", [INNER], 0, world.clock.now_us() + 10**12, 100)
    first_us, latest_us = (from_rfc3339(one["time"]) for one in samples[:2])
    assert rows[1].time_us - rows[0].time_us == latest_us - first_us
    assert before_us - 5_000_000 < rows[1].time_us <= world.clock.now_us()


async def test_a_clock_that_is_some_seconds_ahead_is_right(world: Any) -> None:
    response = await world.client("gateway").post(PATH, json={"samples": [sample(world, -4)]})
    assert response.json() == {"accepted": 1, "duplicates": 0, "rejected": []}
    assert stored(world) == [(INNER, 60.0, 192)]


async def test_channel_with_a_wire_takes_no_pushes(world: Any) -> None:
    response = await world.client("gateway").post(
        "/api/v1/assets/bench-1/measurements",
        json={"samples": [sample(world), sample(world, channel="speed_rpm")]},
    )
    assert response.status_code == 409
    pointers = [error["pointer"] for error in response.json()["errors"]]
    assert sorted(pointers) == ["/samples/0/channel", "/samples/1/channel"]
    assert "pt100" in response.text
    assert world.store.samples.channels("bench-1") == []


async def test_body_without_samples_is_refused(world: Any) -> None:
    response = await world.client("gateway").post(PATH, json={"sample": []})
    assert response.status_code == 422
    assert "/samples" in {error["pointer"] for error in response.json()["errors"]}


async def test_nothing_to_store_is_fine(world: Any) -> None:
    assert (await push(world)).accepted == 0


async def test_many_samples_in_one_call(world: Any) -> None:
    samples = [sample(world, 3000 - number, value=number) for number in range(3000)]
    assert (await push(world, *samples)).accepted == 3000


async def test_the_answer_to_many_wrong_samples_is_bounded(world: Any) -> None:
    samples = [sample(world) | {"channel": "nowhere" * 1000}] + [
        sample(world) | {"channel": f"nowhere_{number}"} for number in range(19_999)
    ]
    response = await world.client("gateway").post(PATH, json={"samples": samples})
    assert response.status_code == 200, response.text[:1000]
    assert len(response.content) < 2_000_000
    rejected = response.json()["rejected"]
    assert [one["index"] for one in rejected] == list(range(20_000))
    assert "pushed channels are" in rejected[99]["detail"]
    assert max(len(one["detail"]) for one in rejected) < 300


async def test_a_key_has_so_many_pushes_at_once(world: Any) -> None:
    samples = [sample(world, number / 1000) for number in range(2000)]
    client = world.client("gateway")
    answers = await asyncio.gather(
        *(client.post(PATH, json={"samples": samples}) for _ in range(24)),
        world.client("admin").post(PATH, json={"samples": samples}),
    )
    assert {one.status_code for one in answers} == {200, 503}
    assert answers[-1].status_code == 200, "another key has a share of its own"
    refused = [one for one in answers if one.status_code == 503]
    assert "Retry-After" in refused[0].headers
    assert "pushes" in refused[0].json()["detail"]
    # One at a time goes on, and nothing was counted twice.
    assert (await push(world, *samples)).duplicates == 2000
    accepted = sum(one.json()["accepted"] for one in answers if one.status_code == 200)
    assert accepted == len({one["time"] for one in samples})


async def push_packed(world: Any, body: bytes, encoding: str = "gzip") -> Any:
    return await world.client("gateway").post(
        PATH,
        content=body,
        headers={"Content-Type": "application/json", "Content-Encoding": encoding},
    )


async def test_a_gzip_body_is_as_good_as_a_plain_one(world: Any) -> None:
    now_us = world.clock.now_us()
    samples = [sample(world) | {"time": rfc3339(now_us - k * 1000)} for k in range(5000)]
    packed = gzip.compress(json.dumps({"samples": samples}).encode())
    response = await push_packed(world, packed)
    assert response.status_code == 200, response.text
    assert response.json()["accepted"] == 5000


async def test_compressed_bytes_count_too(world: Any) -> None:
    """Empty blocks give nothing: a body of them would never be too long."""
    deflate = zlib.compressobj(wbits=zlib.MAX_WBITS | 16)
    packed = deflate.compress(b" ") + b"".join(
        deflate.flush(zlib.Z_FULL_FLUSH) or b"\x00\x00\x00\xff\xff" for _ in range(1_000_000)
    )
    response = await push_packed(world, packed + deflate.flush())
    assert response.status_code == 413


async def test_nothing_is_decompressed_for_a_caller_without_a_key(world: Any) -> None:
    for path in ("/api/v1/session", PATH):
        response = await world.client().post(
            path,
            content=gzip.compress(b"{}"),
            headers={"Content-Type": "application/json", "Content-Encoding": "gzip"},
        )
        assert response.status_code in (401, 415), response.text
        assert (path == PATH) == (response.status_code == 401)


async def test_a_bomb_is_refused_as_what_it_holds(world: Any) -> None:
    response = await push_packed(world, gzip.compress(b" " * 50_000_000))
    assert response.status_code == 413


@pytest.mark.parametrize(
    ("body", "encoding", "status"),
    [
        (b"plain", "gzip", 400),
        (gzip.compress(b'{"samples": []}', mtime=0)[:-9], "gzip", 400),
        (b"", "gzip", 400),
        # Whatever follows the one member would never be counted as part of the body.
        (gzip.compress(b'{"samples": []}', mtime=0) + b"0", "gzip", 400),
        (gzip.compress(b'{"samples": []}', mtime=0) + bytes(1_000_000), "gzip", 400),
        (gzip.compress(b'{"samples"', mtime=0) + gzip.compress(b": []}", mtime=0), "gzip", 400),
        (b"plain", "br", 415),
    ],
)
async def test_a_body_that_cannot_be_unpacked_is_refused(
    world: Any, body: bytes, encoding: str, status: int
) -> None:
    response = await push_packed(world, body, encoding)
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"


async def test_samples_from_before_what_is_kept_are_rejected_and_counted(world: Any) -> None:
    day_s = 86_400
    await push(world, sample(world, 50 * day_s), sample(world, 1))
    world.store.rollups.expire(Retention(raw_days=10.0), world.clock.now_us())
    answer = await push(world, sample(world, 60 * day_s), sample(world), sample(world, 55 * day_s))
    assert (answer.accepted, answer.duplicates) == (1, 0)
    assert [one.index for one in answer.rejected] == [0, 2]
    assert all("too old, history before" in one.detail for one in answer.rejected)
    skipped = world.health.registry.get_sample_value(
        "bearing_twin_samples_skipped_total", {"reason": "too_old"}
    )
    assert skipped == 2


async def test_samples_of_a_clock_that_was_never_set_are_rejected_and_an_alarm(world: Any) -> None:
    since_1970_s = world.clock.now_us() // 1_000_000
    answer = await push(world, sample(world, since_1970_s - 60), sample(world))
    assert (answer.accepted, [one.index for one in answer.rejected]) == (1, [0])
    assert "expected a time from 1990 to tomorrow" in answer.rejected[0].detail
    assert "Samples of 1970-01-01T00:01:00" in (world.ingest.too_old_problem or "")
    assert "expected a time from 1990 to tomorrow. Check the clock" in world.ingest.too_old_problem


async def test_samples_that_were_removed_meanwhile_are_rejected_too(world: Any) -> None:
    day_s = 86_400
    await push(world, sample(world, 50 * day_s), sample(world, 1))
    with Store.open("", world.data_dir) as other:  # another program removes it
        other.rollups.expire(Retention(raw_days=10.0), world.clock.now_us())
    answer = await push(world, sample(world, 60 * day_s), sample(world))
    assert (answer.accepted, answer.duplicates) == (1, 0)
    assert [one.index for one in answer.rejected] == [0]


async def test_a_client_that_leaves_in_the_middle_of_its_body_leaves_nothing_in_the_log(
    world: Any,
) -> None:
    messages = iter(
        [
            {"type": "http.request", "body": b'{"samples": [', "more_body": True},
            {"type": "http.disconnect"},
        ]
    )
    answer: list[Any] = []

    async def receive() -> Any:
        return next(messages)

    async def send(message: Any) -> None:
        answer.append(message)

    scope = {
        "type": "http", "http_version": "1.1", "method": "POST", "scheme": "http", "path": PATH,
        "raw_path": PATH.encode(), "query_string": b"", "root_path": "", "asgi": {"version": "3.0"},
        "client": ("127.0.0.1", 4711), "server": ("127.0.0.1", 80),
        "headers": [
            (b"host", b"127.0.0.1"),
            (b"x-api-key", world.keys["gateway"].encode()),
            (b"content-type", b"application/json"),
        ],
    }  # fmt: skip
    with capture_logs() as logs:
        await world.app(scope, receive, send)
    assert next(messages, None) is None, "the body was read"
    assert (logs, answer) == ([], [])
