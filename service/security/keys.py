"""API keys: made once, shown once, kept only as a hash.

A key reads ``bt_<id>_<secret>``: eight characters by which people recognise it and 256 random
bits. So much randomness cannot be guessed, which is why a plain SHA-256 is enough to keep.
"""

import hashlib
import hmac
import re
import secrets
from dataclasses import dataclass

from service.clock import DAY_US, wall_us
from service.domain.errors import BearingTwinError
from service.domain.roles import ROLES, Role
from service.domain.texts import is_one_line
from service.security.loopback import is_loopback
from service.site.configuration import SettingsError
from service.store import ApiKey, AuditEntry, Store

_KEY = re.compile(r"bt_[0-9a-f]{8}_[A-Za-z0-9_-]{43}")
_PREFIX_LENGTH = len("bt_00000000")
_SECRET_BYTES = 32
LABEL_LENGTH = 100


class UnknownRoleError(BearingTwinError, ValueError):
    """There is no such role; the text names those there are."""


class UnusableKeyError(BearingTwinError, ValueError):
    """A key cannot be made so; the text names what was given and what was expected."""


class UnknownKeyError(BearingTwinError, ValueError):
    """There is no key of this id or prefix, or more than one."""


@dataclass(frozen=True, slots=True)
class Actor:
    """Who changes something, and from where; for the audit trail."""

    who: str
    address: str = ""


#: The service itself, for example in a demo.
SERVICE = Actor("service")


@dataclass(frozen=True, slots=True)
class NewKey:
    """A key that was just made; `text` is shown to its owner and nowhere kept."""

    text: str
    record: ApiKey


def fingerprint(secret: str) -> str:
    """SHA-256 of a key or a session cookie, hexadecimal."""
    return hashlib.sha256(secret.encode("utf-8", "surrogateescape")).hexdigest()


def looks_like_key(text: str) -> bool:
    """Whether a text has the form of a key, so that nothing else is ever looked up."""
    return _KEY.fullmatch(text) is not None


def key_prefix(text: str) -> str | None:
    """Give the part of a key by which people recognise it; None for any other text."""
    return text[:_PREFIX_LENGTH] if looks_like_key(text) else None


def create_key(
    store: Store,
    role: str,
    expires_in_days: float | None = None,
    label: str = "",
    actor: Actor = SERVICE,
) -> NewKey:
    """Make a key, store its hash and write it into the audit trail.

    A running service sees it at once. Without ``expires_in_days`` it never expires. Raises
    `UnknownRoleError` if there is no such role; `UnusableKeyError` if the days are not positive, or
    the label is no line or too long.
    """
    known: Role | None = next((one for one in ROLES if one == role), None)
    if known is None:
        raise UnknownRoleError(f"role {role!r}: expected one of {', '.join(ROLES)}")
    if expires_in_days is not None and not 0 < expires_in_days <= 36_500:
        raise UnusableKeyError(
            f"expiry of {expires_in_days:g} days: expected more than 0, at most 36500"
        )
    if len(label) > LABEL_LENGTH or not is_one_line(label):
        raise UnusableKeyError(
            f"label: expected at most {LABEL_LENGTH} characters on one line, and no control "
            "characters"
        )
    now_us = wall_us()
    expires_us = None
    if expires_in_days is not None:
        expires_us = now_us + round(expires_in_days * DAY_US)
    text = f"bt_{secrets.token_hex(4)}_{secrets.token_urlsafe(_SECRET_BYTES)}"
    prefix = text[:_PREFIX_LENGTH]
    detail = f"role {role}" + (f", {label}" if label else "")
    record = store.access.add_key(
        prefix=prefix,
        sha256=fingerprint(text),
        role=known,
        created_us=now_us,
        expires_us=expires_us,
        label=label,
        line=_line(actor, "key.create", prefix, detail),
    )
    return NewKey(text, record)


def find_key(store: Store, text: str) -> ApiKey | None:
    """Return the record of a key that was not revoked, but may have ended; None for any other text.

    The look-up goes by the hash, which reveals nothing to an attacker's clock about any key; the
    prefix is compared in constant time on top. Raises `StoreUnavailableError` if the store does not
    answer.
    """
    if not looks_like_key(text):
        return None
    record = store.access.find_key(fingerprint(text))
    if record is None or not hmac.compare_digest(record.prefix, text[:_PREFIX_LENGTH]):
        return None
    return record if record.revoked_us is None else None


def list_keys(store: Store) -> list[ApiKey]:
    """All keys that were ever made, oldest first; never the keys themselves."""
    return store.access.list_keys()


def revoke_key(store: Store, id_or_prefix: str, actor: Actor = SERVICE) -> ApiKey:
    """Revoke a key by its id or its prefix; a running service refuses it within 2 s.

    Its browser sessions and open streams end with it. Doing it again changes nothing. Raises
    `UnknownKeyError` if there is no such key, or several share the prefix.
    """
    found = [key for key in store.access.list_keys() if id_or_prefix in (key.id, key.prefix)]
    if len(found) != 1:
        how_many = "no key has" if not found else f"{len(found)} keys have"
        raise UnknownKeyError(f"key {id_or_prefix!r}: {how_many} this id or prefix")
    (key,) = found
    if key.revoked_us is None:
        store.access.revoke_key(key.id, wall_us(), _revocation(actor, key))
    return next(one for one in store.access.list_keys() if one.id == key.id)


def revoke_all_keys(store: Store, actor: Actor = SERVICE) -> list[ApiKey]:
    """Revoke every key that still opens something; gives those that did.

    For a database restored from a copy: keys revoked and sessions ended since are alive again.
    """
    now_us = wall_us()
    valid = [key for key in store.access.list_keys() if key.is_valid(now_us)]
    return [revoke_key(store, key.id, actor) for key in valid]


def _revocation(actor: Actor, key: ApiKey) -> AuditEntry:
    return _line(actor, "key.revoke", key.prefix, f"role {key.role}")


def _line(actor: Actor, action: str, prefix: str, detail: str) -> AuditEntry:
    return AuditEntry(wall_us(), actor.who, actor.address, action, f"key {prefix}", detail)


def check_key(store: Store | None, host: str) -> None:
    """Refuse a service that other machines may reach and that has no valid key.

    ``store``: None where there is none yet. Raises `SettingsError`.
    """
    now_us = wall_us()
    keys = [] if store is None else store.access.list_keys()
    if not is_loopback(host) and not any(key.is_valid(now_us) for key in keys):
        raise SettingsError(
            f"service.host = {host!r}: reachable from other machines, so at least one API key "
            "is needed; make one with 'bearing-twin keys create --role admin -c FILE'"
        )
