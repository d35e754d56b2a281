import pytest
from sqlalchemy import text
from sqlalchemy.exc import DatabaseError

from service.store import AuditEntry, Store, StoreUnavailableError


def entry(number: int) -> AuditEntry:
    return AuditEntry(number, f"who {number}", "192.0.2.7", "key.create", "key bt_1", "role viewer")


def test_lines_are_read_back_newest_first_in_pages(store: Store) -> None:
    for number in range(5):
        store.add_audit_entry(entry(number))
    first = store.audit(limit=3)
    assert first.items == [entry(4), entry(3), entry(2)]
    rest = store.audit(limit=3, cursor=first.next_cursor)
    assert rest.items == [entry(1), entry(0)]
    assert rest.next_cursor is None


@pytest.mark.parametrize("change", ["UPDATE audit SET who = 'nobody'", "DELETE FROM audit"])
def test_the_database_takes_no_change_of_a_line(store: Store, change: str) -> None:
    store.add_audit_entry(entry(1))
    with (
        pytest.raises((DatabaseError, StoreUnavailableError), match="only grows"),
        store._database.writing() as connection,
    ):
        connection.execute(text(change))
    assert store.audit().items == [entry(1)]
