"""Wrong keys: an address has a limited number, and they leave lines in the audit trail.

The same for every way by which a key may come; the answer to the caller is the way's own.
"""

from service.security.audit_trail import AuditTrail
from service.security.authenticator import Authenticator
from service.security.keys import Actor, key_prefix
from service.security.sites import site_of

REFUSED = "key.refuse"


def wait_s(authenticator: Authenticator, action: str, address: str) -> float:
    """Seconds until this address may offer another key that may be a guess; 0 for now."""
    return authenticator.failures.wait_s(_caller(action, address))


def count_wrong_key(authenticator: Authenticator, action: str, address: str) -> None:
    """Count a wrong key that this address has offered."""
    authenticator.failures.count(_caller(action, address))


async def note_wrong_key(trail: AuditTrail, action: str, address: str, key: str) -> None:
    """Write a wrong key into the audit trail, by its prefix alone; at most a line a minute."""
    offered = key_prefix(key)
    detail = f"a wrong key ({offered})" if offered else "no key of this service"
    await trail.note_repeated(Actor("unknown", address), action, detail)


def _caller(action: str, address: str) -> str:
    return f"{action} {site_of(address)}"
