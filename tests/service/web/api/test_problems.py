from typing import Any

import pytest
from structlog.testing import capture_logs

from service.web.api.cursors import After, encode_cursor
from service.web.api.problems import ProblemDocument

from .test_query_names import calls

JSON = {"Content-Type": "application/json"}
FORECASTS = "/api/v1/assets/bench-1/forecasts"


def step(**changes: float) -> dict[str, float]:
    return {"duration_s": 60, "speed_rpm": 1500, "load_n": 2650} | changes


def problem_of(response: Any, status: int) -> ProblemDocument:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    document = ProblemDocument.model_validate_json(response.content)
    assert document.status == status
    assert document.instance == response.request.url.path
    return document


@pytest.mark.parametrize(
    ("body", "pointer", "expected"),
    [
        ({}, "/profile", "required"),
        ({"profile": []}, "/profile", "at least 1"),
        ({"profile": [step()] * 201}, "/profile", "at most 200"),
        ({"profile": [step(duration_s=0)]}, "/profile/0/duration_s", "greater than 0"),
        ({"profile": [step(), step(speed_rpm=20_001)]}, "/profile/1/speed_rpm", "got 20001"),
        ({"profile": [step(speed_rpm=-1)]}, "/profile/0/speed_rpm", "greater than or equal to 0"),
        ({"profile": [step(load_n=200_001)]}, "/profile/0/load_n", "200000"),
        ({"profile": [step(ambient_c=81)]}, "/profile/0/ambient_c", "80"),
        ({"profile": [step(ambient_c=-41)]}, "/profile/0/ambient_c", "-40"),
        ({"profile": [step(duration_s=100_000)] * 2}, "/profile", "48 h"),
        ({"profile": [step(duration_s=7200)], "step_s": 1}, "/step_s", "at most 3000"),
        ({"profile": [step()], "step_s": 0}, "/step_s", "greater than 0"),
        ({"profile": [step()], "nodes": ["t_node_14_c"]}, "/nodes/0", "t_node_13_c"),
        ({"profile": [step(torque_nm=1)]}, "/profile/0/torque_nm", "not permitted"),
        ({"profile": [{"duration_s": 60}]}, "/profile/0/speed_rpm", "required"),
        ([1], "", "dict"),
    ],
)
async def test_wrong_body_is_named_by_pointer(
    world: Any, body: Any, pointer: str, expected: str
) -> None:
    problem = problem_of(await world.client("operator").post(FORECASTS, json=body), 422)
    assert problem.errors[0].pointer == pointer
    assert expected in problem.errors[0].detail
    assert problem.errors[0].detail in problem.detail


@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999"])
async def test_not_a_number_is_refused(world: Any, number: str) -> None:
    text = f'{{"profile": [{{"duration_s": {number}, "speed_rpm": 1, "load_n": 1}}]}}'
    response = await world.client("operator").post(
        FORECASTS, content=text, headers={"Content-Type": "application/json"}
    )
    assert problem_of(response, 422).errors[0].pointer == "/profile/0/duration_s"


async def test_broken_json_says_where(world: Any) -> None:
    response = await world.client("operator").post(
        FORECASTS, content='{"profile": [}', headers={"Content-Type": "application/json"}
    )
    problem = problem_of(response, 422)
    assert problem.errors[0].pointer == ""
    assert "character 13" in problem.detail


async def test_pointer_leaves_out_names_of_alternatives(world: Any) -> None:
    response = await world.client("engineer").post(
        "/api/v1/assets/bench-1/identifications",
        json={"windows": [{"start": "2026-11-21T08:00:00", "end": "2026-11-21T09:00:00Z"}]},
    )
    problem = problem_of(response, 422)
    pointers = {error.pointer for error in problem.errors}
    assert "/windows/0/start" in pointers
    assert pointers <= {"/windows/0/start", "/windows"}


