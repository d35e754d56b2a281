import time
from dataclasses import asdict

import pytest
from sqlalchemy import insert, text
from sqlalchemy.exc import DatabaseError

from service.store import AuditEntry, Store, StoreUnavailableError
from service.store.access_tables import AuditRow

DAY_US = 86_400_000_000


def entry(number: int) -> AuditEntry:
    return AuditEntry(number, f"who {number}", "192.0.2.7", "key.create", "key bt_1", "role viewer")


def test_lines_are_read_back_newest_first_in_pages(store: Store) -> None:
    for number in range(5):
        store.audit.add(entry(number))
    first = store.audit.page(limit=3)
    assert first.items == [entry(4), entry(3), entry(2)]
    rest = store.audit.page(limit=3, cursor=first.next_cursor)
    assert rest.items == [entry(1), entry(0)]
    assert rest.next_cursor is None


@pytest.mark.parametrize("change", ["UPDATE audit SET who = 'nobody'", "DELETE FROM audit"])
def test_the_database_takes_no_change_of_a_line(store: Store, change: str) -> None:
    written = entry(time.time_ns() // 1000 - 364 * DAY_US)
    store.audit.add(written)
    with (
        pytest.raises((DatabaseError, StoreUnavailableError), match="only grows"),
        store._database.writing() as connection,
    ):
        connection.execute(text(change))
    assert store.audit.page().items == [written]


def test_lines_that_are_old_enough_go(store: Store) -> None:
    now_us = time.time_ns() // 1000
    old, young = entry(now_us - 400 * DAY_US), entry(now_us - 370 * DAY_US)
    with store._database.writing() as connection:
        connection.execute(insert(AuditRow), [asdict(old)] * 1500)
    store.audit.add(young)
    assert store.audit.expire(now_us - 390 * DAY_US) == 1500
    assert store.audit.page().items == [young]
    assert store.audit.expire(now_us - 390 * DAY_US) == 0
