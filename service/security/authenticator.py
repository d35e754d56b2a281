"""Who is calling: keys and session cookies, verified against the store and remembered briefly.

A SCADA system that polls ten times a second costs the store one look-up in a while; a revoked key
is refused within `MEMORY_S`. Times are wall time.
"""

import asyncio
import re
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import structlog
from anyio import CapacityLimiter, to_thread
from cachetools import FIFOCache, LRUCache

from service.clock import wall_us
from service.domain.roles import Role
from service.security.keys import find_key, fingerprint
from service.security.limits import RateLimit
from service.store import ApiKey, AuditEntry, Store, StoreUnavailableError

MEMORY_S = 0.6
MEMORY_WITHOUT_STORE_S = 600.0
SESSION_S = 12 * 3600
SESSION_RENEWAL_S = 600
#: However often it is used, a session ends after so long.
LONGEST_SESSION_S = 7 * 86_400
MOST_SESSIONS = 20
FAILED_LOGINS_PER_MINUTE = 10
LOGINS_PER_MINUTE = 120
UNKNOWN_SESSIONS_PER_MINUTE = 30
REQUESTS_PER_MINUTE = 120_000
#: Seconds that the store has to say whether a key is still valid, and whether an unknown one is.
KNOWN_PATIENCE_S = 2.0
UNKNOWN_PATIENCE_S = 5.0
_MOST_REMEMBERED = 1024
_MOST_UNKNOWN_AT_ONCE = 64
_COOKIE_BYTES = 32
_COOKIE = re.compile(r"[A-Za-z0-9_-]{43}")

Answer = TypeVar("Answer")

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Principal:
    """Who is calling.

    - ``key_id``, ``prefix``: the key, as `keys list` shows it.
    - ``expires_us``: wall time at which the key or the session ends, UTC microseconds; None for
      never.
    - ``session``: True when the key came by a browser session.
    """

    role: Role
    key_id: str
    prefix: str
    expires_us: int | None
    session: bool
    label: str = ""

    @property
    def who(self) -> str:
        """How journals name the caller."""
        return f"{self.role} {self.prefix}" + (f" ({self.label})" if self.label else "")

    def is_over(self, now_us: int) -> bool:
        """Whether the key or the session has ended by itself at this wall time."""
        return self.expires_us is not None and self.expires_us <= now_us


@dataclass(frozen=True, slots=True)
class _Remembered:
    principal: Principal
    at_s: float


@dataclass(frozen=True, slots=True)
class _Pending:
    look_up: "asyncio.Future[Principal | None]"
    since_s: float


