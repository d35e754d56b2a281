import pytest
from sqlalchemy.exc import IntegrityError

from service.store import Store

HOUR_US = 3_600_000_000


def test_a_key_is_found_by_its_hash_until_it_ends(store: Store) -> None:
    for_ever = store.access.add_key(
        prefix="bt_abc", sha256="11", role="admin", created_us=1, expires_us=None
    )
    short = store.access.add_key(
        prefix="bt_def", sha256="22", role="viewer", created_us=2, expires_us=HOUR_US
    )
    assert store.access.find_key("11") == for_ever
    assert store.access.find_key("22") == short
    assert store.access.find_key("33") is None
    assert store.access.list_keys() == [for_ever, short]
    assert for_ever.is_valid(10**18)
    assert short.is_valid(HOUR_US - 1)
    assert not short.is_valid(HOUR_US)


def test_a_revoked_key_opens_nothing_nor_do_its_sessions(store: Store) -> None:
    key = store.access.add_key(
        prefix="p", sha256="k", role="operator", created_us=1, expires_us=None
    )
    other = store.access.add_key(
        prefix="q", sha256="l", role="viewer", created_us=1, expires_us=None
    )
    store.access.add_session(sha256="s", key_id=key.id, created_us=5, expires_us=HOUR_US)
    store.access.add_session(sha256="t", key_id=other.id, created_us=5, expires_us=HOUR_US)
    assert store.access.revoke_key(key.id, 7)
    assert store.access.revoke_key(key.id, 9)  # again: the first time counts
    assert not store.access.revoke_key("no such", 9)
    found = store.access.find_key("k")
    assert found is not None
    assert found.revoked_us == 7
    assert not found.is_valid(8)
    assert store.access.find_session("s") is None
    assert store.access.find_session("t") is not None


def test_a_session_knows_its_key_and_ends(store: Store) -> None:
    key = store.access.add_key(prefix="p", sha256="k", role="engineer", created_us=1, expires_us=50)
    session = store.access.add_session(sha256="s", key_id=key.id, created_us=5, expires_us=100)
    assert store.access.find_session("s") == session
    assert session.key.role == "engineer"
    assert session.is_valid(49)
    assert not session.is_valid(50)  # with its key
    store.access.end_session("s")
    assert store.access.find_session("s") is None
    store.access.end_session("s")
    with pytest.raises(KeyError, match="no API key 'nobody'"):
        store.access.add_session(sha256="x", key_id="nobody", created_us=1, expires_us=2)


def test_old_sessions_are_cleared_away(store: Store) -> None:
    key = store.access.add_key(prefix="p", sha256="k", role="viewer", created_us=1, expires_us=None)
    store.access.add_session(sha256="old", key_id=key.id, created_us=5, expires_us=100)
    store.access.add_session(sha256="new", key_id=key.id, created_us=100, expires_us=200)
    assert store.access.find_session("old") is None
    assert store.access.find_session("new") is not None


def test_a_hash_belongs_to_one_key(store: Store) -> None:
    store.access.add_key(prefix="p", sha256="k", role="viewer", created_us=1, expires_us=None)
    with pytest.raises(IntegrityError):
        store.access.add_key(prefix="p", sha256="k", role="admin", created_us=1, expires_us=None)
    assert len(store.access.list_keys()) == 1
