"""An operator acknowledges while the store is away; the service dies before it is back."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from faults.hall import lock_store
from postgresql import running_postgresql
from processes import Command, Station, free_port, wait_until

from service.lab.demo.configuration import ASSET
from service.store.opening import FILE_NAME

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600)]

PATIENCE_S = 60.0
_CONFIGURATION = """\
[service]
port = {port}
data_dir = "data"
database_url = "{url}"

[[assets]]
id = "{asset}"
bearing = "6311"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
[assets.alarms.measured_limit]
on_delay_s = 0
[assets.channels]
t_inner_ring_c = {{ source = "push", max_age_s = 86400 }}
"""

Away = Callable[[], Callable[[], None]]
"""Takes the store away; returns what brings it back."""


@contextmanager
def locked_sqlite(folder: Path) -> Iterator[tuple[str, Away]]:
    yield "", lambda: lock_store(folder / "data" / FILE_NAME)


@contextmanager
def stopped_postgresql(_folder: Path) -> Iterator[tuple[str, Away]]:
    with running_postgresql() as server:

        def stop() -> Callable[[], None]:
            server.stop()
            return server.start  # type: ignore[no-any-return]

        yield server.database(), stop


def push_hot(station: Station) -> None:
    now = datetime.now(UTC).isoformat(timespec="milliseconds")
    samples = [{"channel": "t_inner_ring_c", "time": now, "value": 130.0}]
    answer = station.client.post(f"/api/v1/assets/{ASSET}/measurements", json={"samples": samples})
    assert answer.status_code == 200, answer.text


def act(station: Station, alarm: str, what: str, **body: Any) -> None:
    answer = station.client.post(f"/api/v1/alarms/{alarm}/{what}", json=body)
    assert answer.status_code == 200, answer.text


@pytest.mark.parametrize(
    ("kind", "end"),
    [(locked_sqlite, Command.terminate), (stopped_postgresql, Command.kill)],
    ids=["sqlite-stop", "postgresql-kill"],
)
def test_what_was_answered_is_in_journal_and_trail_once(
    kind: Any, end: Callable[[Command], int], tmp_path: Path
) -> None:
    port = free_port()
    configuration = tmp_path / "service.toml"
    with kind(tmp_path) as (url, go_away):
        configuration.write_text(_CONFIGURATION.format(port=port, url=url, asset=ASSET))
        station = Station(tmp_path, configuration, port)
        try:
            check(station, go_away, end)
        finally:
            station.close()


def check(station: Station, go_away: Away, end: Callable[[Command], int]) -> None:
    station.start_service()
    assert station.service is not None
    alarm = wait_until(lambda: raised(station), PATIENCE_S, "a hot ring's alarm")
    come_back = go_away()
    act(station, alarm, "acknowledge", comment="seen")
    act(station, alarm, "shelve", duration_s=3600, comment="fan is being changed")
    assert "bearing_twin_outbox_changes 0.0" not in station.client.get("/metrics").text
    assert end(station.service) in (0, -signal.SIGKILL)
    come_back()

    station.start_service()
    states = {one["id"]: one["state"] for one in station.get("/api/v1/alarms")["items"]}
    assert states[alarm] == "SHLVD", "the newest state, not that of the store"
    wait_until(
        lambda: "bearing_twin_outbox_changes 0.0" in station.client.get("/metrics").text,
        PATIENCE_S,
        "all changes are written",
    )
    lines = station.get("/api/v1/alarms/journal", alarm=alarm)["items"][::-1]
    assert [(line["event"], line["to"], line["comment"]) for line in lines] == [
        ("raise", "UNACK", ""),
        ("acknowledge", "ACKED", "seen"),
        ("shelve", "SHLVD", "fan is being changed"),
    ]
    trail = station.get("/api/v1/audit")["items"][::-1]
    assert [line["action"] for line in trail if line["target"] == f"alarm {alarm}"] == [
        "alarm.acknowledge",
        "alarm.shelve",
    ]


def raised(station: Station) -> str | None:
    push_hot(station)
    items = [
        one
        for one in station.get("/api/v1/alarms")["items"]
        if one["kind"] == "measured limit" and one["limit_level"] == "alarm"
    ]
    return items[0]["id"] if items else None
