"""Assets that come and go while the service runs, on real wires, through kills and restarts."""

import contextlib
import os
import signal
import sqlite3
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx2
import pytest
from processes import Command, Station, free_port, wait_until

from adapters.samples import Quality
from service.clock import rfc3339
from service.ingest.spool import FILE_NAME as SPOOL_FILE
from service.site.settings import load_settings
from service.store.opening import FILE_NAME as STORE_FILE

pytestmark = [pytest.mark.wires, pytest.mark.timeout(300)]

PATIENCE_S = 60.0
FIRST = "bench-1"
CONFIGURATION = """
[service]
port = {port}

[[sources]]
name = "gateway"
driver = "modbus-tcp"
host = "127.0.0.1"
port = {modbus}
poll_interval_s = 0.2

[[templates]]
name = "axle"
bearing = "6311"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
values = {{ ring = 1 }}
[templates.channels]
t_inner_ring_c = {{ source = "push" }}
t_outer_ring_c = {{ source = "gateway", register = "{{ring}}", kind = "input", type = "int16", scale = 0.1 }}
ambient_c = {{ source = "gateway", register = 2, kind = "input", type = "int16", scale = 0.1 }}
speed_rpm = {{ source = "push" }}
load_n = {{ source = "push" }}

[[assets]]
id = "bench-1"
template = "axle"
"""  # noqa: E501


class Hall(Station):
    """A service with one asset in its file, and a bench that answers as the gateway."""

    def __init__(self, folder: Path) -> None:
        port, modbus = free_port(), free_port()
        configuration = folder / "bearing-twin.toml"
        configuration.write_text(CONFIGURATION.format(port=port, modbus=modbus))
        super().__init__(folder, configuration, port)
        self.bench = Command(
            ["virtual-bench", "--modbus-port", str(modbus), "--can-port", "0", "--json"],
            folder / "bench.log",
        )

    def change(self, tables: Mapping[str, Mapping[str, Any] | None]) -> None:
        """As a command of another process does."""
        with self.open_store() as store:
            store.assets.change(tables, time.time_ns() // 1000)

    def ids(self) -> list[str]:
        return [one["id"] for one in self.get("/api/v1/assets")["items"]]

    def until_followed(self, *ids: str) -> None:
        wait_until(lambda: set(self.ids()) == {FIRST, *ids}, PATIENCE_S, f"{ids} to be followed")

    def until_measured(self, asset: str) -> float:
        def value() -> float | None:
            tag = self.get(f"/api/v1/assets/{asset}/snapshot")["tags"]["t_outer_ring_c"]
            return tag["value"] if tag["quality"] >= 192 else None

        return wait_until(value, PATIENCE_S, f"a temperature of {asset}")

    def push(self, asset: str) -> httpx2.Response:
        now = rfc3339(self.now_us())
        values = {"t_inner_ring_c": 41.0, "speed_rpm": 900.0, "load_n": 1200.0}
        samples = [{"channel": n, "time": now, "value": v} for n, v in values.items()]
        return self.client.post(f"/api/v1/assets/{asset}/measurements", json={"samples": samples})

    def until_estimated(self, asset: str) -> dict[str, Any]:
        def state() -> dict[str, Any] | None:
            self.push(asset)
            found: dict[str, Any] = self.get(f"/api/v1/assets/{asset}/state")
            return found if found["nodes"]["t_node_7_c"]["mean_c"] is not None else None

        return wait_until(state, PATIENCE_S, f"an estimate of {asset}")

    def check(self, name: str) -> Mapping[str, Any]:
        checks = self.client.get("/readyz").json()["checks"]
        return next((one for one in checks if one["name"] == name), {"status": "unknown"})

    def close(self) -> None:
        super().close()
        self.bench.end()


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hall]:
    hall = Hall(tmp_path_factory.mktemp("hall"))
    try:
        hall.start_service()
        hall.until_measured(FIRST)
        yield hall
    finally:
        hall.close()


@pytest.fixture
def hall(started: Hall) -> Hall:
    """The hall with the asset of its file alone."""
    started.change({name: None for name in started.ids() if name != FIRST})
    started.until_followed()
    return started