class Authenticator:
    """Verifies keys and sessions; used in the event loop.

    Its callers count in the rate limits: wrong keys by address, log-ins by the key's id, unknown
    sessions by address, requests by the key's id.
    """

    def __init__(
        self,
        store: Store,
        failed_logins_per_minute: int = FAILED_LOGINS_PER_MINUTE,
        requests_per_minute: int = REQUESTS_PER_MINUTE,
    ) -> None:
        self._store = store
        self.failures = RateLimit(failed_logins_per_minute)
        self.logins = RateLimit(LOGINS_PER_MINUTE)
        self.strangers = RateLimit(UNKNOWN_SESSIONS_PER_MINUTE)
        self.requests = RateLimit(requests_per_minute)
        # What is wrong stays wrong, also what was revoked or ended here and now: a client that
        # goes on with it costs no look-up.
        self._wrong: FIFOCache[str, None] = FIFOCache(_MOST_REMEMBERED)
        self._memory: LRUCache[str, _Remembered] = LRUCache(_MOST_REMEMBERED)
        self._revoked: FIFOCache[str, None] = FIFOCache(_MOST_REMEMBERED)  # ids, here and now
        # Apart from the threads that serve long queries: a poll never waits behind a report; and
        # who is known never waits behind those who are not.
        self._limiter, self._unknown_limiter = CapacityLimiter(1), CapacityLimiter(1)
        self._unknown_waiting = 0
        self._pending: dict[str, _Pending] = {}

    async def by_key(self, text: str) -> Principal | None:
        """Who a key belongs to; None when it opens nothing."""
        sha256 = fingerprint(text)
        if sha256 in self._wrong:
            return None
        principal = await self._recall(f"key {sha256}", lambda: self._find_key(text))
        return self._if_still(principal, sha256)

    def knows(self, text: str) -> bool:
        """Whether a key was looked up lately, with whatever result."""
        sha256 = fingerprint(text)
        return sha256 in self._wrong or f"key {sha256}" in self._memory

    def is_in_use(self, text: str) -> bool:
        """Whether a key has opened something since the start, and may still do so."""
        sha256 = fingerprint(text)
        known = self._memory.get(f"key {sha256}")
        return known is not None and self._if_still(known.principal, sha256) is not None

    def knows_session(self, cookie: str) -> bool:
        """Whether a session cookie was looked up lately, or cannot be one."""
        if not _COOKIE.fullmatch(cookie):
            return True
        sha256 = fingerprint(cookie)
        return sha256 in self._wrong or f"session {sha256}" in self._memory

    async def by_session(self, cookie: str) -> Principal | None:
        """Who a session cookie belongs to; using it keeps the session alive."""
        if not _COOKIE.fullmatch(cookie):
            return None
        sha256 = fingerprint(cookie)
        if sha256 in self._wrong:
            return None
        principal = await self._recall(f"session {sha256}", lambda: self._verify_session(sha256))
        return self._if_still(principal, sha256)

    async def log_in(self, principal: Principal) -> tuple[str, Principal]:
        """Open a browser session; returns the cookie's value and the caller as of now.

        Of more than `MOST_SESSIONS` of a key those end that were opened first.
        """
        cookie = secrets.token_urlsafe(_COOKIE_BYTES)
        now_us = wall_us()
        session = await self._in_time(
            lambda: self._store.access.add_session(
                sha256=fingerprint(cookie),
                key_id=principal.key_id,
                created_us=now_us,
                expires_us=now_us + SESSION_S * 1_000_000,
                most=MOST_SESSIONS,
            )
        )
        return cookie, _of_session(session.key, session.expires_us)

    async def log_out(self, cookie: str, line: AuditEntry | None = None) -> None:
        """End a browser session, with the line of the audit trail that says so."""
        sha256 = fingerprint(cookie)
        await self._in_time(lambda: self._store.access.end_session(sha256, line))
        self._memory.pop(f"session {sha256}", None)
        self._wrong[sha256] = None

    async def _in_time(self, work: Callable[[], Answer]) -> Answer:
        """Work with the store in a thread; one that hangs is left behind."""
        try:
            async with asyncio.timeout(UNKNOWN_PATIENCE_S):
                return await to_thread.run_sync(work, limiter=self._limiter, abandon_on_cancel=True)
        except TimeoutError:
            raise _hangs(UNKNOWN_PATIENCE_S) from None

    def forget(self, key_id: str) -> None:
        """Refuse a key and its sessions from now on: it was revoked here and now."""
        self._revoked[key_id] = None

    def _if_still(self, principal: Principal | None, sha256: str) -> Principal | None:
        """Leave out who may come in no more, whatever a look-up that was under way has found."""
        if principal is None or principal.key_id in self._revoked:
            # Made of random bits, it is never any other key or session.
            self._wrong[sha256] = None
        if principal is None or sha256 in self._wrong:
            return None
        # Not for good: a clock that was wrong can be set back.
        return None if principal.is_over(wall_us()) else principal

    async def _recall(self, name: str, look_up: Callable[[], Principal | None]) -> Principal | None:
        known = self._memory.get(name)
        now_s = time.monotonic()
        if known is not None and now_s - known.at_s < MEMORY_S:
            return known.principal
        try:
            return await self._look_up_once(name, look_up, known is not None)
        except StoreUnavailableError as error:
            return self._known_without_store(name, now_s, error)

    def _known_without_store(
        self, name: str, now_s: float, error: StoreUnavailableError
    ) -> Principal | None:
        """Without the store nothing can have been revoked through it either.

        A caller that was known a moment ago keeps watching the machine.
        """
        known = self._memory.get(name)
        if known is None or now_s - known.at_s > MEMORY_WITHOUT_STORE_S:
            raise error
        _log.warning("store_away_trusting_known_key", since_s=round(now_s - known.at_s, 1))
        return known.principal

    def _remember(self, name: str, principal: Principal | None, now_s: float) -> None:
        if principal is None:
            self._memory.pop(name, None)
        else:
            self._memory[name] = _Remembered(principal, now_s)

    async def _look_up_once(
        self, name: str, look_up: Callable[[], Principal | None], known: bool
    ) -> Principal | None:
        """Look up in a thread; hundreds of streams with one key wait for one look-up together.

        A store that hangs is asked once for each key, and no caller waits for it longer than that.
        """
        limiter = self._limiter if known else self._unknown_limiter
        patience_s = KNOWN_PATIENCE_S if known else UNKNOWN_PATIENCE_S
        pending = self._pending.get(name)
        if pending is None:
            if not known and self._unknown_waiting >= _MOST_UNKNOWN_AT_ONCE:
                raise StoreUnavailableError("too many unknown keys wait for the store")
            pending = _Pending(
                asyncio.ensure_future(to_thread.run_sync(look_up, limiter=limiter)),
                time.monotonic(),
            )
            self._pending[name] = pending
            since_s = pending.since_s
            self._unknown_waiting += not known

            def ended(done: "asyncio.Future[Principal | None]") -> None:
                self._pending.pop(name, None)
                self._unknown_waiting -= not known
                # Also when the caller is gone by now.
                if not done.cancelled() and done.exception() is None:
                    self._remember(name, done.result(), since_s)

            pending.look_up.add_done_callback(ended)
        left_s = pending.since_s + patience_s - time.monotonic()
        done, _ = await asyncio.wait({pending.look_up}, timeout=max(left_s, 0.0))
        if not done:
            raise _hangs(patience_s)
        return pending.look_up.result()

    def _find_key(self, text: str) -> Principal | None:
        key = find_key(self._store, text)
        if key is None:
            return None
        return Principal(
            key.role, key.id, key.prefix, key.expires_us, session=False, label=key.label
        )

    def _verify_session(self, sha256: str) -> Principal | None:
        session = self._store.access.find_session(sha256)
        now_us = wall_us()
        ends_us = 0 if session is None else session.created_us + LONGEST_SESSION_S * 1_000_000
        if session is None or not session.is_valid(now_us) or ends_us <= now_us:
            return None
        expires_us = min(now_us + SESSION_S * 1_000_000, ends_us)
        if expires_us - session.expires_us < SESSION_RENEWAL_S * 1_000_000:
            return _of_session(session.key, min(session.expires_us, ends_us))
        self._store.access.end_session(sha256)
        self._store.access.add_session(
            sha256=sha256,
            key_id=session.key.id,
            created_us=session.created_us,
            expires_us=expires_us,
        )
        return _of_session(session.key, expires_us)


def _hangs(patience_s: float) -> StoreUnavailableError:
    return StoreUnavailableError(f"the store did not answer within {patience_s:g} s")


def _of_session(key: ApiKey, expires_us: int) -> Principal:
    ends_us = expires_us if key.expires_us is None else min(expires_us, key.expires_us)
    return Principal(key.role, key.id, key.prefix, ends_us, session=True, label=key.label)
