"""The envelope over HTTP, and how many calculations a key may have running."""

import asyncio
from typing import Any

import pytest
from patience import within

from service.bus.replica import AssetReplica

ENVELOPE = "/api/v1/assets/bench-1/envelope"
ADVICE = "/api/v1/assets/bench-1/advice"


async def test_envelope_is_the_twins_and_infinities_are_null(world: Any) -> None:
    answer = await world.client("viewer").get(ENVELOPE)
    assert answer.status_code == 200
    assert answer.json()["runaway"]["probability"] == [[None]]
    assert answer.json()["labels"] == []


async def test_envelope_before_the_first_data_is_to_be_tried_again(world: Any) -> None:
    world.bench.ready = False
    answer = await world.client("viewer").get(ENVELOPE)
    assert answer.status_code == 503
    assert int(answer.headers["retry-after"]) > 0
    assert "first good" in answer.json()["detail"]


class HeldQuestions:
    """Lets the test say when a study ends."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun: list[str] = []
        self.release = asyncio.Event()
        compute = AssetReplica.compute

        async def held(asset: AssetReplica, question: Any, *arguments: Any) -> Any:
            self.begun.append(question.__name__)
            await self.release.wait()
            return await compute(asset, question, *arguments)

        monkeypatch.setattr(AssetReplica, "compute", held)

    async def until_begun(self, count: int) -> None:
        async with within(30):
            while len(self.begun) < count:  # noqa: ASYNC110
                await asyncio.sleep(0.01)


async def test_views_that_are_open_at_the_same_time_share_one_envelope(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One key for a control room is usual: more views than one key has turns."""
    held = HeldQuestions(monkeypatch)
    viewer, admin = world.client("viewer"), world.client("admin")
    asking = [asyncio.create_task(viewer.get(ENVELOPE)) for _ in range(12)]
    asking.append(asyncio.create_task(admin.get(ENVELOPE)))
    await held.until_begun(1)
    await asyncio.sleep(0.2)
    held.release.set()
    answers = await asyncio.gather(*asking)
    assert {answer.status_code for answer in answers} == {200}
    assert held.begun == ["envelope"]


async def test_a_refusal_says_how_many_calculations_are_running(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = HeldQuestions(monkeypatch)
    client = world.client("engineer")
    asking = [
        asyncio.create_task(client.get(ADVICE, params={"speed_rpm": 6000 + i, "load_n": 5500}))
        for i in range(6)
    ]
    done, _ = await asyncio.wait(asking, return_when=asyncio.FIRST_COMPLETED)
    answered = [one.result() for one in done]
    details = [one.json()["detail"] for one in answered]
    assert details == ["busy: five calculations are running with this key"]
    (refused,) = answered
    assert refused.status_code == 503
    assert int(refused.headers["retry-after"]) > 0
    held.release.set()
    answers = await asyncio.gather(*asking)
    assert sorted(answer.status_code for answer in answers) == [200] * 5 + [503]


async def test_a_client_that_leaves_takes_its_study_with_it(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = HeldQuestions(monkeypatch)
    first = asyncio.create_task(world.client("viewer").get(ENVELOPE))
    await held.until_begun(1)
    leaves = asyncio.Event()
    answers = [
        asyncio.create_task(_get_until(world, leaves, f"speed_rpm={6000 + i}&load_n=5500"))
        for i in range(3)
    ]
    await asyncio.sleep(0.2)
    leaves.set()
    await asyncio.gather(*answers)
    held.release.set()
    assert (await first).status_code == 200
    await world.client("viewer").get(ENVELOPE)
    assert held.begun == ["envelope", "envelope"]


async def _get_until(world: Any, leaves: asyncio.Event, query: str) -> None:
    """Ask for advice and disconnect."""

    async def receive() -> Any:
        if not asked:
            asked.append(True)
            return {"type": "http.request", "body": b"", "more_body": False}
        await leaves.wait()
        return {"type": "http.disconnect"}

    async def send(message: Any) -> None:
        pass

    asked: list[bool] = []
    scope = {
        "type": "http", "http_version": "1.1", "method": "GET", "scheme": "http", "path": ADVICE,
        "raw_path": ADVICE.encode(), "query_string": query.encode(), "root_path": "",
        "asgi": {"version": "3.0"}, "client": ("127.0.0.1", 4711), "server": ("127.0.0.1", 80),
        "headers": [(b"host", b"127.0.0.1"), (b"x-api-key", world.keys["engineer"].encode())],
    }  # fmt: skip
    await world.app(scope, receive, send)


async def test_an_unknown_asset_is_named(world: Any) -> None:
    answer = await world.client("admin").get(ENVELOPE.replace("bench-1", "bench-9"))
    assert answer.status_code == 404
    assert "bench-9" in answer.json()["detail"]


async def test_openapi_describes_the_envelope_with_examples(world: Any) -> None:
    schemas = (await world.client().get("/openapi.json")).json()["components"]["schemas"]
    envelope = schemas["EnvelopeDocument"]["properties"]
    assert envelope["horizon_s"]["examples"] == [28800]
