import re
import sqlite3
from pathlib import Path

import pytest

from service.clock import DAY_US, wall_us
from service.domain.roles import ROLES
from service.security.keys import (
    UnknownKeyError,
    UnknownRoleError,
    create_key,
    find_key,
    fingerprint,
    list_keys,
    revoke_key,
)
from service.store import Store


@pytest.mark.parametrize("role", ROLES)
def test_key_opens_what_it_was_made_for(store: Store, role: str) -> None:
    key = create_key(store, role)
    record = find_key(store, key.text)
    assert record == key.record
    assert record is not None
    assert record.role == role
    assert record.expires_us is None


def test_key_has_a_recognisable_prefix_and_much_randomness(store: Store) -> None:
    keys = [create_key(store, "viewer") for _ in range(20)]
    for key in keys:
        assert re.fullmatch(r"bt_[0-9a-f]{8}_[A-Za-z0-9_-]{43}", key.text)
        assert key.text.startswith(key.record.prefix + "_")
    assert len({key.text[12:] for key in keys}) == 20


def test_key_itself_is_nowhere_on_the_disk(store: Store, tmp_path: Path) -> None:
    key = create_key(store, "admin")
    store.close()
    secret = key.text.rpartition("_")[2].encode()
    files = [path for path in tmp_path.iterdir() if path.is_file()]
    assert files
    for path in files:
        assert secret not in path.read_bytes()


@pytest.mark.parametrize(
    "text",
    ["", "bt_", "bt_00000000_" + "A" * 43, "x" * 10_000, "bt_0000é000_" + "A" * 43, "\ud800"],
)
def test_anything_else_opens_nothing(store: Store, text: str) -> None:
    create_key(store, "admin")
    assert find_key(store, text) is None


def test_changed_key_opens_nothing(store: Store) -> None:
    text = create_key(store, "viewer").text
    last = "A" if text[-1] != "A" else "B"
    assert find_key(store, text[:-1] + last) is None
    assert find_key(store, text + "A") is None
    assert find_key(store, text.upper()) is None


def test_hash_under_another_prefix_opens_nothing(store: Store, tmp_path: Path) -> None:
    key = create_key(store, "viewer")
    with sqlite3.connect(tmp_path / "bearing-twin.db") as connection:
        connection.execute("UPDATE api_keys SET prefix = 'bt_ffffffff'")
    connection.close()
    assert store.access.find_key(fingerprint(key.text)) is not None
    assert find_key(store, key.text) is None


def test_expired_key_is_not_valid(store: Store) -> None:
    text = "bt_12345678_" + "A" * 43
    now_us = wall_us()
    store.access.add_key(
        prefix=text[:11],
        sha256=fingerprint(text),
        role="viewer",
        created_us=now_us - 10,
        expires_us=now_us - 1,
    )
    record = find_key(store, text)
    assert record is not None
    assert not record.is_valid(wall_us())


def test_expiry_is_counted_in_days(store: Store) -> None:
    record = create_key(store, "viewer", expires_in_days=30).record
    assert record.expires_us is not None
    assert abs(record.expires_us - wall_us() - 30 * DAY_US) < 5_000_000


@pytest.mark.parametrize("days", [0, -1, 1e9, float("nan")])
def test_senseless_expiry_is_refused(store: Store, days: float) -> None:
    with pytest.raises(ValueError, match="days"):
        create_key(store, "viewer", expires_in_days=days)
    assert list_keys(store) == []


def test_unknown_role_names_those_there_are(store: Store) -> None:
    with pytest.raises(UnknownRoleError, match="expected one of viewer, operator"):
        create_key(store, "root")


@pytest.mark.parametrize("by", ["id", "prefix"])
def test_revoked_key_opens_nothing_and_stays_listed(store: Store, by: str) -> None:
    key, other = create_key(store, "viewer"), create_key(store, "operator")
    revoked = revoke_key(store, getattr(key.record, by))
    assert revoked.revoked_us is not None
    assert find_key(store, key.text) is None
    assert find_key(store, other.text) is not None
    assert [one.id for one in list_keys(store)] == [key.record.id, other.record.id]


def test_revoking_what_is_not_there_says_so(store: Store) -> None:
    with pytest.raises(UnknownKeyError, match="no key has"):
        revoke_key(store, "bt_00000000")