async def test_several_errors_are_all_listed(world: Any) -> None:
    body = {"profile": [step(speed_rpm=-1, load_n=-1)]}
    problem = problem_of(await world.client("operator").post(FORECASTS, json=body), 422)
    assert [error.pointer for error in problem.errors] == [
        "/profile/0/speed_rpm",
        "/profile/0/load_n",
    ]
    assert "(and 1 more)" in problem.detail


@pytest.mark.parametrize(
    ("query", "parameter"),
    [
        ("start=2026-11-21T08:00:00", "start"),
        ("end=yesterday", "end"),
        ("limit=0", "limit"),
        ("limit=50001", "limit"),
        ("resolution=2s", "resolution"),
        ("format=xml", "format"),
        ("cursor=abc", "cursor"),
        ("channel=t_missing_c", "channel"),
        ("limit=5&channel=speed_rpm&channel=t_inner_ring_c&limit=6", "limit"),
        ("start=2026-11-21T08:00:00Z&end=2026-11-21T08:00:00Z", "start"),
    ],
)
async def test_wrong_parameter_is_named(world: Any, query: str, parameter: str) -> None:
    response = await world.client("viewer").get(f"/api/v1/assets/bench-1/measurements?{query}")
    problem = problem_of(response, 422)
    assert problem.errors[0].parameter == parameter


async def test_unknown_asset_names_those_there_are(world: Any) -> None:
    problem = problem_of(await world.client("viewer").get("/api/v1/assets/bench-9"), 404)
    assert problem.errors[0].parameter == "asset_id"
    assert "bench-1" in problem.detail


async def test_errors_of_the_framework_are_problems_too(world: Any) -> None:
    viewer = world.client("viewer")
    assert "nothing at /nowhere" in problem_of(await viewer.get("/nowhere"), 404).detail
    problem_of(await viewer.get("/api/v1/nowhere"), 404)
    response = await viewer.patch("/api/v1/assets")
    problem_of(response, 405)
    assert response.headers["allow"] == "GET, HEAD"
    problem_of(await world.client("operator").patch(FORECASTS), 405)


@pytest.mark.parametrize("body", [b"[" * 60_000, b'{"seed": ' + b"9" * 50_000 + b"}"])
async def test_a_body_that_no_parser_takes_is_refused(world: Any, body: bytes) -> None:
    response = await world.client("engineer").post(
        "/api/v1/assets/bench-1/identifications",
        content=body,
        headers={"Content-Type": "application/json"},
    )
    problem_of(response, 400)


async def test_nul_reaches_no_database(world: Any) -> None:
    engineer, bench = world.client("engineer"), "/api/v1/assets/bench-1"
    problem_of(await engineer.get(f"{bench}/identifications/%00"), 400)
    problem_of(await engineer.get(f"{bench}/measurements?channel=%00"), 400)
    activation = {"comment": "a\x00b"}
    problem = problem_of(await engineer.post(f"{bench}/models/1/activate", json=activation), 422)
    assert problem.errors[0].pointer == "/comment"
    cursor = encode_cursor(After(after="\x00"))
    problem_of(await engineer.get(f"{bench}/models?cursor={cursor}"), 422)


@pytest.mark.parametrize("announced", [True, False])
async def test_too_long_a_body_is_refused(world: Any, announced: bool) -> None:
    long = b'{"profile": [' + b" " * 300 * 1024 + b"]}"

    async def pieces() -> Any:
        yield long

    response = await world.client("operator").post(
        FORECASTS,
        content=long if announced else pieces(),
        headers={"Content-Type": "application/json"},
    )
    assert "262144 bytes" in problem_of(response, 413).detail


@pytest.mark.parametrize(
    "kind", ["application/x-www-form-urlencoded", "text/plain; charset=utf-8", ""]
)
async def test_a_body_that_is_no_json_is_refused(world: Any, kind: str) -> None:
    headers = {"Content-Type": kind} if kind else {}
    response = await world.client("operator").post(FORECASTS, content=b"{}", headers=headers)
    assert "expected application/json" in problem_of(response, 415).detail
    assert response.headers["accept-post"] == "application/json"


