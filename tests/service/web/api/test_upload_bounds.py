"""A sheet on its side, 100,000 columns of it, is refused soon on every way in."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from patience import patience

from service.features.alarm_settings import routes as alarm_settings
from service.features.provisioning import list_routes as asset_lists
from service.site.settings import Settings, load_settings

CSV = {"Content-Type": "text/csv; charset=utf-8"}
JSON = {"Content-Type": "application/json"}
COLUMNS = 100_000
#: What 1 MiB holds, where a body may not be longer.
FEWER = 70_000
SITE = """\
[service]
data_dir = "{0}"

[[templates]]
name = "axle"
bearing = "6311"
low_risk = {{ speed_rpm_max = 900, load_n_max = 4000 }}
values = {{ unit = 1 }}
[templates.channels]
t_outer_ring_c = {{ source = "push" }}
ambient_c = {{ source = "push" }}
speed_rpm = {{ source = "push" }}
load_n = {{ source = "push" }}

[[assets]]
id = "bench-1"
template = "axle"
"""


def header(*first: str) -> str:
    return ",".join([*first, *(f"c{number}" for number in range(COLUMNS))])


def keys(count: int = COLUMNS) -> dict[str, int]:
    return {f"c{number}": 1 for number in range(count)}


def dbc() -> str:
    signals = "".join(f' SG_ s{number} : 0|8@1+ (1,0) [0|9] "" A\n' for number in range(COLUMNS))
    return f'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n{signals}'


class Way(NamedTuple):
    """A way in: what is sent, and words of the refusal."""

    role: str
    method: str
    path: str
    body: Callable[[], str]
    said: str
    status: int = 422
    headers: dict[str, str] = JSON


AXLE = {"template": "axle"}
ALARM = {"asset": "bench-1", "tag": "t_inner_ring_c", "kind": "measured limit", "level": "alarm"}
SOURCE = {"name": "s", "driver": "modbus-tcp", "host": "127.0.0.1"}
MANY = "columns; expected at most 200"
MANY_KEYS = "keys; expected at most 200"
WAYS = {
    "assets as CSV": Way(
        "admin", "POST", "/assets:import", lambda: header("id") + "\na-1\n", MANY, 422, CSV
    ),
    "assets as CSV, an unknown column twice": Way(
        "admin", "POST", "/assets:import", lambda: header("id", "c99999"), MANY, 422, CSV
    ),
    "assets as JSON": Way(
        "admin",
        "POST",
        "/assets:import",
        lambda: json.dumps({"assets": [{"id": "a-1"} | AXLE | keys()]}),
        MANY_KEYS,
    ),
    "values of an asset as JSON": Way(
        "admin",
        "POST",
        "/assets:import",
        lambda: json.dumps({"assets": [{"id": "a-1", "values": keys()} | AXLE]}),
        MANY_KEYS,
    ),
    "alarm settings as CSV": Way(
        "engineer",
        "POST",
        "/alarm-settings/import",
        lambda: header("asset", "tag", "kind", "level"),
        MANY,
        422,
        CSV,
    ),
    "alarm settings as JSON": Way(
        "engineer",
        "POST",
        "/alarm-settings/import?comment=x",
        lambda: json.dumps({"rows": [ALARM | keys()]}),
        MANY_KEYS,
    ),
    "a sample": Way(
        "gateway",
        "POST",
        "/assets/bench-1/measurements",
        lambda: json.dumps({"samples": [keys()]}),
        "",
        200,
    ),
    "a sample of many assets": Way(
        "gateway",
        "POST",
        "/measurements",
        lambda: json.dumps({"samples": [keys()]}),
        "",
        200,
    ),
    "an asset of a configuration": Way(
        "admin",
        "PUT",
        "/commissioning/configuration",
        lambda: json.dumps({"revision": "@", "assets": [{"id": "a-1", "channels": keys(FEWER)}]}),
        MANY_KEYS,
    ),
    "a source of a configuration": Way(
        "admin",
        "POST",
        "/commissioning/check",
        lambda: json.dumps({"revision": "@", "sources": [SOURCE | keys(FEWER)]}),
        MANY_KEYS,
    ),
    "a DBC file": Way(
        "admin",
        "POST",
        "/commissioning/dbc",
        lambda: json.dumps({"name": "a.dbc", "text": dbc()}),
        "signals; expected at most",
    ),
}


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    file = tmp_path / "bench.toml"
    file.write_text(SITE.format(tmp_path), encoding="utf-8")
    return load_settings(file)


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
async def test_a_sheet_on_its_side_is_refused_soon(world: Any, way: Way) -> None:
    client = world.client(way.role, timeout=patience(60))
    body = way.body()
    if '"@"' in body:
        found = (await world.client("admin").get("/api/v1/commissioning")).json()
        body = body.replace('"@"', json.dumps(found["revision"]))
    begin_s = time.process_time()
    answer = await client.request(
        way.method, f"/api/v1{way.path}", content=body.encode(), headers=way.headers
    )
    spent_s = time.process_time() - begin_s
    assert answer.status_code == way.status, answer.text[:300]
    assert way.said in answer.text
    assert len(answer.content) < 10_000
    assert spent_s < 1.0


def cells_of(rows: int) -> str:
    line = "axle," + ",".join("1" for _ in range(198))
    return ",".join(["id", "template", *(f"c{number}" for number in range(198))]) + "".join(
        f"\na-{number},{line}" for number in range(rows)
    )


async def test_a_sheet_of_too_many_cells_is_refused(world: Any) -> None:
    answer = await world.client("admin", timeout=patience(60)).post(
        "/api/v1/assets:import", content=cells_of(5_001).encode(), headers=CSV
    )
    assert answer.status_code == 422
    assert "line 5002: more than 1000000 cells" in answer.json()["detail"]


@pytest.mark.parametrize(
    ("role", "path", "module", "body"),
    [
        ("admin", "/assets:import", asset_lists, {"assets": [{"id": "a-1"} | AXLE]}),
        ("engineer", "/alarm-settings/import?comment=x", alarm_settings, {"rows": [ALARM]}),
    ],
)
async def test_a_list_that_takes_too_long_is_refused_and_the_next_one_has_its_turn(
    world: Any, monkeypatch: pytest.MonkeyPatch, role: str, path: str, module: Any, body: Any
) -> None:
    client = world.client(role)
    with monkeypatch.context() as short:
        short.setattr(module, "JUDGING_S", 0.0)
        refused = await client.post(f"/api/v1{path}", json=body)
    assert refused.status_code == 422
    assert "takes more than 0 s of processor time" in refused.json()["detail"]
    assert (await client.post(f"/api/v1{path}", json=body)).is_success
