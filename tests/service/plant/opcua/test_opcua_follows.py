"""A foreign client sees what the snapshot says: value, status and source time, of every tag."""

import asyncio
import itertools
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from opcua_site import RING, Asset, Changes, apart, inside, node_id, read

from adapters.samples import Quality
from service.clock import from_rfc3339
from service.plant.opcua.codes import status_code
from service.store import Outbox, Store

PATIENCE_S = 60.0
SECONDS = f"{RING}.time_to_warning_s"

#: What a tag may be; each follows each other once, itself included.
STATES: list[tuple[float | None, int]] = [
    (1200.0, Quality.GOOD),
    (900.0, Quality.GOOD),
    (None, Quality.GOOD),
    (None, Quality.SENSOR_FAILURE),
    (800.0, Quality.SENSOR_NOT_ACCURATE),
    (None, Quality.WAITING_FOR_INITIAL_DATA),
    (None, Quality.LAST_USABLE),
]


def every_change(states: list[Any]) -> list[Any]:
    """Give a walk in which every state follows every other one at least once."""
    pairs = [(one, other) for one in states for other in states if one != other]
    return list(itertools.chain.from_iterable(pairs))


def is_as(found: ua.DataValue, shown: dict[str, Any]) -> bool:
    value = None if found.Value is None else found.Value.Value
    source_us = None
    if found.SourceTimestamp is not None:
        source_us = round(found.SourceTimestamp.timestamp() * 1e6)
    return (
        value == shown["value"]
        and found.StatusCode.value == status_code(shown["quality"])
        and source_us == from_rfc3339(shown["time"])
    )


@pytest.mark.wires
async def test_every_tag_follows_the_snapshot_through_values_and_none(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    asset = Asset()
    for name in (RING, SECONDS, "model.version"):
        asset.tell(name, None)  # what a service that has just begun has
    async with inside(asset, tmp_path, store, outbox) as served:
        steps = every_change(STATES)

        async def look() -> None:
            async with Client(served.address) as client:
                for number, (value, quality) in enumerate(steps):
                    time = f"2026-01-21T08:{number // 60:02d}:{number % 60:02d}.000Z"
                    for name in list(asset.tags):
                        asset.tell(name, value, quality, time)
                    await served_now()
                    for name, shown in asset.tags.items():
                        assert is_as(await read(client, name), shown), (number, name, shown)

        loop = asyncio.get_running_loop()

        async def served_now() -> None:
            """Have the server write at once, in its own loop; its period is half a second."""
            done = asyncio.run_coroutine_threadsafe(served.rounds.publish_tags(), loop)
            await asyncio.wrap_future(done)

        await apart(look)
    assert served.rounds.problem is None


@pytest.mark.wires
async def test_a_deadband_loses_neither_a_slow_rise_nor_the_loss_of_a_value(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    asset, loop = Asset(), asyncio.get_running_loop()
    asset.tell(RING, 60.0)
    async with inside(asset, tmp_path, store, outbox) as served:

        async def tell(value: float | None, quality: int = Quality.GOOD) -> None:
            asset.tell(RING, value, quality)
            done = asyncio.run_coroutine_threadsafe(served.rounds.publish_tags(), loop)
            await asyncio.wrap_future(done)

        async def look() -> None:
            async with Client(served.address) as client:
                changes = Changes()
                subscription = await client.create_subscription(100, changes)
                await subscription.deadband_monitor(client.get_node(node_id(RING)), 0.5)

                async def next_one() -> tuple[Any, int]:
                    return await asyncio.wait_for(changes.values.get(), PATIENCE_S)

                assert await next_one() == (60.0, 0)
                for tenths in range(1, 8):  # a ramp of 0.1 K a step
                    await tell(60.0 + tenths / 10)
                value, _ = await next_one()
                assert value == pytest.approx(60.6)
                assert changes.values.empty()
                await tell(None, Quality.SENSOR_FAILURE)
                assert await next_one() == (None, ua.StatusCodes.BadSensorFailure)
                await tell(60.7)
                assert (await next_one())[1] == 0
                await tell(None)
                assert await next_one() == (None, 0)
                await tell(60.8)
                assert (await next_one())[1] == 0

        await apart(look)


@pytest.mark.wires
async def test_a_write_that_the_library_refuses_is_counted_and_tried_again(
    tmp_path: Path, store: Store, outbox: Outbox, capsys: pytest.CaptureFixture[str]
) -> None:
    asset = Asset()
    async with inside(asset, tmp_path, store, outbox) as served:
        space = served.publisher.server.iserver.aspace
        space._nodes.pop(ua.NodeId(f"bench-1/{RING}", 2))  # whatever makes it refuse
        asset.tell(RING, 70.0)
        asset.tell("model.version", 4.0, unit="")
        for _ in range(2):
            await served.rounds.publish_tags()
        assert served.rounds.problem == "1 tags refused"

        async def look() -> float:
            async with Client(served.address) as client:
                return float((await read(client, "model.version")).Value.Value)

        assert await apart(look) == 4.0  # the other tags go on
    told = capsys.readouterr().out
    assert told.count("opcua_update_failed") == 1
    assert "BadNodeIdUnknown" in told
