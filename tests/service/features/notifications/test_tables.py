"""Notifications in a store and an outbox of 1.0 are read, and written in a form that it reads."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from alarm_bench import STORED
from sqlalchemy import insert, select

from service.features.notifications.tables import (
    Notification,
    NotificationChange,
    NotificationRecords,
    NotificationRow,
    load_notifications,
)
from service.store import Outbox, Store
from service.store.changes import change_of, document_of

#: As 1.0 wrote it.
DOCUMENT: dict[str, Any] = {
    "notification": "mail",
    "alarm": asdict(STORED) | {"assets": []},
    "raise_number": 2,
    "since_us": 100,
    "owed": ["returned:2"],
    "told": True,
    "released_us": 90,
    "called": False,
    "steps": 1,
    "over": False,
}
#: 1.0 passes over a key that it does not know.
WRITTEN = DOCUMENT | {"partly": []}
NOTIFICATION = Notification(
    "mail", STORED, 2, 100, ("returned:2",), is_notified=True, released_us=90, steps=1
)


@pytest.fixture
def store(tmp_path: Path) -> Any:
    with Store.open("", tmp_path) as store:
        yield store


def test_a_row_of_an_earlier_version_is_read_and_written_in_its_form(store: Store) -> None:
    records = store.part(NotificationRecords)
    row = {"notification": "mail", "alarm_id": "one", "asset": "a", "document": DOCUMENT}
    with store._database.writing() as connection:
        connection.execute(insert(NotificationRow).values(row))
    assert records.load() == [NOTIFICATION]
    records.save([NOTIFICATION])
    with store._database.reading() as connection:
        assert connection.execute(select(NotificationRow.document)).scalars().all() == [WRITTEN]


def test_a_change_that_an_earlier_version_left_in_an_outbox_is_read(
    store: Store, tmp_path: Path
) -> None:
    change = NotificationChange((NOTIFICATION,))
    document = {"tellings": {"tellings": [DOCUMENT]}}
    assert change_of(json.dumps(document)) == change
    assert json.loads(document_of(change)) == {"tellings": {"tellings": [WRITTEN]}}
    with Outbox.open(tmp_path, store) as outbox:
        outbox.record(change)
        assert outbox.flush(30)
        assert load_notifications(store, outbox) == [NOTIFICATION]