async def test_a_body_may_be_left_out_where_it_may(world: Any) -> None:
    problem_of(await world.client("operator").post("/api/v1/alarms/none/acknowledge"), 404)


async def test_what_nobody_expected_is_logged_and_says_nothing(world: Any) -> None:
    world.bench.summary = lambda: 1 / 0
    with capture_logs() as logs:
        problem = problem_of(await world.client("viewer").get("/api/v1/assets/bench-1"), 500)
    assert "ZeroDivisionError" not in problem.model_dump_json()
    of_cell, entry = logs
    assert (of_cell["event"], of_cell["command"]) == ("command_failed", "Assets.documents")
    assert (entry["event"], entry["path"]) == ("request_failed", "/api/v1/assets/bench-1")
    for one in logs:
        assert "ZeroDivisionError" in one["traceback"]
        assert world.keys["viewer"] not in str(one)


async def test_every_answer_carries_the_security_headers(world: Any) -> None:
    for response in (
        await world.client().get("/livez"),
        await world.client().get("/api/v1/assets"),
        await world.client("viewer").get("/api/v1/assets"),
        await world.client().get("/nowhere"),
    ):
        policy = response.headers["content-security-policy"]
        assert "default-src 'self'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "script-src" not in policy
        assert response.headers["x-content-type-options"] == "nosniff"
        assert response.headers["referrer-policy"] == "no-referrer"
    assert response.headers["cache-control"] == "no-cache"


async def test_a_secret_is_never_echoed(world: Any) -> None:
    response = await world.client().post("/api/v1/session", json={"key": "k" * 300})
    problem = problem_of(response, 422)
    assert problem.errors[0].pointer == "/key"
    assert "kkk" not in response.text


async def test_listings_have_items_and_next(world: Any) -> None:
    engineer = world.client("engineer")
    for path in (
        "/api/v1/assets",
        "/api/v1/assets/bench-1/windows",
        "/api/v1/assets/bench-1/models",
        "/api/v1/assets/bench-1/models/activations",
        "/api/v1/assets/bench-1/identifications",
        "/api/v1/assets/bench-1/measurements",
        "/api/v1/alarms",
        "/api/v1/alarms/journal",
    ):
        document = (await engineer.get(path)).json()
        assert isinstance(document["items"], list), path
        assert document["next"] is None, path


HALF = '"\\ud83d"'  # of a surrogate pair: JSON may spell it, no text holds it


async def test_half_a_surrogate_pair_is_refused_in_one_line(world: Any) -> None:
    """Its name and its value, in the body of every call and in the lists that are imported."""
    admin = world.client("admin")
    bodies = [f"{{{HALF}: {HALF}}}", f"[{HALF}]", HALF]
    for method, path in calls(world):
        if method not in ("POST", "PUT", "PATCH"):
            continue
        for body in bodies:
            answer = await admin.request(method, path, content=body, headers=JSON)
            assert answer.status_code < 500, (method, path, body, answer.text)
            assert "\n" not in answer.json().get("detail", ""), (method, path, body)
    for path, body in (
        ("/api/v1/assets:import", f'{{"assets": [{{"id": {HALF}, "template": "axle"}}]}}'),
        ("/api/v1/assets:import", f'{{"assets": [{{"id": "a", "group": {HALF}}}]}}'),
        ("/api/v1/alarm-settings/import", f'{{"rows": [{{"asset": {HALF}, "tag": "t"}}]}}'),
        ("/api/v1/alarm-settings/import", f'{{"rows": [], "comment": {HALF}}}'),
        ("/api/v1/assets:remove", f'{{"ids": [{HALF}]}}'),
        ("/api/v1/keys", f'{{"role": {HALF}}}'),
    ):
        answer = await admin.post(path, content=body, headers=JSON)
        assert answer.status_code in (400, 422), (path, body, answer.text)
        assert "\n" not in answer.json()["detail"]
