from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from sqlalchemy import insert
from sqlalchemy.exc import IntegrityError

from service.store import Activation, AuditEntry, Store
from service.store.tables import ModelVersionRow


def test_versions_count_from_one_per_asset(store: Store) -> None:
    document = {"parameters": {"k1": 0.25}, "windows": [], "nothing": None}
    assert store.models.add("a", "candidate", "new", document, 10) == 1
    assert store.models.add("a", "rejected", "too hot", {}, 11) == 2
    assert store.models.add("b", "candidate", "", {}, 12) == 1
    assert [m.version for m in store.models.versions("a")] == [1, 2]
    model = store.models.version("a", 1)
    assert model is not None
    assert (model.status, model.reason, model.created_at_us) == ("candidate", "new", 10)
    assert model.document == document
    assert store.models.version("a", 3) is None
    assert store.models.active("a") is None


def test_a_model_becomes_active_through_activation_alone(store: Store) -> None:
    with pytest.raises(ValueError, match="'active': a new model is"):
        store.models.add("a", "active", "", {}, 1)


def test_activation_retires_the_one_before_and_is_journaled(store: Store) -> None:
    for _ in range(2):
        store.models.add("a", "candidate", "", {}, 1)
    store.models.add("b", "candidate", "", {}, 1)
    store.models.activate("b", 1, "service", "first", 5)
    assert store.models.activate("a", 1, "service", "gates passed", 10).status == "active"
    store.models.activate("a", 2, "eva", "better", 20)
    assert store.models.activate("a", 2, "eva", "again", 21).reason == "better"
    store.models.activate("a", 1, "eva", "roll back", 30)
    assert [(m.version, m.status) for m in store.models.versions("a")] == [
        (1, "active"),
        (2, "retired"),
    ]
    assert store.models.activations("a") == [
        Activation("a", 1, 10, "service", "gates passed"),
        Activation("a", 2, 20, "eva", "better"),
        Activation("a", 1, 30, "eva", "roll back"),
    ]
    active = store.models.active("b")
    assert active is not None
    assert active.version == 1


def test_a_version_that_is_not_there_cannot_be_activated(store: Store) -> None:
    store.models.add("a", "candidate", "", {}, 1)
    store.models.activate("a", 1, "eva", "", 2)
    with pytest.raises(KeyError, match="no model version 7"):
        store.models.activate("a", 7, "eva", "", 3)
    active = store.models.active("a")
    assert active is not None
    assert active.version == 1


def test_the_database_itself_holds_one_active_model_per_asset(store: Store) -> None:
    store.models.add("a", "candidate", "", {}, 1)
    store.models.activate("a", 1, "eva", "", 2)
    second = insert(ModelVersionRow).values(
        asset="a", version=2, status="active", reason="", created_at_us=1, document={}
    )
    with pytest.raises(IntegrityError), store._database.writing() as connection:
        connection.execute(second)


def test_many_at_once_get_versions_of_their_own(store: Store) -> None:
    with ThreadPoolExecutor(8) as pool:
        versions = list(
            pool.map(lambda _: store.models.add("a", "candidate", "", {}, 1), range(24))
        )
        assert sorted(versions) == list(range(1, 25))
        list(pool.map(lambda version: store.models.activate("a", version, "x", "", 2), versions))
    assert [m.status for m in store.models.versions("a")].count("active") == 1
    assert len(store.models.activations("a")) == 24


def test_an_activation_and_its_audit_line_are_written_together_or_not_at_all(store: Store) -> None:
    store.models.add("a", "candidate", "", {}, 1)
    line = AuditEntry(1, "eva", "192.0.2.7", "model.activate", "asset a, version 1")
    with pytest.raises(IntegrityError):  # the database refuses a line without an author
        store.models.activate("a", 1, "eva", "", 2, replace(line, who=None))  # type: ignore[arg-type]
    assert store.models.active("a") is None
    assert store.models.activations("a") == []
    with pytest.raises(KeyError):
        store.models.activate("a", 2, "eva", "", 2, line)
    assert store.audit.page().items == []
    store.models.activate("a", 1, "eva", "", 2, line)
    (written,) = store.audit.page().items
    assert (written.who, written.action, written.target) == ("eva", line.action, line.target)
    assert store.models.active("a") is not None


def test_parts_of_documents_are_those_of_the_whole(store: Store) -> None:
    whole = {"a": {"x": [1, 2.5, 1e-17], "y": {"z": None}}, "b": "text", "c": 0}
    for document in (whole, {"b": None, "a": {"y": 3}}, {}):
        store.models.add("a", "candidate", "new", document, 10)
    paths = [("b",), ("a", "x"), ("a", "y"), ("c",)]
    parts = [one.document for one in store.models.parts("a", paths, 10)]
    assert parts == [whole, {"a": {"y": 3}}, {}]
    assert [one.version for one in store.models.parts("a", paths, 2)] == [2, 3]
    assert store.models.parts("b", paths, 2) == []
