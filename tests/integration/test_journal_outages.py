"""An operator acknowledges while the store is away; the service dies before it is back."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from faults.hall import lock_store
from postgresql import running_postgresql
from processes import Command, Station, wait_until
from site_files import asset_text, pushed, write_site

from service.demo.configuration import ASSET
from service.store.opening import FILE_NAME

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600), pytest.mark.endurance]

PATIENCE_S = 60.0
ON_DELAY = "alarms = { measured_limit = { on_delay_s = 0 } }"
HOT = pushed(["t_inner_ring_c"], "max_age_s = 86400")

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
    with kind(tmp_path) as (url, go_away):
        text = asset_text(ASSET, HOT, ON_DELAY)
        with Station(tmp_path, *write_site(tmp_path, text, f'database_url = "{url}"')) as station:
            check(station, go_away, end)


def check(station: Station, go_away: Away, end: Callable[[Command], int]) -> None:
    service = station.start_service()
    alarm = wait_until(lambda: raised(station), PATIENCE_S, "a hot ring's alarm")
    come_back = go_away()
    act(station, alarm, "acknowledge", comment="seen")
    act(station, alarm, "shelve", duration_s=3600, comment="fan is being changed")
    # The cell writes its metrics down every few seconds.
    wait_until(lambda: not all_written(station), PATIENCE_S, "changes that wait for the store")
    assert end(service) in (0, -signal.SIGKILL)
    come_back()

    station.start_service()
    states = {one["id"]: one["state"] for one in station.get("/api/v1/alarms")["items"]}
    assert states[alarm] == "SHLVD", "the newest state, not that of the store"
    wait_until(lambda: all_written(station), PATIENCE_S, "all changes are written")
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
    assert station.push(ASSET, t_inner_ring_c=130.0).status_code == 200
    items = [
        one
        for one in station.get("/api/v1/alarms")["items"]
        if one["kind"] == "measured limit" and one["limit_level"] == "alarm"
    ]
    return items[0]["id"] if items else None


def all_written(station: Station) -> bool:
    return "bearing_twin_outbox_changes 0.0" in station.client.get("/metrics").text
