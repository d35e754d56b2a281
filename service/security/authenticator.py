"""Who is calling: keys and session cookies, verified against the store and remembered briefly.

A SCADA system that polls ten times a second costs the store one look-up in a while; a revoked key
is refused within `MEMORY_S`. Times are wall time.
"""

import asyncio
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import structlog
from anyio import CapacityLimiter, to_thread

from service.security.keys import fingerprint, verify_key, wall_us
from service.security.limits import RateLimit
from service.store import ApiKey, Role, Store, StoreUnavailableError

MEMORY_S = 0.6
MEMORY_WITHOUT_STORE_S = 600.0
SESSION_S = 12 * 3600
SESSION_RENEWAL_S = 600
FAILED_LOGINS_PER_MINUTE = 10
REQUESTS_PER_MINUTE = 120_000
_MOST_REMEMBERED = 1024

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Principal:
    """Who is calling.

    Attributes
    ----------
    role
        What the key may do.
    key_id, prefix
        The key, as `keys list` shows it.
    expires_us
        Wall time at which the key or the session ends, UTC microseconds; None for never.
    session
        True when the key came by a browser session.
    label
        What people call the key.
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


@dataclass(frozen=True, slots=True)
class _Remembered:
    principal: Principal | None
    at_s: float


class Authenticator:
    """Verifies keys and sessions; used in the event loop.

    Parameters
    ----------
    store : Store
        Where keys and sessions are kept.
    failed_logins_per_minute
        Wrong keys that an address may offer.
    requests_per_minute
        Requests that a key may make.

    Attributes
    ----------
    failures, requests : RateLimit
        Wrong keys by address, requests by the key's id; whoever asks counts them.
    """

    def __init__(
        self,
        store: Store,
        failed_logins_per_minute: int = FAILED_LOGINS_PER_MINUTE,
        requests_per_minute: int = REQUESTS_PER_MINUTE,
    ) -> None:
        self._store = store
        self.failures = RateLimit(failed_logins_per_minute)
        self.requests = RateLimit(requests_per_minute)
        # Wrong keys are wrong for ever: a client that goes on with one costs no look-up.
        self._wrong: OrderedDict[str, None] = OrderedDict()
        self._memory: OrderedDict[str, _Remembered] = OrderedDict()
        # One at a time, apart from the threads that serve long queries: a poll never waits
        # behind a report, and a session is never renewed twice at once.
        self._limiter = CapacityLimiter(1)
        self._pending: dict[str, asyncio.Future[Principal | None]] = {}

    async def by_key(self, text: str) -> Principal | None:
        """Who a key belongs to; None when it opens nothing."""
        sha256 = fingerprint(text)
        if sha256 in self._wrong:
            return None
        principal = await self._recall(f"key {sha256}", lambda: self._verify_key(text))
        if principal is None:
            self._remember_wrong(sha256)
        return principal

    def by_key_now(self, text: str, patience_s: float) -> Principal | None:
        """Who a key belongs to, as `by_key`, for a caller that cannot await.

        The event loop stands still meanwhile, so the store has only `patience_s` to answer.
        """
        sha256 = fingerprint(text)
        if sha256 in self._wrong:
            return None
        name, now_s = f"key {sha256}", time.monotonic()
        thread = ThreadPoolExecutor(1, thread_name_prefix="key")
        try:
            principal = thread.submit(self._verify_key, text).result(patience_s)
        except TimeoutError:
            late = StoreUnavailableError(f"the store did not answer within {patience_s:g} s")
            return self._known_without_store(name, now_s, late)
        except StoreUnavailableError as error:
            return self._known_without_store(name, now_s, error)
        finally:
            thread.shutdown(wait=False)
        self._remember(name, principal, now_s)
        if principal is None:
            self._remember_wrong(sha256)
        return principal

    def knows(self, text: str) -> bool:
        """Tell whether a key was looked up lately, with whatever result."""
        sha256 = fingerprint(text)
        return sha256 in self._wrong or f"key {sha256}" in self._memory

    async def by_session(self, cookie: str) -> Principal | None:
        """Who a session cookie belongs to; using it keeps the session alive."""
        sha256 = fingerprint(cookie)
        return await self._recall(f"session {sha256}", lambda: self._verify_session(sha256))

    async def log_in(self, principal: Principal) -> tuple[str, Principal]:
        """Open a browser session; returns the cookie's value and the caller as of now."""
        cookie = secrets.token_urlsafe(32)
        now_us = wall_us()
        session = await to_thread.run_sync(
            lambda: self._store.add_session(
                sha256=fingerprint(cookie),
                key_id=principal.key_id,
                created_us=now_us,
                expires_us=now_us + SESSION_S * 1_000_000,
            ),
            limiter=self._limiter,
        )
        return cookie, _of_session(session.key, session.expires_us)

    async def log_out(self, cookie: str) -> None:
        """End a browser session."""
        sha256 = fingerprint(cookie)
        await to_thread.run_sync(self._store.end_session, sha256, limiter=self._limiter)
        self._memory.pop(f"session {sha256}", None)

    def forget(self, key_id: str) -> None:
        """Look a key and its sessions up anew: it was revoked here and now."""
        for name, known in list(self._memory.items()):
            if known.principal is not None and known.principal.key_id == key_id:
                del self._memory[name]

    async def _recall(self, name: str, look_up: Callable[[], Principal | None]) -> Principal | None:
        known = self._memory.get(name)
        now_s = time.monotonic()
        if known is not None and now_s - known.at_s < MEMORY_S:
            return known.principal
        try:
            principal = await self._look_up_once(name, look_up)
        except StoreUnavailableError as error:
            return self._known_without_store(name, now_s, error)
        self._remember(name, principal, now_s)
        return principal

    def _known_without_store(
        self, name: str, now_s: float, error: StoreUnavailableError
    ) -> Principal | None:
        """Without the store nothing can have been revoked through it either.

        Whoever was known a moment ago keeps watching the machine.
        """
        known = self._memory.get(name)
        if known is None or now_s - known.at_s > MEMORY_WITHOUT_STORE_S:
            raise error
        _log.warning("store_away_trusting_known_key", since_s=round(now_s - known.at_s, 1))
        return known.principal

    def _remember(self, name: str, principal: Principal | None, now_s: float) -> None:
        if principal is None:
            self._memory.pop(name, None)
            return
        self._memory[name] = _Remembered(principal, now_s)
        self._memory.move_to_end(name)
        while len(self._memory) > _MOST_REMEMBERED:
            self._memory.popitem(last=False)

    def _remember_wrong(self, sha256: str) -> None:
        self._wrong[sha256] = None
        while len(self._wrong) > _MOST_REMEMBERED:
            self._wrong.popitem(last=False)

    async def _look_up_once(
        self, name: str, look_up: Callable[[], Principal | None]
    ) -> Principal | None:
        """Look up in a thread; hundreds of streams with one key wait for one look-up together."""
        pending = self._pending.get(name)
        if pending is None:
            pending = asyncio.ensure_future(to_thread.run_sync(look_up, limiter=self._limiter))
            self._pending[name] = pending

            def ended(done: "asyncio.Future[Principal | None]") -> None:
                self._pending.pop(name, None)
                if not done.cancelled():
                    done.exception()  # whoever asked may be gone by now

            pending.add_done_callback(ended)
        return await asyncio.shield(pending)

    def _verify_key(self, text: str) -> Principal | None:
        key = verify_key(self._store, text)
        if key is None:
            return None
        return Principal(
            key.role, key.id, key.prefix, key.expires_us, session=False, label=key.label
        )

    def _verify_session(self, sha256: str) -> Principal | None:
        session = self._store.find_session(sha256)
        now_us = wall_us()
        if session is None or not session.is_valid(now_us):
            return None
        expires_us = now_us + SESSION_S * 1_000_000
        if expires_us - session.expires_us < SESSION_RENEWAL_S * 1_000_000:
            return _of_session(session.key, session.expires_us)
        self._store.end_session(sha256)
        self._store.add_session(
            sha256=sha256,
            key_id=session.key.id,
            created_us=session.created_us,
            expires_us=expires_us,
        )
        return _of_session(session.key, expires_us)


def _of_session(key: ApiKey, expires_us: int) -> Principal:
    ends_us = expires_us if key.expires_us is None else min(expires_us, key.expires_us)
    return Principal(key.role, key.id, key.prefix, ends_us, session=True, label=key.label)
