"""A foreign client sees what the snapshot says: value, status and source time, of every tag."""

import asyncio
import itertools
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from opcua_site import RING, Asset, Changes, apart, inside, node_id, read
from patience import wait_for

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
                    return await wait_for(changes.values.get(), PATIENCE_S)

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


@pytest.mark.wires
async def test_objects_come_and_go_with_assets_while_clients_stay_connected(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    first, loop = Asset(), asyncio.get_running_loop()
    assets: dict[str, Any] = {"bench-1": first}
    async with inside(first, tmp_path, store, outbox, assets=assets) as served:
        nodes = served.publisher.server.iserver.aspace

        async def change(id: str, asset: Asset | None) -> None:
            """Add or remove an asset, and have the server follow in its own loop."""

            async def there() -> None:
                if asset is None:
                    del assets[id]
                else:
                    assets[id] = asset
                await served.rounds.publish_tags()

            await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(there(), loop))

        async def names(client: Client) -> set[str]:
            children = await client.nodes.objects.get_children()
            ids = [node.nodeid for node in children if node.nodeid.NamespaceIndex == 2]
            return {str(one.Identifier) for one in ids}

        async def look() -> None:
            async with Client(served.address) as client:
                before = len(nodes.keys())
                changes = Changes()
                subscription = await client.create_subscription(100, changes)

                async def subscribe(id: str) -> Any:
                    watched = client.get_node(f"ns=2;s={id}/{RING}")
                    await subscription.subscribe_data_change(watched)
                    # Its name as well: every attribute of a node can be watched.
                    await subscription.subscribe_data_change(watched, ua.AttributeIds.BrowseName)

                async def next_one() -> tuple[Any, int]:
                    return await wait_for(changes.values.get(), PATIENCE_S)

                second = Asset()
                await change("bench-2", second)
                assert await names(client) == {"bench-1", "bench-2"}
                bench = await client.nodes.objects.get_child("2:bench-2")
                assert len(await bench.get_children()) == len(second.tags)
                await subscribe("bench-2")
                first_two = [await next_one(), await next_one()]
                assert (61.5, 0) in first_two
                await change("bench-2", None)
                assert await next_one() == (None, ua.StatusCodes.BadOutOfService)
                assert await names(client) == {"bench-1"}
                assert len(nodes.keys()) == before  # nothing of it is left
                gone = await client.get_node(f"ns=2;s=bench-2/{RING}").read_data_value(
                    raise_on_bad_status=False
                )
                assert gone.StatusCode.value == ua.StatusCodes.BadNodeIdUnknown
                # It comes back with other tags, under the same names.
                third = Asset()
                third.tell(RING, 50.0)
                third.tell("load_n", 900.0, unit="N")
                await change("bench-2", third)
                assert (await bench.get_children())[-1].nodeid.Identifier == "bench-2/load_n"
                await subscribe("bench-2")
                assert (50.0, 0) in [await next_one(), await next_one()]
                del third.tags["load_n"]
                await change("bench-2", third)
                assert len(await bench.get_children()) == len(third.tags)
                # The end of a subscription to nodes of which some are gone.
                await subscription.delete()
                assert (await read(client, RING)).Value.Value == 61.5

        await apart(look)
    assert served.rounds.problem is None


@pytest.mark.wires
async def test_others_have_their_turn_while_many_assets_come_and_go(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    first = Asset()
    assets: dict[str, Any] = {"bench-1": first}
    many = {f"axle-{number}": Asset() for number in range(50)}
    turns = 0

    async def count() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    async with inside(first, tmp_path, store, outbox, assets=assets) as served:
        counting = asyncio.create_task(count())
        assets |= many
        await served.rounds.publish_tags()
        assert turns >= len(many)
        turns = 0
        for name in many:
            del assets[name]
        await served.rounds.publish_tags()
        assert turns >= len(many)
        counting.cancel()