def test_a_new_asset_is_followed_and_no_other_is_disturbed(hall: Hall) -> None:
    began = rfc3339(hall.now_us())
    names = [f"axle-{number}" for number in range(1, 21)]
    hall.change({name: {"template": "axle"} for name in names})
    hall.until_followed(*names)
    assert hall.until_measured("axle-20") == pytest.approx(hall.until_measured(FIRST), abs=5.0)

    def read_since() -> list[dict[str, Any]]:
        path = f"/api/v1/assets/{FIRST}/measurements"
        items: list[dict[str, Any]] = hall.get(
            path, channel="t_outer_ring_c", start=began, limit=10_000
        )["items"]
        return items

    wait_until(lambda: len(read_since()) > 5, PATIENCE_S, "samples of the first asset")
    stored = read_since()
    assert {one["quality"] for one in stored} == {192}, "no sample was lost with a connection"
    # All that is asked of an asset works for one that is not in the file.
    assert hall.push("axle-7").json()["accepted"] == 3
    hall.until_estimated("axle-7")
    what_if = {"profile": [{"duration_s": 600, "speed_rpm": 3000, "load_n": 2000}]}
    answer = hall.client.post("/api/v1/assets/axle-7/forecasts", json=what_if)
    assert answer.is_success, answer.text
    assert hall.get("/api/v1/assets/axle-7/windows")["items"] == []


@pytest.mark.thorough
def test_a_change_is_in_effect_and_the_twin_goes_on(hall: Hall) -> None:
    hall.change({"axle-1": {"template": "axle"}})
    hall.until_followed("axle-1")
    before = hall.until_estimated("axle-1")
    limits = {"t_inner_ring_c": {"warning": 61.0, "alarm": 71.0}}
    hall.change({"axle-1": {"template": "axle", "limits": limits, "name": "Left axle"}})

    def changed() -> bool:
        asset = hall.get("/api/v1/assets/axle-1")
        return bool(asset["name"] == "Left axle" and asset["limits"] == limits)

    wait_until(changed, PATIENCE_S, "the changed asset")
    after = hall.until_estimated("axle-1")
    assert after["time"] >= before["time"]
    assert after["model_version"] == before["model_version"]
    for name, node in after["nodes"].items():
        assert node["mean_c"] == pytest.approx(before["nodes"][name]["mean_c"], abs=3.0)


def test_a_removed_asset_leaves_its_history_and_no_alarm(hall: Hall) -> None:
    hall.change({"axle-30": {"template": "axle"}, "axle-2": {"template": "axle"}})
    hall.until_followed("axle-30", "axle-2")
    assert hall.push("axle-30").json()["accepted"] == 3
    hall.until_measured("axle-2")
    hall.change({"axle-30": None})
    hall.until_followed("axle-2")
    assert hall.client.get("/api/v1/assets/axle-30/snapshot").status_code == 404
    assert hall.push("axle-30").status_code == 404
    assert not [one for one in hall.get("/api/v1/alarms")["items"] if one["asset"] == "axle-30"]
    hall.until_measured("axle-2")
    hall.change({"axle-30": {"template": "axle"}})
    hall.until_followed("axle-30", "axle-2")
    hall.until_measured("axle-30")

    # What was pushed, and what was read, end with a mark; what comes again is after it.
    def qualities(channel: str) -> list[int]:
        stored = hall.get(
            "/api/v1/assets/axle-30/measurements",
            channel=channel,
            start="2020-01-01T00:00:00Z",
            resolution="raw",
        )["items"]
        return [one["quality"] for one in stored]

    assert qualities("load_n") == [192, Quality.OUT_OF_SERVICE]
    wait_until(lambda: qualities("t_outer_ring_c")[-1] == 192, PATIENCE_S, "samples after the mark")
    read = [quality for quality in qualities("t_outer_ring_c") if quality != 192]
    assert read == [Quality.OUT_OF_SERVICE]
    journal = hall.get("/api/v1/alarms/journal", asset="axle-30")["items"]
    assert [one["kind"] for one in reversed(journal) if one["class"] == "event"][-2:] == [
        "asset not followed",
        "asset followed again",
    ]


@pytest.mark.thorough
def test_other_registers_are_read_where_an_asset_asks_for_them(hall: Hall) -> None:
    hall.change({"axle-1": {"template": "axle"}})
    hall.until_followed("axle-1")
    hall.until_measured("axle-1")
    hall.change({"axle-1": {"template": "axle", "values": {"ring": 9999}}})
    # The device has no such register: what others read from it must not suffer.
    wait_until(
        lambda: "t_outer_ring_c" in hall.check("twin:axle-1").get("detail", ""),
        PATIENCE_S,
        "the register to be missed",
    )
    hall.until_measured(FIRST)
    hall.change({"axle-1": {"template": "axle", "values": {"ring": 1}}})
    hall.until_measured("axle-1")


