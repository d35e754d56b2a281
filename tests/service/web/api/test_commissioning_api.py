"""What is done on the page *Commissioning* leaves its lines in the audit trail."""

from pathlib import Path
from typing import Any

import pytest

from service.site.settings import Settings, load_settings

BASE = "/api/v1/commissioning"
STRANGE = {"name": "strange", "driver": "modbus-tcp", "host": "127.0.0.1", "port": 9}
DBC = 'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|9] "" A\n'


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    file = tmp_path / "bench.toml"
    file.write_text(f'[service]\ndata_dir = "{tmp_path}"\n', encoding="utf-8")
    return load_settings(file)


async def lines(world: Any) -> list[tuple[str, str, str]]:
    items = (await world.client("admin").get("/api/v1/audit")).json()["items"]
    found = [(one["action"], one["target"], one["detail"]) for one in items]
    return [one for one in found if not one[0].startswith("key.")][::-1]


async def test_a_look_at_a_device_and_each_save_leave_a_line(world: Any) -> None:
    admin = world.client("admin", timeout=60)
    asked = {"source": STRANGE, "count": 1}
    assert (await admin.post(f"{BASE}/registers", json=asked)).is_success
    assert (await admin.post(f"{BASE}/units", json=asked)).is_success
    assert (await admin.post(f"{BASE}/dbc", json={"name": "a.dbc", "text": DBC})).is_success
    revision = (await admin.get(BASE)).json()["revision"]
    change = {"revision": revision, "sources": [STRANGE]}
    assert (await admin.post(f"{BASE}/check", json=change)).is_success
    looks = [
        ("commissioning.read", "", "driver modbus-tcp, host 127.0.0.1, port 9"),
        ("commissioning.scan", "", "driver modbus-tcp, host 127.0.0.1, port 9"),
        ("commissioning.dbc", "a.dbc", "1 signals"),
    ]
    assert await lines(world) == looks
    saved = await admin.put(f"{BASE}/configuration", json=change)
    assert saved.is_success, saved.text
    assert (await lines(world))[3:] == [
        ("configuration.save", "bench.toml", "sources: strange"),
    ]
    first = (await admin.get(f"{BASE}/versions")).json()["items"][-1]["number"]
    again = {"revision": saved.json()["revision"]}
    assert (await admin.post(f"{BASE}/versions/{first}/restore", json=again)).is_success
    assert (await lines(world))[4:] == [
        ("configuration.save", "bench.toml", f"version {first} again"),
    ]


async def test_what_is_refused_leaves_no_line(world: Any) -> None:
    admin = world.client("admin", timeout=60)
    stale = {"revision": "old", "sources": [STRANGE]}
    assert (await admin.put(f"{BASE}/configuration", json=stale)).status_code == 409
    assert (await admin.post(f"{BASE}/dbc", json={"name": "b.dbc", "text": "?"})).is_error
    assert (await admin.post(f"{BASE}/signals", json={"source": STRANGE})).status_code == 422
    assert await lines(world) == []
