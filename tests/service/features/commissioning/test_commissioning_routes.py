"""What is done on the page *Commissioning* leaves its lines in the audit trail."""

from pathlib import Path
from typing import Any

import pytest
from patience import patience

from service.features.commissioning import dbc_files, file_versions
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
    admin = world.client("admin", timeout=patience(60))
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
        ("commissioning.check", "", "driver modbus-tcp, host 127.0.0.1, port 9"),
    ]
    assert await lines(world) == looks
    saved = await admin.put(f"{BASE}/configuration", json=change)
    assert saved.is_success, saved.text
    assert (await lines(world))[4:] == [
        ("configuration.save", "bench.toml", "sources: strange"),
    ]
    first = (await admin.get(f"{BASE}/versions")).json()["items"][-1]["number"]
    again = {"revision": saved.json()["revision"]}
    assert (await admin.post(f"{BASE}/versions/{first}/restore", json=again)).is_success
    assert (await lines(world))[5:] == [
        ("configuration.save", "bench.toml", f"version {first} again"),
    ]


async def test_what_is_refused_leaves_no_line(world: Any) -> None:
    admin = world.client("admin", timeout=patience(60))
    stale = {"revision": "old", "sources": [STRANGE]}
    assert (await admin.put(f"{BASE}/configuration", json=stale)).status_code == 409
    assert (await admin.post(f"{BASE}/dbc", json={"name": "b.dbc", "text": "?"})).is_error
    assert (await admin.post(f"{BASE}/signals", json={"source": STRANGE})).status_code == 422
    assert await lines(world) == []


async def test_a_check_is_no_scan_of_the_network(world: Any, settings: Settings) -> None:
    admin = world.client("admin", timeout=patience(60))
    strange = [STRANGE | {"name": f"s{number}", "port": 1 + number} for number in range(9)]
    revision = (await admin.get(BASE)).json()["revision"]
    refused = await admin.post(f"{BASE}/check", json={"revision": revision, "sources": strange})
    assert refused.status_code == 422
    assert "9 sources that are not in the file; expected at most 8" in refused.json()["detail"]
    assert await lines(world) == [], "nobody was asked"
    # What stands in the file may be asked, however many there are.
    change = {"revision": revision, "sources": strange}
    saved = (await admin.put(f"{BASE}/configuration", json=change)).json()
    again = await admin.post(f"{BASE}/check", json=change | {"revision": saved["revision"]})
    assert again.is_success, again.text
    assert (await lines(world))[-1] == ("commissioning.check", "", "the sources of the file")


@pytest.mark.parametrize(
    "network", ["/etc/hostname.toml", "../x.toml", "networks/../../x.toml", "~/x.toml"]
)
async def test_a_network_stays_in_the_folder_of_the_file(world: Any, network: str) -> None:
    admin = world.client("admin", timeout=patience(60))
    asset = {"id": "a-1", "network": network, "low_risk": {}, "channels": {}}
    revision = (await admin.get(BASE)).json()["revision"]
    for method, path in (("POST", "check"), ("PUT", "configuration")):
        change = {"revision": revision, "assets": [asset]}
        answer = await admin.request(method, f"{BASE}/{path}", json=change)
        assert answer.status_code == 422
        (error,) = answer.json()["errors"]
        assert error["pointer"] == "/assets/0/network"
        assert "expected a file in the folder of the configuration file" in error["detail"]
    table = {name: part for name, part in asset.items() if name != "id"}
    put = await admin.put("/api/v1/assets/a-1", json=table)
    assert put.status_code == 422
    assert put.json()["detail"].startswith(f"network = {network!r}: expected a file in the folder")
    body = {"assets": [asset]}
    listed = await admin.post("/api/v1/assets:import", json=body)
    assert listed.status_code == 422
    assert f"network = {network!r}: expected a file" in listed.json()["errors"][0]["detail"]