def test_what_was_written_is_taken_up_whenever_the_cell_is_killed(hall: Hall) -> None:
    assert hall.service is not None
    hall.change({"axle-1": {"template": "axle"}})
    os.kill(hall.service.side("cell"), signal.SIGKILL)
    hall.until_followed("axle-1")
    hall.until_measured("axle-1")
    hall.until_measured(FIRST)


@pytest.mark.thorough
def test_a_kill_between_removal_and_addition_leaves_a_mark(hall: Hall) -> None:
    assert hall.service is not None
    name = "axle-31"
    hall.change({name: {"template": "axle"}})
    hall.until_followed(name)
    assert hall.push(name).json()["accepted"] == 3
    os.kill(hall.service.side("cell"), signal.SIGKILL)
    hall.change({name: None})
    hall.until_followed()
    os.kill(hall.service.side("cell"), signal.SIGKILL)
    hall.change({name: {"template": "axle"}})
    hall.until_followed(name)
    wait_until(lambda: hall.push(name).status_code == 200, PATIENCE_S, "a push to be taken")

    def qualities() -> list[int]:
        found = hall.get(f"/api/v1/assets/{name}/measurements", channel="load_n")
        return [one["quality"] for one in found["items"]]

    gap = [192, Quality.OUT_OF_SERVICE, 192]
    wait_until(lambda: qualities()[:3] == gap, PATIENCE_S, "the mark between both")
    journal = hall.get("/api/v1/alarms/journal", asset=name)["items"]
    events = [one["kind"] for one in reversed(journal) if one["class"] == "event"]
    assert events[-2:] == ["asset not followed", "asset followed again"]


@pytest.mark.thorough
def test_their_devices_are_read_though_the_store_is_locked_at_the_start(hall: Hall) -> None:
    assert hall.service is not None
    hall.change({"axle-1": {"template": "axle"}})
    hall.until_followed("axle-1")
    assert hall.service.terminate() == 0
    ended = rfc3339(hall.now_us())
    data = load_settings(hall.configuration).data_dir
    with (
        contextlib.closing(sqlite3.connect(data / STORE_FILE, isolation_level=None)) as store,
        ThreadPoolExecutor(1) as starter,
    ):
        store.execute("BEGIN EXCLUSIVE")
        starting = starter.submit(hall.start_service)
        wait_until(lambda: waiting_on(data / SPOOL_FILE, "axle-1") > 40, PATIENCE_S, "samples")
        locked_until = rfc3339(hall.now_us())
        store.execute("ROLLBACK")
        starting.result(PATIENCE_S)
    hall.until_followed("axle-1")
    hall.until_measured("axle-1")

    def kept() -> bool:
        stored = hall.get(
            "/api/v1/assets/axle-1/measurements",
            channel="t_outer_ring_c",
            start=ended,
            end=locked_until,
            resolution="raw",
        )
        return [one["quality"] for one in stored["items"]].count(192) > 10

    wait_until(kept, PATIENCE_S, "what was read before the store was there")


def waiting_on(spool: Path, asset: str) -> int:
    """Samples of an asset in the file in which they wait."""
    try:
        with contextlib.closing(sqlite3.connect(f"file:{spool}?mode=ro", uri=True)) as file:
            query = "SELECT COUNT(*) FROM samples WHERE asset = ?"
            return int(file.execute(query, (asset,)).fetchone()[0])
    except sqlite3.OperationalError:
        return 0


@pytest.mark.thorough
def test_an_asset_that_does_not_fit_the_file_any_more_is_named_and_the_others_run(
    hall: Hall,
) -> None:
    assert hall.service is not None
    hall.change({"axle-1": {"template": "axle"}, "axle-2": {"template": "axel"}})
    hall.until_followed("axle-1")
    check = wait_until(
        lambda: (found := hall.check("assets"))["status"] == "degraded" and found,
        PATIENCE_S,
        "the check of the assets",
    )
    assert check["detail"] == "axle-2: axle-2.template = 'axel': did you mean 'axle'?"
    hall.until_measured("axle-1")
    assert hall.service.terminate() == 0
    hall.start_service()
    hall.until_followed("axle-1")
    assert hall.check("assets")["status"] == "degraded"
    hall.change({"axle-2": None})
    wait_until(lambda: hall.check("assets")["status"] == "ok", PATIENCE_S, "all assets to be right")
