from typing import Any

import pytest

from service.documents.identification import JobDocument, JobList, WindowList

JOBS = "/api/v1/assets/bench-1/identifications"


async def start(world: Any, key: str | None = None, **body: Any) -> Any:
    headers = {} if key is None else {"Idempotency-Key": key}
    return await world.client("engineer").post(JOBS, json=body, headers=headers)


async def test_windows_are_listed(world: Any) -> None:
    response = await world.client("engineer").get("/api/v1/assets/bench-1/windows")
    (window,) = WindowList.model_validate(response.json()).items
    assert window.start < window.end


async def test_job_is_accepted_and_found_at_its_location(world: Any) -> None:
    response = await start(world)
    assert response.status_code == 202
    assert int(response.headers["retry-after"]) > 0
    job = JobDocument.model_validate(response.json())
    assert response.headers["location"] == f"{JOBS}/{job.id}"
    client = world.client("engineer")
    assert (await client.get(response.headers["location"])).json() == response.json()
    assert (await client.get("/api/v1/assets/rig-2/identifications/" + job.id)).status_code == 404
    listed = JobList.model_validate((await client.get(JOBS)).json())
    assert [one.id for one in listed.items] == [job.id]


async def test_request_reaches_the_job_manager_with_who_asked(world: Any) -> None:
    windows = [{"start": "2026-11-21T08:00:00Z", "end": "2026-11-21T10:00:00+01:00"}]
    response = await start(world, windows=windows, method="refine", seed=7, budget=5000)
    shown = response.json()
    asked = {name: shown[name] for name in ("windows", "method", "seed", "budget", "requested_by")}
    assert asked == {
        "windows": [{"start": "2026-11-21T08:00:00.000Z", "end": "2026-11-21T09:00:00.000Z"}],
        "method": "refine",
        "seed": 7,
        "budget": 5000,
        "requested_by": f"engineer {world.keys['engineer'][:11]}",
    }


async def test_second_job_conflicts_and_shows_the_first(world: Any) -> None:
    first = (await start(world)).json()
    response = await start(world)
    assert response.status_code == 409
    assert response.json()["job"]["id"] == first["id"]


async def test_same_idempotency_key_gives_the_same_job(world: Any) -> None:
    first = await start(world, key="once")
    again = await start(world, key="once")
    assert again.status_code == 202
    assert again.json()["id"] == first.json()["id"]
    assert again.headers["location"] == first.headers["location"]
    assert (await start(world, key="twice")).status_code == 409


async def test_cancelled_job_stays_cancelled(world: Any) -> None:
    job_id = (await start(world)).json()["id"]
    client = world.client("engineer")
    assert (await client.delete(f"{JOBS}/{job_id}")).json()["status"] == "cancelled"
    assert (await client.delete(f"{JOBS}/{job_id}")).json()["status"] == "cancelled"
    assert (await client.delete(f"{JOBS}/none")).status_code == 404
    assert (await start(world)).status_code == 202


@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        ({"windows": "all"}, "/windows"),
        ({"method": "guess"}, "/method"),
        ({"seed": -1}, "/seed"),
        ({"seed": 1.5}, "/seed"),
        ({"budget": 0}, "/budget"),
        ({"windows": [{"start": "2026-11-21T08:00:00Z"}]}, "/windows/0/end"),
        (
            {"windows": [{"start": "2026-11-21T08:00:00Z", "end": "2026-11-21T08:00:00Z"}]},
            "/windows/0/end",
        ),
    ],
)
async def test_wrong_request_is_refused(world: Any, body: dict[str, Any], pointer: str) -> None:
    response = await start(world, **body)
    assert response.status_code == 422
    assert pointer in {error["pointer"] for error in response.json()["errors"]}
    assert (await world.client("engineer").get(JOBS)).json()["items"] == []
