"""Runs are listed, named, annotated, audited and reported; what cannot be is refused."""

from typing import Any

import pytest

from adapters.samples import Sample
from service.clock import MINUTE_US, rfc3339
from service.features.runs.documents import RunDetail, RunDocument, RunList

RUNS = "/api/v1/assets/bench-1/runs"
NAME = "run-in; grease <b>LGMT 3</b>"


@pytest.fixture
async def begun_us(world: Any) -> int:
    """Three runs of 20 minutes, the last of which goes on; gives the start of the first."""
    now_us = world.context.clock.now_us() // MINUTE_US * MINUTE_US
    begun_us: int = now_us - 120 * MINUTE_US
    world.store.samples.write(
        [
            Sample("bench-1", "speed_rpm", begun_us + minute * MINUTE_US, rpm, 192, 0)
            for minute in range(120)
            for rpm in [0.0 if 20 <= minute < 50 or 70 <= minute < 100 else 1500.0]
        ]
    )
    return begun_us


async def test_runs_are_listed_in_pages_latest_first(world: Any, begun_us: int) -> None:
    viewer = world.client("viewer")
    answer = await viewer.get(RUNS, params={"limit": 2})
    page = RunList.model_validate(answer.json())
    latest, middle = page.items
    assert (latest.end, latest.ended, latest.duration_s) == (None, None, None)
    assert (middle.ended, middle.duration_s) == ("standstill", 1200)
    rest = (await viewer.get(RUNS, params={"limit": 2, "cursor": page.next})).json()
    assert [one["start"] for one in rest["items"]] == [rfc3339(begun_us)]
    assert rest["next"] is None
    assert (await viewer.get(RUNS, params={"cursor": "x"})).status_code == 422


async def test_an_operator_names_and_annotates_and_the_audit_trail_tells(
    world: Any, begun_us: int
) -> None:
    operator, viewer = world.client("operator"), world.client("viewer")
    run = RunList.model_validate((await viewer.get(RUNS)).json()).items[-1]
    who = f"operator {world.keys['operator'][:11]}"
    named = await operator.patch(f"{RUNS}/{run.id}", json={"name": f" {NAME} "})
    document = RunDocument.model_validate(named.json())
    assert (document.name, document.named_by) == (NAME, who)
    note = {"time": rfc3339(begun_us + MINUTE_US), "text": "noise"}
    made = await operator.post(f"{RUNS}/{run.id}/annotations", json=note)
    assert made.status_code == 201
    detail = RunDetail.model_validate((await viewer.get(f"{RUNS}/{run.id}")).json())
    assert [one.model_dump() for one in detail.annotations] == [made.json()]
    assert (detail.name, detail.annotations[0].who) == (NAME, who)
    gone = f"{RUNS}/{run.id}/annotations/{made.json()['id']}"
    assert [(await operator.delete(gone)).status_code for _ in range(2)] == [204, 404]
    assert (await operator.patch(f"{RUNS}/{run.id}", json={"name": ""})).json()["name"] is None
    lines = [(line.action, line.who) for line in world.store.audit.page(4).items]
    expected = ["run.name", "annotation.remove", "annotation.add", "run.name"]
    assert lines == [(action, who) for action in expected]


@pytest.mark.parametrize(
    ("method", "path", "body", "status"),
    [
        ("PATCH", "", {"name": "x" * 101}, 422),
        ("PATCH", "", {"name": "two\nlines"}, 422),
        ("PATCH", "", {}, 422),
        ("POST", "/annotations", {"time": "2020-01-01T00:00:00Z", "text": "noise"}, 422),
        ("POST", "/annotations", {"time": "now", "text": "noise"}, 422),
        ("POST", "/annotations", {"text": "noise"}, 422),
        ("POST", "/annotations", {"time": None, "text": " "}, 422),
        ("POST", "/annotations", {"time": None, "text": "\u0007"}, 422),
        ("PATCH", "x", {"name": "x"}, 404),
        ("POST", "x/annotations", {"time": None, "text": "noise"}, 404),
    ],
)
async def test_what_cannot_be_kept_is_refused(
    world: Any, begun_us: int, method: str, path: str, body: dict[str, Any], status: int
) -> None:
    operator = world.client("operator")
    run = (await operator.get(RUNS)).json()["items"][-1]["id"]
    if "time" in body and body["time"] is None:
        body = body | {"time": rfc3339(begun_us)}
    answer = await operator.request(method, f"{RUNS}/{run}{path}", json=body)
    assert answer.status_code == status, answer.text
    assert world.store.audit.page(1).items[0].action == "key.create"


@pytest.mark.parametrize(
    ("format", "begin", "media_type"),
    [
        ("pdf", b"%PDF-", "application/pdf"),
        ("png", b"\x89PNG", "image/png"),
        ("csv", b"\xef\xbb\xbfRun,item", "text/csv; charset=utf-8"),
    ],
)
async def test_the_report_is_a_file(
    world: Any, begun_us: int, format: str, begin: bytes, media_type: str
) -> None:
    viewer = world.client("viewer")
    run = (await viewer.get(RUNS)).json()["items"][-1]["id"]
    answer = await viewer.get(f"{RUNS}/{run}/report", params={"format": format})
    assert answer.status_code == 200, answer.text
    assert answer.content.startswith(begin)
    assert answer.headers["content-type"] == media_type
    assert f'filename="bench-1-{run}.{format}"' in answer.headers["content-disposition"]
    assert (await viewer.get(f"{RUNS}/none/report")).status_code == 404
    assert (await viewer.get(f"{RUNS}/{run}/report?format=docx")).status_code == 422


async def test_without_matplotlib_the_list_and_the_refusal_say_what_to_install(
    world: Any, begun_us: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer = world.client("viewer")
    assert (await viewer.get(RUNS)).json()["report_formats"] == ["pdf", "png", "csv"]
    monkeypatch.setattr("service.features.runs.report.files.find_spec", lambda name: None)
    page = RunList.model_validate((await viewer.get(RUNS)).json())
    assert page.report_formats == ["csv"]
    answer = await viewer.get(f"{RUNS}/{page.items[-1].id}/report", params={"format": "pdf"})
    assert answer.status_code == 422
    assert answer.json()["detail"] == (
        "format: pdf needs matplotlib, which is not installed: "
        'pip install "matplotlib>=3.10"; expected csv'
    )
