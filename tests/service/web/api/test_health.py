import asyncio
import contextlib
import socket
import sqlite3
from typing import Any

import pytest
from prometheus_client import Counter

from adapters.samples import Sample
from service.bus import health_reports
from service.bus.commands import Present
from service.bus.memory import MemoryBus
from service.bus.messages import CellState
from service.documents.health import Ready
from service.site.settings import SecuritySection


async def ready(world: Any, role: str | None = None) -> tuple[int, Ready]:
    await world.report()
    response = await world.client(role).get("/readyz")
    return response.status_code, Ready.model_validate(response.json())


async def test_livez_answers_without_a_key(world: Any) -> None:
    response = await world.client().get("/livez")
    assert (response.status_code, response.json()) == (200, {"status": "alive"})


async def test_ready_while_all_is_well(world: Any) -> None:
    status, document = await ready(world)
    assert (status, document.status) == (200, "ready")
    assert {check.name for check in document.checks} == {
        "store",
        "twin:bench-1",
        "twin:rig-2",
        "source:pt100",
    }


async def test_broken_source_degrades_and_hosts_are_told_to_keys_only(world: Any) -> None:
    world.sources[0].up = False
    world.sources[0].detail = "10.1.2.3:5020 does not answer"
    status, document = await ready(world)
    assert (status, document.status) == (200, "degraded")
    assert "10.1.2.3" not in document.model_dump_json()
    assert "10.1.2.3" not in (await ready(world, "gateway"))[1].model_dump_json()
    assert "10.1.2.3" in (await ready(world, "viewer"))[1].model_dump_json()


async def test_assets_of_which_none_can_be_followed_are_not_ready(world: Any) -> None:
    world.health.follows_nothing = lambda: True
    status, document = await ready(world, "viewer")
    assert (status, document.status) == (503, "not ready")
    check = next(check for check in document.checks if check.name == "followed")
    assert (check.status, check.detail) == ("failed", "no asset is followed; see assets")


async def test_broken_sensor_degrades(world: Any) -> None:
    world.bench.tags["t_outer_ring_c"] |= {"value": None, "quality": 16}
    status, document = await ready(world, "viewer")
    assert (status, document.status) == (200, "degraded")
    check = next(check for check in document.checks if check.name == "twin:bench-1")
    assert check.detail == "no good data: t_outer_ring_c"


async def test_twin_that_does_not_run_fails(world: Any) -> None:
    world.bench.running = False
    status, document = await ready(world)
    assert (status, document.status) == (503, "not ready")


async def test_store_that_does_not_answer_degrades_while_the_spool_takes_samples(
    world: Any,
) -> None:
    world.store.close()
    database = world.data_dir / "bearing-twin.db"
    database.rename(world.data_dir / "elsewhere.db")
    database.mkdir()  # nothing can be opened there
    status, document = await ready(world)
    assert (status, document.status) == (200, "degraded")
    assert next(check for check in document.checks if check.name == "store").status == "degraded"
    now_us = world.clock.now_us()
    sample = Sample("rig-2", "ambient_c", now_us, 21.0, 192, now_us)
    with contextlib.closing(sqlite3.connect(world.data_dir / "spool.db")) as intruder:
        intruder.isolation_level = None
        intruder.execute("BEGIN EXCLUSIVE")
        world.ingest.submit([sample])
        for _ in range(300):
            status, document = await ready(world)
            if status == 503:
                break
            await asyncio.sleep(0.1)
        assert document.status == "not ready"
        check = next(check for check in document.checks if check.name == "store")
        assert check.status == "failed"


async def test_a_publisher_that_does_not_reach_its_broker_degrades_and_is_named(world: Any) -> None:
    await world.health.present(
        Present("plant", 10**8, publishers={"mqtt": "10.1.2.3:1883: refused", "opcua": ""})
    )
    status, document = await ready(world, "viewer")
    assert (status, document.status) == (200, "degraded")
    publishers = [one for one in document.checks if one.name.startswith("publisher:")]
    assert [(one.name, one.status, one.detail) for one in publishers] == [
        ("publisher:mqtt", "degraded", "10.1.2.3:1883: refused"),
        ("publisher:opcua", "ok", "hands everything on"),
    ]
    assert "10.1.2.3" not in (await ready(world))[1].model_dump_json()
    await world.health.present(Present("plant", 10**8, publishers={"mqtt": "", "opcua": ""}))
    assert (await ready(world))[1].status == "ready"