async def test_where_the_file_cannot_be_saved_the_page_hears_it_before_it_begins(
    world: Any, settings: Settings
) -> None:
    # Nobody can write there, whoever runs the tests.
    world.have(settings=settings.model_copy(update={"file": Path("/proc/bench.toml")}))
    admin = world.client("admin", timeout=patience(60))
    known = (await admin.get(BASE)).json()
    assert known["why_not"].startswith("the service cannot write into /proc (")
    assert "devices can be looked at" in known["why_not"]
    asked = {"source": STRANGE, "count": 1}
    assert (await admin.post(f"{BASE}/registers", json=asked)).is_success
    change = {"revision": known["revision"], "sources": [STRANGE]}
    assert (await admin.post(f"{BASE}/check", json=change)).is_success
    for answer in (
        await admin.put(f"{BASE}/configuration", json=change),
        await admin.post(f"{BASE}/dbc", json={"name": "a.dbc", "text": DBC}),
        await admin.post(f"{BASE}/versions/1/restore", json={"revision": known["revision"]}),
    ):
        assert answer.status_code == 409
        assert answer.json()["detail"] == known["why_not"]


async def test_dbc_files_have_a_bound(
    world: Any, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert settings.file is not None
    folder = settings.file.parent
    admin = world.client("admin", timeout=patience(60))
    monkeypatch.setattr(dbc_files, "DBC_FILES_MAX", 3)
    for number in range(3):
        upload = {"name": "a.dbc", "text": DBC + f"BO_ {2 + number} N: 8 A\n"}
        placed = await admin.post(f"{BASE}/dbc", json=upload)
        assert placed.status_code == 201, placed.text
    names = {"a.dbc", "a-2.dbc", "a-3.dbc"}
    assert {file.name for file in folder.glob("*.dbc*")} == names
    again = await admin.post(f"{BASE}/dbc", json=upload)
    assert (again.status_code, again.json()["name"]) == (201, "a-3.dbc"), "it is there already"
    refused = await admin.post(f"{BASE}/dbc", json={"name": "b.dbc", "text": DBC})
    assert refused.status_code == 409
    assert "holds 3 DBC files of 0.0 MiB; expected at most 3 of 64 MiB" in refused.json()["detail"]
    monkeypatch.setattr(dbc_files, "DBC_FILES_MAX", 100)
    monkeypatch.setattr(dbc_files, "DBC_BYTES_MAX", 300)
    large = await admin.post(f"{BASE}/dbc", json={"name": "b.dbc", "text": DBC * 2})
    assert large.status_code == 409
    assert {file.name for file in folder.glob("*.dbc*")} == names, "nothing is left behind"


async def test_old_versions_of_the_file_are_removed(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    admin = world.client("admin", timeout=patience(60))
    monkeypatch.setattr(file_versions, "VERSIONS_MAX", 4)
    revision = (await admin.get(BASE)).json()["revision"]

    async def save(number: int) -> str:
        source = STRANGE | {"port": number}
        change = {"revision": revision, "sources": [source]}
        saved = await admin.put(f"{BASE}/configuration", json=change)
        return str(saved.json()["revision"])

    async def numbers() -> list[int]:
        return [one["number"] for one in (await admin.get(f"{BASE}/versions")).json()["items"]]

    for number in range(1, 8):
        revision = await save(number)
    assert await numbers() == [8, 7, 6, 5]
    monkeypatch.setattr(file_versions, "BYTES_MAX", 1)
    revision = await save(9)
    assert await numbers() == [9, 8], "the newest, and the one that it can be undone to"


async def test_assets_in_the_store_are_checked_with_the_change(
    world: Any, settings: Settings
) -> None:
    assert settings.file is not None
    admin = world.client("admin", timeout=patience(60))
    table = {
        "bearing": "6311",
        "low_risk": {"speed_rpm_max": 900, "load_n_max": 4000},
        "channels": {"speed_rpm": {"source": "gone", "register": 1}},
    }
    world.store.assets.change({"axle-1": table, "axle-2": table}, 1)
    revision = (await admin.get(BASE)).json()["revision"]
    change = {"revision": revision, "sources": [STRANGE]}
    checked = (await admin.post(f"{BASE}/check", json=change)).json()
    assert checked["ok"] is False
    (line,) = [one for one in checked["errors"] if "in the store" in one]
    assert "channels.speed_rpm.source = 'gone'" in line
    assert line.endswith("(2 of 2: axle-1, axle-2)")
    # They stop nothing that is in service: the file may be saved, with a warning.
    saved = await admin.put(f"{BASE}/configuration", json=change)
    assert saved.status_code == 200, saved.text
    assert line in saved.json()["warnings"]
