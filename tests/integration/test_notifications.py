"""Alarms of a running service reach their receiver once, though the service is killed meanwhile."""

import json
import signal
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from processes import Station, free_port, wait_until
from receivers import Hook, hook

from service.demo.configuration import ASSET

__all__ = ["hook"]

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600), pytest.mark.endurance]

PATIENCE_S = 60.0
_CONFIGURATION = """\
[service]
port = {port}
data_dir = "data"

[[notifications]]
id = "hook"
kind = "webhook"
url = "{url}"
priorities = [1]
interval_s = 0

[[assets]]
id = "{asset}"
name = "Bench with a name"
bearing = "6311"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
limits = {{ t_inner_ring_c = {{ warning = 90, alarm = 105 }} }}
[assets.alarms.measured_limit]
on_delay_s = 0
[assets.channels]
t_inner_ring_c = {{ source = "push", max_age_s = 86400 }}
"""


def push_hot(station: Station) -> None:
    now = datetime.now(UTC).isoformat(timespec="milliseconds")
    samples = [{"channel": "t_inner_ring_c", "time": now, "value": 130.0}]
    answer = station.client.post(f"/api/v1/assets/{ASSET}/measurements", json={"samples": samples})
    assert answer.status_code == 200, answer.text


def alarm_of(station: Station) -> str | None:
    push_hot(station)
    items = station.get("/api/v1/alarms", asset=ASSET)["items"]
    return next((one["id"] for one in items if one["priority"] == 1), None)


def events(hook: Hook) -> list[str]:
    return [one["id"] for _, _, body in hook.taken for one in json.loads(body)["events"]]


def state(station: Station) -> dict[str, Any]:
    (found,) = station.get("/api/v1/notifications")["items"]
    return dict(found)


def test_a_killed_service_tells_once_what_it_had_not_told(tmp_path: Path, hook: Hook) -> None:
    port = free_port()
    configuration = tmp_path / "service.toml"
    configuration.write_text(_CONFIGURATION.format(port=port, url=hook.url, asset=ASSET))
    station = Station(tmp_path, configuration, port)
    hook.refusals = [503] * 10_000
    try:
        station.start_service()
        assert station.service is not None
        alarm = wait_until(lambda: alarm_of(station), PATIENCE_S, "a hot ring's alarm")
        failing = wait_until(
            lambda: found if (found := state(station))["failing_since"] else None,
            PATIENCE_S,
            "a failure that is seen",
        )
        assert (failing["waiting"], failing["told_at"]) == (1, None)
        assert failing["error"] == f"{failing['receivers'][0]}: answered 503"
        assert station.service.kill() == -signal.SIGKILL
        assert not hook.taken

        hook.refusals = []
        station.start_service()
        wait_until(lambda: events(hook), PATIENCE_S, "the message after the restart")
        told = wait_until(
            lambda: found if (found := state(station))["told_at"] else None, PATIENCE_S, "its state"
        )
        assert (told["waiting"], told["failing_since"], told["error"]) == (0, None, None)
        (post,) = hook.taken
        assert json.loads(post[2])["events"][0]["asset_name"] == "Bench with a name"
        answer = station.client.post("/api/v1/notifications/hook:test")
        assert answer.json() == {"told": True, "detail": None}
        assert station.client.post("/api/v1/notifications/none:test").status_code == 404
        actions = [line["action"] for line in station.get("/api/v1/audit")["items"]]
        assert actions[0] == "notification.test"
        assert station.service.terminate() == 0

        station.start_service()
        wait_until(lambda: alarm_of(station) == alarm, PATIENCE_S, "the same alarm again")
        station.client.post(f"/api/v1/alarms/{alarm}/acknowledge")
        wait_until(lambda: len(events(hook)) == 2, PATIENCE_S, "the acknowledgement")
        assert events(hook) == [f"{alarm}:raised:1", f"{alarm}:acknowledged:1"]
        log = (tmp_path / "serve.log").read_text()
        assert "secret-path" not in log
    finally:
        station.close()