async def test_who_asks_for_health_and_metrics_never_asks_the_cell(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def asked(self: Any, command: Any, patience_s: float) -> Any:
        raise AssertionError(f"the cell was asked {command}")

    monkeypatch.setattr(MemoryBus, "ask", asked)
    for _ in range(3):
        assert (await world.client().get("/readyz")).status_code == 200
        text = (await world.client("viewer").get("/metrics")).text
        assert "bearing_twin_samples_accepted_total" in text


async def test_a_cell_that_does_not_say_how_it_is_fails(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health_reports, "HEALTH_HOLDS_S", 0.05)
    await asyncio.sleep(0.1)
    response = await world.client("viewer").get("/readyz")
    (check,) = Ready.model_validate(response.json()).checks
    assert (response.status_code, check.name, check.status) == (503, "cell", "failed")
    assert "has not said how it is" in (check.detail or "")
    assert (await ready(world))[0] == 200
    # One that has begun again has not said anything yet.
    world.joint.epoch = "another"
    world.joint.report(CellState(waits_for="the store"))
    response = await world.client("viewer").get("/readyz")
    (check,) = Ready.model_validate(response.json()).checks
    assert (response.status_code, check.detail) == (503, "the cell waits for the store")
    monkeypatch.setattr(MemoryBus, "away_s", 3.0)
    (check,) = Ready.model_validate((await world.client("viewer").get("/readyz")).json()).checks
    assert check.detail == "no sign of the cell for 3 s"


async def test_keys_cannot_be_checked_without_the_store(world: Any) -> None:
    client = world.client("viewer")
    world.store.close()
    database = world.data_dir / "bearing-twin.db"
    database.rename(world.data_dir / "elsewhere.db")
    database.mkdir()
    response = await client.get("/api/v1/assets")
    assert response.status_code == 503
    assert int(response.headers["retry-after"]) > 0


async def test_metrics_show_the_registry(world: Any) -> None:
    Counter("bearing_twin_test", "For the test.", registry=world.context.registry).inc(3)
    await world.report()
    response = await world.client("viewer").get("/metrics")
    assert response.headers["content-type"].startswith("text/plain")
    assert "bearing_twin_test_total 3.0" in response.text
    assert "bearing_twin_samples_accepted_total" in response.text


@pytest.mark.parametrize(
    ("address", "headers", "status"),
    [
        ("127.0.0.1", {}, 200),
        ("127.0.0.1", {"Host": "localhost:8080"}, 200),
        ("127.0.0.1", {"Host": "[::1]:8080"}, 200),
        ("127.0.1.1", {"Host": socket.gethostname()}, 200),
        ("127.0.0.1", {"Host": "bench.example:8080"}, 401),  # a name that was led here
        ("127.0.0.1", {"Host": "localhost.example"}, 401),
        ("127.8.8.8", {}, 200),
        ("::1", {}, 200),
        ("127.0.0.1", {"X-Forwarded-For": "198.51.100.7"}, 401),
        ("127.0.0.1", {"Forwarded": "for=198.51.100.7"}, 401),
        ("203.0.113.9", {}, 401),
        ("fe80::1%eth0", {}, 401),
        ("testclient", {}, 401),
    ],
)
async def test_metrics_need_no_key_on_loopback(
    world: Any, address: str, headers: dict[str, str], status: int
) -> None:
    client = world.client(address=(address, 40_000), base_url="http://127.0.0.1:8080")
    assert (await client.get("/metrics", headers=headers)).status_code == status


async def test_metrics_can_be_opened_by_configuration(world: Any) -> None:
    security = SecuritySection(allow_unauthenticated_metrics=True)
    settings = world.context.settings.model_copy(update={"security": security})
    object.__setattr__(world.context, "settings", settings)
    assert (await world.client().get("/metrics")).status_code == 200


async def test_docs_load_only_our_own_files(world: Any) -> None:
    client = world.client()
    page = await client.get("/docs")
    assert page.status_code == 200
    assert "//" not in page.text.replace("<!doctype html>", "")
    for file in ("swagger-ui/swagger-ui.css", "swagger-ui/swagger-ui-bundle.js", "start.js"):
        assert f"/docs/files/{file}" in page.text
        assert (await client.get(f"/docs/files/{file}")).status_code == 200


async def test_dashboard_needs_no_key(world: Any) -> None:
    response = await world.client().get("/")
    assert response.status_code == 200
    assert "text/html" in response.headers["content-type"]
