"""The OPC UA server, asked by a real client in an event loop of its own."""

import asyncio
import contextlib
import socket
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from opcua_site import BEGAN, WRONG, Asset, Changes, apart, make_client, node_id, read, serving
from patience import wait_for, within

from adapters.samples import Quality
from service.clock import from_rfc3339
from service.domain.errors import TemporaryError
from service.plant import publishers as outlets
from service.plant.opcua.codes import status_code, unit_id
from service.security.authenticator import FAILED_LOGINS_PER_MINUTE
from service.security.keys import create_key, revoke_key
from service.site.configuration import SettingsError
from service.site.settings import OpcUaSection, Settings
from service.store import Outbox, Store


@pytest.mark.wires
async def test_tags_are_read_and_subscribed_but_never_written(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    asset = Asset()
    async with serving(asset, tmp_path, store, outbox) as address:

        async def look() -> None:
            async with Client(address) as client:
                assert (await client.get_namespace_array())[2] == "urn:bearing-twin"
                bench = await client.nodes.objects.get_child("2:bench-1")
                names = [
                    (await node.read_browse_name()).Name for node in await bench.get_children()
                ]
                assert names == list(asset.tags)
                ring = await read(client, "t_inner_ring_c")
                assert (ring.Value.Value, ring.StatusCode.value) == (61.5, 0)
                assert round(ring.SourceTimestamp.timestamp() * 1e6) == from_rfc3339(BEGAN)
                unit = await client.get_node(
                    node_id("t_inner_ring_c/EngineeringUnits")
                ).read_value()
                assert (unit.DisplayName.Text, unit.UnitId) == ("°C", 4408652)
                # Good and without a value: the limit is not reached within the horizon.
                never = await read(client, "t_inner_ring_c.time_to_alarm_s")
                assert (never.Value.Value, never.StatusCode.value) == (None, 0)
                with pytest.raises(ua.UaStatusCodeError):
                    await client.get_node(node_id("t_inner_ring_c")).write_value(99.0)
                with pytest.raises(ua.UaStatusCodeError):
                    await bench.add_variable(2, "mine", 1.0)
                assert (await read(client, "t_inner_ring_c")).Value.Value == 61.5

        await apart(look)
        loop = asyncio.get_running_loop()

        async def follow() -> list[tuple[Any, int]]:
            async with Client(address) as client:
                changes = Changes()
                subscription = await client.create_subscription(200, changes)
                await subscription.subscribe_data_change(client.get_node(node_id("t_inner_ring_c")))
                seen = [await wait_for(changes.values.get(), 20)]
                for value, quality in ((62.5, 192), (63.5, 80), (None, 16)):
                    loop.call_soon_threadsafe(asset.tell, "t_inner_ring_c", value, quality)
                    seen.append(await wait_for(changes.values.get(), 20))
                return seen

        assert await apart(follow) == [
            (61.5, 0),
            (62.5, 0),
            (63.5, ua.StatusCodes.UncertainSensorNotAccurate),
            (None, ua.StatusCodes.BadSensorFailure),
        ]


@pytest.mark.wires
async def test_clients_come_and_go_and_a_tag_that_is_new_appears(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    asset = Asset()
    async with serving(asset, tmp_path, store, outbox) as address:

        async def vanish() -> None:
            client = Client(address)
            await client.connect()
            await client.create_subscription(100, Changes())
            client.uaclient.protocol.transport.abort()
            for task in asyncio.all_tasks() - {asyncio.current_task()}:
                task.cancel()

        for _ in range(3):
            await apart(vanish)
        asset.tell("load_n", 2650.0, unit="N")

        async def look() -> float:
            async with Client(address) as client, within(20):
                while True:
                    found = await read(client, "load_n")
                    if found.StatusCode.is_good():
                        return float(found.Value.Value)
                    await asyncio.sleep(0.05)

        assert await apart(look) == 2650.0


@pytest.mark.wires
async def test_beyond_loopback_a_key_is_asked_for_and_the_line_is_encrypted(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    viewer, gateway = (create_key(store, role).text for role in ("viewer", "gateway"))
    async with serving(Asset(), tmp_path, store, outbox, host="0.0.0.0") as address:

        async def value(password: str | None) -> Any:
            async with await make_client(address, password, encrypted=True) as client:
                return (await read(client, "t_inner_ring_c")).Value.Value

        for password in (None, "a wrong key", gateway):
            with pytest.raises(ua.UaStatusCodeError):
                await apart(lambda offered=password: value(offered))
        assert await apart(lambda: value(viewer)) == 61.5
    assert (tmp_path / "opcua").stat().st_mode & 0o077 == 0


async def activate(address: str, key: str) -> None:
    """Open a session with a key, and close it."""
    client = Client(address)
    client.set_user("scada")
    client.set_password(key)
    async with client:
        pass


@pytest.mark.wires
async def test_wrong_keys_are_noted_and_an_address_has_only_so_many(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    good, other = create_key(store, "viewer").text, create_key(store, "operator").text
    async with serving(Asset(), tmp_path, store, outbox) as address:

        async def guess() -> None:
            await activate(address, good)
            for number in range(FAILED_LOGINS_PER_MINUTE):
                for _ in range(2):  # the same wrong key again is known, and counts once
                    with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                        await activate(address, WRONG[:-2] + f"{number:02d}")
            with pytest.raises(ua.uaerrors.BadTooManyOperations):
                await activate(address, WRONG)
            with pytest.raises(ua.uaerrors.BadTooManyOperations):
                await activate(address, other)  # or a guess would be told from a wrong one
            await activate(address, good)  # who is known already is not disturbed

        await apart(guess)
        assert outbox.flush(30)
    lines = [line for line in store.audit.page().items if line.action == "key.refuse"]
    # One line at once; the others of this minute are counted (see the tests of the audit trail).
    assert [(line.who, line.address, line.detail) for line in lines] == [
        ("unknown", "127.0.0.1", "a wrong key (bt_00000000)")
    ]


@pytest.mark.wires
async def test_a_revoked_key_ends_its_connections_and_no_other(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    revoked, kept = create_key(store, "viewer"), create_key(store, "viewer")
    async with serving(Asset(), tmp_path, store, outbox) as address:

        async def follow(key: str) -> Client:
            client = Client(address)
            client.set_user("scada")
            client.set_password(key)
            await client.connect()
            subscription = await client.create_subscription(100, Changes())
            await subscription.subscribe_data_change(client.get_node(node_id("t_inner_ring_c")))
            return client

        async def look() -> None:
            ended, stays = await follow(revoked.text), await follow(kept.text)
            await asyncio.to_thread(revoke_key, store, revoked.record.id)
            async with within(30):
                while True:
                    try:
                        await read(ended, "t_inner_ring_c")
                    except (ConnectionError, ua.UaError):
                        break
                    await asyncio.sleep(0.05)
            assert (await read(stays, "t_inner_ring_c")).Value.Value == 61.5
            with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                await activate(address, revoked.text)
            await stays.disconnect()
            with contextlib.suppress(ConnectionError, ua.UaError):
                await ended.disconnect()

        await apart(look)


def test_every_quality_has_a_status_code_of_its_severity() -> None:
    assert len({status_code(quality) for quality in Quality}) == len(Quality)
    for quality in range(256):
        severity = status_code(quality) >> 30
        assert severity == (0 if quality >= 192 else 1 if quality >= 64 else 2)
    for quality, name in {
        Quality.GOOD: "Good",
        Quality.LOCAL_OVERRIDE: "GoodLocalOverride",
        Quality.CONFIG_ERROR: "BadConfigurationError",
        Quality.LAST_USABLE: "UncertainLastUsableValue",
        Quality.EU_EXCEEDED: "UncertainEngineeringUnitsExceeded",
        Quality.WAITING_FOR_INITIAL_DATA: "BadWaitingForInitialData",
    }.items():
        assert ua.StatusCode(status_code(quality)).name == name
    # The code of the sensor, with the bits that say "constant".
    assert status_code(Quality.FROZEN) == ua.StatusCodes.UncertainSensorNotAccurate | 0x0700
    assert unit_id("") == -1


@pytest.mark.wires
def test_what_cannot_be_had_is_told_before_anything_starts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"opc.tcp://127.0.0.1:{taken.getsockname()[1]}/bearing-twin"
        wanted = Settings(opcua=OpcUaSection(enabled=True, endpoint=endpoint))
        with pytest.raises(TemporaryError, match=r"opcua.endpoint = .*already in use.*a free port"):
            outlets.check_ports(wanted)
    monkeypatch.setattr(outlets, "find_spec", lambda name: None)
    with pytest.raises(SettingsError, match=r"opcua.enabled = true: .*'bearing-twin\[opcua\]'"):
        outlets.check_extras(wanted)
    outlets.check_extras(Settings())


def test_only_an_endpoint_can_be_an_endpoint() -> None:
    for endpoint in ("http://127.0.0.1:4840", "opc.tcp://127.0.0.1/x", "opc.tcp://h:99999/"):
        with pytest.raises(ValueError, match=r"expected opc\.tcp://HOST:PORT/PATH"):
            OpcUaSection(endpoint=endpoint)
