"""Changes of alarm settings: the latest holds, none is lost, and of two at once one is refused."""

from threading import Barrier, Thread

import pytest

from service.domain.errors import ChangedMeanwhileError
from service.store import AuditEntry, Store

LINE = AuditEntry(time_us=7, who="engineer", address="", action="a.b", target="", detail="why")
NAME = ("measured limit", "t_inner_ring_c", "warning")
OTHER = ("rate of rise", "t_inner_ring_c", "alarm")


def test_the_latest_change_holds_and_all_are_told(store: Store) -> None:
    settings = store.alarm_overlays
    assert (settings.revision(), settings.present()) == (0, {})
    assert (
        settings.change(
            {("a", NAME): {"setpoint": 65.0}, ("b", OTHER): {"priority": 1}}, LINE, "x", 0
        )
        == 1
    )
    assert (
        settings.change({("a", NAME): {"setpoint": 66.0, "remarks": "größer"}}, LINE, "y", 1) == 2
    )
    assert settings.present() == {
        "a": {NAME: {"setpoint": 66.0, "remarks": "größer"}},
        "b": {OTHER: {"priority": 1}},
    }
    assert settings.present({"b"}) == {"b": {OTHER: {"priority": 1}}}
    assert settings.present({"a", "c"}).keys() == {"a"}
    assert settings.changed_since(0) == (2, {"a", "b"})
    assert settings.changed_since(1) == (2, {"a"})
    assert settings.changed_since(2) == (2, set())
    assert settings.change({("a", NAME): {}}, LINE, "back", 2) == 3
    assert settings.present() == {"b": {OTHER: {"priority": 1}}}
    page = settings.history(3)
    assert next((one.revision, one.before, one.after) for one in page.items) == (
        3, {"setpoint": 66.0, "remarks": "größer"}, {},
    )  # fmt: skip
    rest = settings.history(3, page.next_cursor)
    assert (len(rest.items), rest.next_cursor, rest.items[0].comment) == (1, None, "x")
    assert len(settings.history(9, asset="b").items) == 1
    assert [line.action for line in store.audit.page(10).items] == ["a.b"] * 3


def test_of_two_changes_at_once_one_is_refused_and_writes_nothing(store: Store) -> None:
    begin = Barrier(2)
    refused: list[str] = []

    def change(setpoint: float) -> None:
        begin.wait(30)
        try:
            store.alarm_overlays.change({("a", NAME): {"setpoint": setpoint}}, LINE, "", 0)
        except ChangedMeanwhileError as error:
            refused.append(str(error))

    threads = [Thread(target=change, args=(value,)) for value in (60.0, 61.0)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert len(refused) == 1
    assert len(store.alarm_overlays.history(9).items) == 1
    assert len(store.audit.page(9).items) == 1
    with pytest.raises(ChangedMeanwhileError):
        store.alarm_overlays.change({("a", NAME): {}}, LINE, "", 0)
