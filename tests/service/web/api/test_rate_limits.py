"""Too many wrong keys from an address, too many requests of a key."""

from typing import Any

from patience import patience

SESSION = "/api/v1/session"
WRONG = "bt_00000000_" + "A" * 43


def assert_must_wait(response: Any) -> None:
    assert response.status_code == 429
    assert response.headers["content-type"] == "application/problem+json"
    assert 1 <= int(response.headers["retry-after"]) <= 60


async def test_an_address_may_log_in_wrongly_ten_times_a_minute(world: Any) -> None:
    guesser, other = world.client(), world.client(address=("203.0.113.10", 1), timeout=patience(4))
    for _ in range(10):
        assert (await guesser.post(SESSION, json={"key": "wrong"})).status_code == 401
    assert_must_wait(await guesser.post(SESSION, json={"key": "wrong"}))
    # The right key has to wait there too, or a guess would be told from a wrong one.
    assert_must_wait(await guesser.post(SESSION, json={"key": world.keys["viewer"]}))
    assert (await other.post(SESSION, json={"key": world.keys["viewer"]})).status_code == 200
    # Whoever polls with a good key from there is not disturbed, nor is a probe.
    assert (await world.client("viewer").get("/api/v1/assets")).status_code == 200
    assert (await guesser.get("/livez")).status_code == 200


async def test_others_wrong_log_ins_do_not_stop_a_key_that_is_in_use(world: Any) -> None:
    at_desk, guesser = world.client(), world.client(timeout=patience(4))
    viewer = {"key": world.keys["viewer"]}
    assert (await at_desk.post(SESSION, json=viewer)).status_code == 200
    for number in range(150):
        await guesser.post(SESSION, json={"key": f"wrong-{number}"})
    assert_must_wait(await guesser.post(SESSION, json={"key": "wrong"}))
    assert (await at_desk.post(SESSION, json=viewer)).status_code == 200
    # A key that was revoked is a guess as any other.
    assert (await world.client("admin").delete(f"/api/v1/keys/{viewer['key'][:11]}")).is_success
    assert_must_wait(await at_desk.post(SESSION, json=viewer))


async def test_a_key_opens_only_so_many_sessions_a_minute(world: Any) -> None:
    world.limit("logins", 3)
    for address in ("203.0.113.1", "203.0.113.2", "203.0.113.3", "203.0.113.4"):
        client = world.client(address=(address, 1))
        last = await client.post(SESSION, json={"key": world.keys["viewer"]})
    assert_must_wait(last)
    for _ in range(3):  # a key that opens no session counts as well
        gateway = await client.post(SESSION, json={"key": world.keys["gateway"]})
        assert gateway.status_code == 403
    assert_must_wait(await client.post(SESSION, json={"key": world.keys["gateway"]}))
    other = world.client(address=("203.0.113.4", 1))
    answer = await other.post(SESSION, json={"key": world.keys["operator"]})
    assert answer.status_code == 200


async def test_the_addresses_of_an_ipv6_network_count_as_one(world: Any) -> None:
    for number in range(10):
        guesser = world.client(address=(f"2001:db8::{number}", 1))
        assert (await guesser.post(SESSION, json={"key": "wrong"})).status_code == 401
    same, other = (world.client(address=(f"2001:db8:0:{net}::9", 1)) for net in (0, 1))
    assert_must_wait(await same.post(SESSION, json={"key": "wrong"}))
    assert (await other.post(SESSION, json={"key": "wrong"})).status_code == 401


async def test_an_address_may_try_ten_different_wrong_keys_a_minute(world: Any) -> None:
    client = world.client()
    for number in range(10):
        key = {"X-API-Key": WRONG[:-2] + f"{number:02d}"}
        for _ in range(3):  # a client that goes on with one wrong key is told so again
            assert (await client.get("/api/v1/assets", headers=key)).status_code == 401
    assert_must_wait(await client.get("/api/v1/assets", headers={"X-API-Key": WRONG}))
    # What has not even the form of a key costs nothing and is told as ever.
    for number in range(20):
        nonsense = {"X-API-Key": f"secret-{number}"}
        assert (await client.get("/api/v1/assets", headers=nonsense)).status_code == 401
    basic = world.client(auth=("", WRONG[:-1] + "B"))
    assert_must_wait(await basic.get("/api/v1/assets"))
    again = {"X-API-Key": WRONG[:-2] + "00"}
    assert (await client.get("/api/v1/assets", headers=again)).status_code == 401


async def test_a_key_may_make_only_so_many_requests(world: Any) -> None:
    world.limit("requests", 5)
    viewer = world.client("viewer")
    for _ in range(5):
        assert (await viewer.get("/api/v1/assets")).status_code == 200
    assert_must_wait(await viewer.get("/api/v1/assets"))
    assert (await viewer.get("/livez")).status_code == 200
    assert (await viewer.get("/readyz")).status_code == 200
    assert (await world.client("operator").get("/api/v1/assets")).status_code == 200
