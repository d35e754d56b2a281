"""What a caller without a key, or with somebody else's session, gets from the OPC UA server."""

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.server.internal_session import InternalSession
from opcua_site import RING, Asset, Changes, apart, inside, make_client, node_id, read
from patience import wait_for

from service.security.keys import create_key
from service.store import Outbox, Store

PATIENCE_S = 60.0


async def follow(client: Client) -> Changes:
    """Subscribe to one tag, and wait for its first value."""
    changes = Changes()
    subscription = await client.create_subscription(100, changes)
    await subscription.subscribe_data_change(client.get_node(node_id(RING)))
    await wait_for(changes.values.get(), PATIENCE_S)
    return changes


async def goes_on(asset: Asset, changes: Changes, loop: Any, first: float, count: int = 3) -> None:
    """Make changes, and wait until each has come to the subscriber."""
    for number in range(count):
        loop.call_soon_threadsafe(asset.tell, RING, first + number)
        value, _ = await wait_for(changes.values.get(), PATIENCE_S)
        assert value == first + number


async def steal(address: str, token: ua.NodeId, encrypted: bool) -> list[str]:
    """Activate somebody's session on a channel of one's own without a key; tells what worked."""
    thief = await make_client(address, encrypted=encrypted)
    got: list[str] = []
    try:
        await thief.connect_sessionless()
        # What a client keeps of its own session.
        thief.uaclient.protocol.authentication_token = token
        thief._server_nonce = b"0" * 32
        attempts: dict[str, Callable[[], Awaitable[Any]]] = {
            "activate": thief.activate_session,
            "read": lambda: read(thief, RING),
            "browse": thief.nodes.objects.get_children,
            "close": lambda: thief.uaclient.close_session(True),
        }
        for name, attempt in attempts.items():
            try:
                answer = await wait_for(attempt(), PATIENCE_S)
            except (ua.UaError, ConnectionError, TimeoutError):
                continue
            if name == "read" and answer.Value.Value is None:
                continue
            if name != "close":  # answered with Good where there is nothing to close, too
                got.append(name)
    finally:
        thief.disconnect_socket()
    return got


@pytest.mark.wires
@pytest.mark.parametrize("host", ["0.0.0.0", "127.0.0.1"])
async def test_nobody_takes_over_the_session_of_a_client_that_has_a_key(
    tmp_path: Path, store: Store, outbox: Outbox, host: str
) -> None:
    key = create_key(store, "viewer").text
    asset, loop, beyond = Asset(), asyncio.get_running_loop(), host != "127.0.0.1"
    async with inside(asset, tmp_path, store, outbox, host) as served:

        async def look() -> None:
            client = await make_client(served.address, key, encrypted=beyond)
            async with client:
                changes = await follow(client)
                await goes_on(asset, changes, loop, 70.0)
                token = client.uaclient.protocol.authentication_token
                # The library numbers sessions; one guess on each channel.
                newest = InternalSession._auth_counter
                guesses = [ua.NodeId(newest - back) for back in range(4)]
                for turn, guess in enumerate([*guesses, token]):
                    assert await steal(served.address, guess, beyond) == []
                    await goes_on(asset, changes, loop, 100.0 + turn, 1)
                assert token.NodeIdType == ua.NodeIdType.ByteString
                assert len(token.Identifier) >= 32
                await goes_on(asset, changes, loop, 300.0)

        await apart(look)


async def succeeds(attempt: Awaitable[list[Any]]) -> bool:
    """Return whether a service did anything of what it was asked for."""
    try:
        results = await attempt
    except ua.UaError:
        return False
    return any(getattr(one, "StatusCode", one).is_good() for one in results)


@pytest.mark.wires
async def test_one_viewer_cannot_touch_the_subscription_of_another(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    asset, loop = Asset(), asyncio.get_running_loop()
    async with inside(asset, tmp_path, store, outbox) as served:

        async def look() -> None:
            async with Client(served.address) as victim, Client(served.address) as other:
                changes = Changes()
                subscription = await victim.create_subscription(100, changes)
                item = await subscription.subscribe_data_change(victim.get_node(node_id(RING)))
                await wait_for(changes.values.get(), PATIENCE_S)
                own = await other.create_subscription(1000, Changes())
                number = subscription.subscription_id
                assert number != own.subscription_id
                session = other.uaclient
                mode = ua.SetPublishingModeParameters(False, [number])
                items = ua.DeleteMonitoredItemsParameters(number, [item])
                move = ua.TransferSubscriptionsParameters([number])
                for attempt in (
                    session.delete_subscriptions([number]),
                    session.set_publishing_mode(mode),
                    session.delete_monitored_items(items),
                    session.transfer_subscriptions(move),
                ):
                    assert not await succeeds(attempt)
                await goes_on(asset, changes, loop, 70.0)

        await apart(look)


@pytest.mark.wires
async def test_beyond_loopback_nothing_but_discovery_comes_without_encryption(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    key = create_key(store, "viewer").text
    async with inside(Asset(), tmp_path, store, outbox, "0.0.0.0") as served:

        async def look() -> None:
            client = Client(served.address)
            for endpoint in await client.connect_and_get_server_endpoints():
                assert endpoint.SecurityMode == ua.MessageSecurityMode.SignAndEncrypt
            # A client that does not look at the list, and would send its key in the clear.
            careless = await make_client(served.address, key)
            await careless.connect_sessionless()
            try:
                with pytest.raises((ua.UaError, ConnectionError)):
                    await careless.create_session()
            finally:
                careless.disconnect_socket()
            async with await make_client(served.address, key, encrypted=True) as careful:
                assert (await read(careful, RING)).Value.Value == 61.5

        await apart(look)
    kept = tmp_path / "opcua"
    assert (kept / "private-key.pem").stat().st_mode & 0o077 == 0


@pytest.mark.wires
async def test_nobody_registers_servers_with_this_one(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    async with inside(Asset(), tmp_path, store, outbox) as served:

        async def look() -> None:
            client = Client(served.address)
            await client.connect_sessionless()
            try:
                server = ua.RegisteredServer(
                    ServerUri="urn:evil", ServerNames=[ua.LocalizedText("evil")]
                )
                with pytest.raises(ua.UaError):
                    await client.uaclient.register_server(server)
                found = await client.find_servers()
                (own,) = [one.ApplicationUri for one in found]
                assert ":bearing-twin:" in own
            finally:
                client.disconnect_socket()

        await apart(look)
