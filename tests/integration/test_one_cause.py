"""200 assets behind one Modbus port that closes: one alarm, which names them all and ends once."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from processes import Command, Station, free_port, wait_until
from receivers import Hook, running_hook

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600), pytest.mark.endurance]

COUNT, RATE, SOURCE = 200, 2.0, "gateway-1"
PATIENCE_S = 120.0


class Plant(Station):
    """The virtual fleet behind one gateway, and a service that reads it."""

    def __init__(self, folder: Path, webhook: str) -> None:
        self.gateway_port, port = free_port(), free_port()
        configuration = folder / "fleet.toml"
        self.folder = folder
        self.fleet: Command | None = None
        self.start_fleet("--configuration", str(configuration))
        text = configuration.read_text().replace("port = 0\n", f"port = {port}\n", 1)
        text = text.replace("poll_interval_s = 1.0", "poll_interval_s = 5.0")
        text += (
            f'\n[[notifications]]\nid = "hook"\nkind = "webhook"\nurl = "{webhook}"\n'
            "interval_s = 0\n"
        )
        configuration.write_text(text)
        super().__init__(folder, configuration, port)

    def start_fleet(self, *more: str) -> None:
        self.fleet = Command(
            [
                "virtual-fleet", "--benches", str(COUNT), "--rate", f"{RATE:g}",
                "--modbus-port", str(self.gateway_port), "--json", *more,
            ],
            self.folder / "fleet.log",
        )  # fmt: skip
        assert json.loads(self.fleet.first_line)["modbus"][0]["port"] == self.gateway_port

    def close_port(self) -> None:
        assert self.fleet is not None
        self.fleet.kill()

    def get(self, path: str, **parameters: Any) -> Any:
        """As of any service; on a busy machine it may say that it is back in a moment."""

        def answered() -> httpx2.Response | None:
            answer = self.client.get(path, params=parameters)
            return None if answer.status_code == httpx2.codes.SERVICE_UNAVAILABLE else answer

        answer = wait_until(answered, PATIENCE_S, "an answer")
        assert answer.status_code == httpx2.codes.OK, answer.text
        return answer.json()

    def alarms(self, **query: Any) -> list[dict[str, Any]]:
        items: list[dict[str, Any]] = self.get("/api/v1/alarms", **query)["items"]
        return [one for one in items if one["kind"] in ("stale data", "sensor fault")]

    def quiet(self) -> set[str]:
        """Acknowledge what a slow start has raised; gives which alarms there were."""
        seen: set[str] = set()

        def is_quiet() -> bool:
            alarms = self.alarms()
            seen.update(one["id"] for one in alarms)
            for one in alarms:
                if one["state"] in ("UNACK", "RTNUN"):
                    self.client.post(f"/api/v1/alarms/{one['id']}/acknowledge", json={})
            return not alarms

        wait_until(is_quiet, PATIENCE_S, "no alarm of a lost source")
        return seen

    def without_data(self) -> int:
        counts = self.get("/api/v1/fleet", limit=1)["counts"]
        return int(counts["lost"] + counts["unread"] + counts["waiting"])

    def close(self) -> None:
        super().close()
        if self.fleet is not None:
            self.fleet.end()


@pytest.fixture
def hook() -> Iterator[Hook]:
    with running_hook() as receiver:
        yield receiver


@pytest.fixture
def plant(tmp_path: Path, hook: Hook) -> Iterator[Plant]:
    with Plant(tmp_path, hook.url) as plant:
        yield plant


def test_a_gateway_that_is_lost_is_one_alarm(plant: Plant, hook: Hook) -> None:
    plant.start_service()
    wait_until(lambda: plant.without_data() == 0, PATIENCE_S, "data of all assets")
    before = plant.quiet()

    plant.close_port()
    alarm = wait_until(
        lambda: next((one for one in plant.alarms() if len(one["assets"]) == COUNT), None),
        PATIENCE_S,
        "the alarm of all assets",
    )
    assert [one["id"] for one in plant.alarms()] == [alarm["id"]]
    assert alarm["message"] == f"{SOURCE}: no data, {COUNT} assets"
    assert alarm["cause"] == {"kind": "source", "id": SOURCE}
    assert alarm["asset"] is None
    for asset in (alarm["assets"][0], alarm["assets"][-1]):
        assert [one["id"] for one in plant.alarms(asset=asset)] == [alarm["id"]]
        tags = plant.get(f"/api/v1/assets/{asset}/snapshot")["tags"]
        assert tags["alarms.active"]["value"] == 1
        verdict = plant.get(f"/api/v1/assets/{asset}/verdict")
        assert verdict["now"]["word"] == "unknown"
        assert verdict["missing"]
    statistics = plant.get("/api/v1/alarms/statistics")
    assert statistics["flood"] is False
    assert statistics["last_10_min"] <= 1 + len(before)
    answer = plant.client.post(f"/api/v1/alarms/{alarm['id']}/acknowledge", json={})
    assert answer.json()["state"] == "ACKED"

    # A restart of the service goes on with it.
    assert plant.service is not None
    plant.service.kill()
    plant.start_service()
    wait_until(lambda: plant.without_data() == COUNT, PATIENCE_S, "the assets after a restart")
    assert [(one["id"], one["state"]) for one in plant.alarms()] == [(alarm["id"], "ACKED")]

    plant.start_fleet()
    wait_until(lambda: not plant.alarms(), PATIENCE_S, "the end of the alarm")
    lines = plant.get("/api/v1/alarms/journal", asset=alarm["assets"][-1], limit=1000)["items"]
    of_source = [one for one in lines if one["channel"] == f"source:{SOURCE}"]
    assert [one["to"] for one in of_source] == ["NORM", "ACKED", "UNACK"]
    assert all(len(one["assets"]) == COUNT for one in of_source[:2])
    everything = plant.get("/api/v1/alarms/journal", limit=1000)["items"]
    assert {one["channel"] for one in everything if one["class"] == "alarm"} == {f"source:{SOURCE}"}
    raised = [
        event
        for _, _, body in hook.taken
        for event in json.loads(body)["events"]
        if event["event"] == "raised" and event["alarm"]["id"] not in before
    ]
    assert [one["alarm"]["id"] for one in raised] == [alarm["id"]]
