import asyncio
import secrets
import sqlite3
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from patience import within

from service.clock import wall_us
from service.security.authenticator import (
    MEMORY_S,
    MOST_SESSIONS,
    SESSION_S,
    Authenticator,
    Principal,
)
from service.security.keys import create_key, fingerprint, revoke_key
from service.store import Store, StoreUnavailableError


def take_away(store: Store, data_dir: Path) -> None:
    store.close()
    database = data_dir / "bearing-twin.db"
    database.rename(data_dir / "elsewhere.db")
    database.mkdir()


async def test_key_names_its_owner(store: Store) -> None:
    key = create_key(store, "operator")
    principal = await Authenticator(store).by_key(key.text)
    assert principal == Principal("operator", key.record.id, key.record.prefix, None, False)
    assert principal is not None
    assert principal.who == f"operator {key.record.prefix}"


async def test_an_expired_key_opens_nothing(store: Store) -> None:
    text = "bt_12345678_" + "A" * 43
    now_us = wall_us()
    store.access.add_key(
        prefix=text[:11],
        sha256=fingerprint(text),
        role="viewer",
        created_us=now_us - 10,
        expires_us=now_us - 1,
    )
    assert await Authenticator(store).by_key(text) is None


async def test_unknown_key_and_cookie_are_nobody(store: Store) -> None:
    authenticator = Authenticator(store)
    assert await authenticator.by_key("bt_00000000_" + "A" * 43) is None
    assert await authenticator.by_session("nothing") is None


async def test_key_made_later_is_known_at_once(store: Store) -> None:
    authenticator = Authenticator(store)
    await authenticator.by_key("bt_00000000_" + "A" * 43)
    key = create_key(store, "viewer")
    assert await authenticator.by_key(key.text) is not None


async def test_polling_asks_the_store_once_in_a_while(store: Store, tmp_path: Path) -> None:
    authenticator = Authenticator(store)
    key = create_key(store, "viewer")
    await authenticator.by_key(key.text)
    take_away(store, tmp_path)
    for _ in range(1000):
        assert await authenticator.by_key(key.text) is not None


