"""Who may use the OPC UA server: holders of a key, checked, counted and noted as over HTTP."""

from dataclasses import dataclass
from typing import Any

import structlog
from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole

from service.domain.roles import VIEWER
from service.security import failed_logins
from service.security.audit_trail import AuditTrail
from service.security.authenticator import Authenticator
from service.security.keys import key_prefix
from service.store import StoreUnavailableError

_log = structlog.get_logger(__name__)


@dataclass
class KeyUser(User):  # type: ignore[misc]  # the library has no types
    """A user without any right to write, and the key that let it in; empty for anybody."""

    key: str = ""


class KeyUsers:
    """Lets in users who give a key as password, and on loopback everybody; for reading only.

    ``admitted``: who may activate the session that is being activated, as `admit` has found out.
    """

    def __init__(self, authenticator: Authenticator, trail: AuditTrail, anonymous: bool) -> None:
        self._authenticator = authenticator
        self._trail = trail
        self._anonymous = anonymous
        self.admitted: User | None = None

    def get_user(self, iserver: Any, **offered: Any) -> User | None:
        """Give the user, or None; the library calls this in the event loop and cannot wait."""
        return self.admitted

    async def admit(self, password: str | bytes | None, address: str) -> User | None:
        """Find out whether a password lets in, from this address.

        Raises `ServiceError` after too many wrong keys from this address, and when the store does
        not answer.
        """
        if not password:
            return KeyUser(role=UserRole.User) if self._anonymous else None
        text = password.decode(errors="replace") if isinstance(password, bytes) else password
        if key_prefix(text) is None:  # no guess, and nothing to look up
            return None
        keys, guess = self._authenticator, not self._authenticator.knows(text)
        if guess and failed_logins.wait_s(keys, failed_logins.REFUSED, address):
            raise ServiceError(ua.StatusCodes.BadTooManyOperations)
        try:
            principal = await keys.by_key(text)
        except StoreUnavailableError as error:
            _log.warning("opcua_key_not_checked", reason=str(error))
            raise ServiceError(ua.StatusCodes.BadResourceUnavailable) from error
        if principal is None and guess:
            failed_logins.count_wrong_key(keys, failed_logins.REFUSED, address)
            await failed_logins.note_wrong_key(self._trail, failed_logins.REFUSED, address, text)
        if principal is None or principal.role not in VIEWER:
            return None
        return KeyUser(role=UserRole.User, key=text)

    async def may_stay(self, user: User) -> bool:
        """Whether the key of someone who was let in still opens."""
        if not isinstance(user, KeyUser) or not user.key:
            return True
        try:
            principal = await self._authenticator.by_key(user.key)
        except StoreUnavailableError:
            return True  # the store does not answer; sessions that were let in stay
        return principal is not None and principal.role in VIEWER
