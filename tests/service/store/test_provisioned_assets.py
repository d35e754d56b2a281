"""Assets that are not in the file: kept whole, and every change seen once by who follows."""

from pathlib import Path
from threading import Thread

import pytest

from service.domain.errors import ChangedMeanwhileError
from service.store import AuditEntry, Store

LINE = AuditEntry(time_us=1, who="engineer", address="", action="asset.put", target="", detail="")


def test_tables_come_back_as_they_were_given(store: Store) -> None:
    table = {"template": "axle", "values": {"unit": 11, "gain": 0.1, "note": "Lager – größer"}}
    assert store.assets.get("axle-1") is None
    revision = store.assets.change({"axle-1": table, "axle-2": {}}, 5, LINE)
    found = store.assets.get("axle-1")
    assert found is not None
    assert (found.table, found.revision, found.changed_us) == (table, revision, 5)
    assert [one.id for one in store.assets.present()] == ["axle-1", "axle-2"]
    assert store.audit.page(10).items[0].action == "asset.put"


def test_who_follows_sees_each_change_once_and_removals_too(store: Store) -> None:
    first = store.assets.change({"a": {"n": 1}, "b": {"n": 1}}, 1)
    second = store.assets.change({"a": {"n": 2}}, 2)
    third = store.assets.change({"b": None, "never-there": None}, 3)
    assert first < second < third
    assert [(one.id, one.table) for one in store.assets.changed_since(0)] == [
        ("a", {"n": 2}),
        ("b", None),
    ]
    assert [one.id for one in store.assets.changed_since(second)] == ["b"]
    assert store.assets.changed_since(third) == []
    assert [one.id for one in store.assets.present()] == ["a"]
    again = store.assets.change({"b": {"n": 3}}, 4)
    assert [(one.id, one.revision) for one in store.assets.changed_since(third)] == [("b", again)]


def test_a_change_that_cannot_be_written_whole_is_not_written(store: Store) -> None:
    store.assets.change({"a": {"n": 1}}, 1)
    with pytest.raises(TypeError):
        store.assets.change({"a": {"n": 2}, "b": {"n": object()}}, 2)
    assert [one.table for one in store.assets.present()] == [{"n": 1}]


def test_a_change_of_what_is_no_longer_there_is_not_written(store: Store) -> None:
    first = store.assets.change({"a": {"n": 1}}, 1)
    second = store.assets.change({"a": {"n": 2}}, 2, LINE, based_on={"a": first})
    with pytest.raises(ChangedMeanwhileError, match="'a' was changed meanwhile"):
        store.assets.change({"a": {"n": 3}, "b": {}}, 3, LINE, based_on={"a": first})
    with pytest.raises(ChangedMeanwhileError):
        store.assets.change({"b": {"n": 3}}, 3, LINE, based_on={"b": 1})
    assert [(one.id, one.revision) for one in store.assets.present()] == [("a", second)]
    assert len(store.audit.page(10).items) == 1


def test_writers_side_by_side_get_revisions_of_their_own(store: Store) -> None:
    revisions: list[int] = []

    def write(writer: int) -> None:
        for number in range(20):
            revisions.append(store.assets.change({f"{writer}-{number}": {}}, number))

    threads = [Thread(target=write, args=(writer,)) for writer in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(revisions) == sorted(set(revisions))
    assert len(revisions) == len(store.assets.present()) == 80


def test_thousands_are_written_and_read_at_once(tmp_path: Path) -> None:
    with Store.open("", tmp_path) as store:
        tables = {f"axle-{n:05d}": {"template": "axle", "values": {"unit": n}} for n in range(5000)}
        revision = store.assets.change(tables, 1)
        assert {one.id: one.table for one in store.assets.changed_since(revision - 1)} == tables


def test_the_table_says_when_an_asset_was_away(store: Store) -> None:
    store.assets.change({"a": {}, "b": {}}, 1)
    assert store.assets.once_removed() == []
    store.assets.change({"a": None}, 2)
    store.assets.change({"a": None}, 3)
    assert [(one.id, one.removed_us, one.added_us) for one in store.assets.once_removed()] == [
        ("a", 2, None)
    ]
    store.assets.change({"a": {"n": 1}}, 4)
    store.assets.change({"a": {"n": 2}, "b": {"n": 2}}, 5)
    assert [
        (one.removed_us, one.added_us, one.changed_us) for one in store.assets.once_removed(["a"])
    ] == [(2, 4, 5)]
    store.assets.change({"a": None}, 6)
    (found,) = store.assets.once_removed()
    assert (found.table, found.removed_us, found.added_us) == (None, 6, None)
    assert store.assets.once_removed(["b"]) == []