async def test_many_that_ask_at_once_share_one_look_up(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    authenticator = Authenticator(store)
    key = create_key(store, "viewer")
    look_ups = []
    find = store.access.find_key
    monkeypatch.setattr(store.access, "find_key", lambda sha256: look_ups.append(1) or find(sha256))
    found = await asyncio.gather(*(authenticator.by_key(key.text) for _ in range(100)))
    assert None not in found
    assert len(look_ups) == 1


async def test_revoked_key_is_refused_within_two_seconds(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 1000.0
    monkeypatch.setattr(
        "service.security.authenticator.time", SimpleNamespace(monotonic=lambda: now_s)
    )
    authenticator = Authenticator(store)
    key = create_key(store, "viewer")
    assert await authenticator.by_key(key.text) is not None
    revoke_key(store, key.record.id)
    assert await authenticator.by_key(key.text) is not None, "the store is not asked every time"
    now_s += 2.0
    assert await authenticator.by_key(key.text) is None


async def test_known_key_is_trusted_while_the_store_is_away(store: Store, tmp_path: Path) -> None:
    authenticator = Authenticator(store)
    known, unknown = create_key(store, "viewer"), create_key(store, "admin")
    await authenticator.by_key(known.text)
    take_away(store, tmp_path)
    await asyncio.sleep(MEMORY_S + 0.05)
    assert await authenticator.by_key(known.text) is not None
    with pytest.raises(StoreUnavailableError):
        await authenticator.by_key(unknown.text)


async def test_a_revoked_key_is_refused_while_the_store_is_away(
    store: Store, tmp_path: Path
) -> None:
    authenticator = Authenticator(store)
    key = create_key(store, "viewer")
    principal = await authenticator.by_key(key.text)
    assert principal is not None
    cookie, _ = await authenticator.log_in(principal)
    await authenticator.by_session(cookie)
    revoke_key(store, key.record.id)
    authenticator.forget(key.record.id)
    take_away(store, tmp_path)
    assert await authenticator.by_key(key.text) is None
    assert await authenticator.by_session(cookie) is None
    assert authenticator.knows(key.text)
    assert not authenticator.is_in_use(key.text)


@pytest.mark.parametrize("store_is_away", [False, True])
async def test_a_key_opens_nothing_beyond_its_expiry_and_is_right_again_with_the_clock(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, store_is_away: bool
) -> None:
    authenticator = Authenticator(store)
    key = create_key(store, "viewer", expires_in_days=1.0)
    await authenticator.by_key(key.text)
    if store_is_away:
        take_away(store, tmp_path)
    await asyncio.sleep(MEMORY_S + 0.05)
    assert await authenticator.by_key(key.text) is not None
    later_us = wall_us() + 2 * 86_400_000_000
    with monkeypatch.context() as clock:
        clock.setattr("service.security.authenticator.wall_us", lambda: later_us)
        assert await authenticator.by_key(key.text) is None
        assert not authenticator.is_in_use(key.text)
    assert await authenticator.by_key(key.text) is not None


@pytest.mark.parametrize("is_known", [False, True])
async def test_a_look_up_under_way_does_not_bring_a_revoked_key_back(
    store: Store, is_known: bool
) -> None:
    hanging = Hanging(store)
    authenticator = Authenticator(hanging)  # type: ignore[arg-type]
    key = create_key(store, "viewer")
    if is_known:
        assert await authenticator.by_key(key.text) is not None
        await asyncio.sleep(MEMORY_S + 0.05)
    find, gate = store.access.find_key, threading.Event()

    def find_early(sha256: str) -> Any:
        found = find(sha256)
        hanging.asked.append("found")
        assert gate.wait(300)
        return found

    store.access.find_key = find_early  # type: ignore[method-assign]
    asking = asyncio.create_task(authenticator.by_key(key.text))
    async with within(60):
        while "found" not in hanging.asked:  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.01)
    revoke_key(store, key.record.id)
    authenticator.forget(key.record.id)
    gate.set()
    assert await asking is None
    assert await authenticator.by_key(key.text) is None


async def logged_in(store: Store) -> tuple[Authenticator, str, Principal]:
    authenticator = Authenticator(store)
    principal = await authenticator.by_key(create_key(store, "operator").text)
    assert principal is not None
    cookie, opened = await authenticator.log_in(principal)
    return authenticator, cookie, opened


async def test_session_is_as_good_as_its_key_for_twelve_hours(store: Store) -> None:
    authenticator, cookie, opened = await logged_in(store)
    principal = await authenticator.by_session(cookie)
    assert principal == opened
    assert opened.session
    assert opened.expires_us is not None
    assert abs(opened.expires_us - wall_us() - SESSION_S * 1_000_000) < 60_000_000


async def test_session_ends_with_log_out(store: Store) -> None:
    authenticator, cookie, _ = await logged_in(store)
    assert await authenticator.by_session(cookie) is not None
    await authenticator.log_out(cookie)
    assert await authenticator.by_session(cookie) is None


async def test_session_ends_with_its_key(store: Store) -> None:
    authenticator, cookie, opened = await logged_in(store)
    revoke_key(store, opened.key_id)
    assert await authenticator.by_session(cookie) is None


def let_time_pass(data_dir: Path, seconds: float) -> None:
    """Move the end of every session nearer, as if it had not been used for so long."""
    with sqlite3.connect(data_dir / "bearing-twin.db") as connection:
        connection.execute(
            "UPDATE browser_sessions SET expires_us = expires_us - ?", (round(seconds * 1e6),)
        )
    connection.close()


async def test_using_a_session_keeps_it_alive(store: Store, tmp_path: Path) -> None:
    _, cookie, opened = await logged_in(store)
    let_time_pass(tmp_path, SESSION_S - 60)
    principal = await Authenticator(store).by_session(cookie)
    assert principal is not None
    assert principal.expires_us is not None
    assert opened.expires_us is not None
    assert principal.expires_us >= opened.expires_us
    kept = store.access.find_session(fingerprint(cookie))
    assert kept is not None
    assert kept.expires_us == principal.expires_us


async def test_session_that_was_not_used_for_twelve_hours_is_over(
    store: Store, tmp_path: Path
) -> None:
    _, cookie, _ = await logged_in(store)
    let_time_pass(tmp_path, SESSION_S + 1)
    assert await Authenticator(store).by_session(cookie) is None


async def test_renewing_at_once_from_many_tabs_loses_nobody(store: Store, tmp_path: Path) -> None:
    _, cookie, _ = await logged_in(store)
    let_time_pass(tmp_path, SESSION_S - 60)
    authenticator = Authenticator(store)
    found = await asyncio.gather(*(authenticator.by_session(cookie) for _ in range(20)))
    assert None not in found


async def test_session_ends_no_later_than_its_key(store: Store) -> None:
    authenticator = Authenticator(store)
    key = create_key(store, "viewer", expires_in_days=0.1)
    principal = await authenticator.by_key(key.text)
    assert principal is not None
    _, opened = await authenticator.log_in(principal)
    assert opened.expires_us == key.record.expires_us


async def test_unknown_keys_take_no_memory(store: Store) -> None:
    authenticator = Authenticator(store)
    for number in range(50):
        await authenticator.by_key(f"bt_{number:08x}_{'A' * 43}")
    assert not authenticator._memory


async def test_a_session_ends_after_a_week_however_often_it_is_used(
    store: Store, tmp_path: Path
) -> None:
    _, cookie, _ = await logged_in(store)
    for days in (6.9, 0.2):
        with sqlite3.connect(tmp_path / "bearing-twin.db") as connection:
            connection.execute(
                "UPDATE browser_sessions SET created_us = created_us - ?",
                (round(days * 86_400e6),),
            )
        connection.close()
        principal = await Authenticator(store).by_session(cookie)
        if days > 1:
            assert principal is not None
            assert principal.expires_us is not None
            assert principal.expires_us - wall_us() < 0.11 * 86_400e6  # a tenth of a day is left
    assert principal is None


async def test_a_key_has_only_so_many_sessions_and_the_oldest_end(store: Store) -> None:
    authenticator = Authenticator(store)
    principal = await authenticator.by_key(create_key(store, "operator").text)
    other = await authenticator.by_key(create_key(store, "viewer").text)
    assert principal is not None
    assert other is not None
    others, _ = await authenticator.log_in(other)
    cookies = [(await authenticator.log_in(principal))[0] for _ in range(MOST_SESSIONS + 3)]
    found = [await authenticator.by_session(cookie) is not None for cookie in cookies]
    assert found == [False] * 3 + [True] * MOST_SESSIONS
    assert await authenticator.by_session(others) is not None


class Hanging:
    """A store whose look-ups hang while it is told to; a database that is frozen, not gone."""

    def __init__(self, store: Store) -> None:
        self._access, self.runs = store.access, threading.Event()
        self.access = self
        self.runs.set()
        self.asked: list[str] = []

    def __getattr__(self, name: str) -> Any:
        asked = getattr(self._access, name)

        def look(*arguments: Any, **named: Any) -> Any:
            self.asked.append(name)
            assert self.runs.wait(300)
            return asked(*arguments, **named)

        return look


async def test_known_callers_are_answered_from_memory_while_the_store_hangs(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    hanging = Hanging(store)
    authenticator = Authenticator(hanging)  # type: ignore[arg-type]
    known, stranger = create_key(store, "viewer"), create_key(store, "admin")
    principal = await authenticator.by_key(known.text)
    assert principal is not None
    cookie, _ = await authenticator.log_in(principal)
    assert await authenticator.by_session(cookie) is not None
    hanging.runs.clear()
    monkeypatch.setattr("service.security.authenticator.KNOWN_PATIENCE_S", 0.2)
    monkeypatch.setattr("service.security.authenticator.UNKNOWN_PATIENCE_S", 0.5)
    try:
        await asyncio.sleep(MEMORY_S + 0.05)
        assert await authenticator.by_key(known.text) == principal
        assert await authenticator.by_session(cookie) is not None
        asked = len(hanging.asked)
        for _ in range(200):  # the store is not asked again, and nobody waits for it again
            assert await authenticator.by_key(known.text) == principal
        assert len(hanging.asked) == asked
        with pytest.raises(StoreUnavailableError):
            await authenticator.by_key(stranger.text)
        with pytest.raises(StoreUnavailableError):
            await authenticator.log_in(principal)
        revoke_key(store, known.record.id)
    finally:
        hanging.runs.set()
        monkeypatch.undo()
    async with within(60):
        while await authenticator.by_key(known.text) is not None:  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.02)
        assert await authenticator.by_key(stranger.text) is not None


async def test_known_callers_do_not_wait_behind_unknown_ones(store: Store) -> None:
    hanging = Hanging(store)
    authenticator = Authenticator(hanging)  # type: ignore[arg-type]
    known = create_key(store, "viewer")
    assert await authenticator.by_key(known.text) is not None
    await asyncio.sleep(MEMORY_S + 0.05)
    hanging.runs.clear()
    strangers = [
        asyncio.create_task(authenticator.by_session(secrets.token_urlsafe(32))) for _ in range(300)
    ]
    async with within(60):
        while not hanging.asked:  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.01)
    hanging.asked.clear()
    asking = asyncio.create_task(authenticator.by_key(known.text))
    async with within(60):
        while "find_key" not in hanging.asked:  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.01)
    hanging.runs.set()
    assert await asking is not None
    answers = await asyncio.gather(*strangers, return_exceptions=True)
    assert any(answer is None for answer in answers)
    # No more wait than there is room for; the rest are told at once.
    assert sum(isinstance(answer, StoreUnavailableError) for answer in answers) > 200


async def test_an_unknown_session_is_looked_up_once_and_nonsense_never(store: Store) -> None:
    hanging = Hanging(store)
    authenticator = Authenticator(hanging)  # type: ignore[arg-type]
    cookie = secrets.token_urlsafe(32)
    for _ in range(10):
        assert await authenticator.by_session(cookie) is None
        assert await authenticator.by_session("nonsense") is None
        assert await authenticator.by_session(cookie + "A") is None
    assert hanging.asked == ["find_session"]
