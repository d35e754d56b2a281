"""Who may do what: keys, browser sessions and roles."""

from service.security.audit_trail import AuditTrail
from service.security.authenticator import Authenticator, Principal
from service.security.keys import (
    Actor,
    NewKey,
    UnknownKeyError,
    UnknownRoleError,
    create_key,
    list_keys,
    revoke_all_keys,
    revoke_key,
    verify_key,
)

__all__ = [
    "Actor",
    "AuditTrail",
    "Authenticator",
    "NewKey",
    "Principal",
    "UnknownKeyError",
    "UnknownRoleError",
    "create_key",
    "list_keys",
    "revoke_all_keys",
    "revoke_key",
    "verify_key",
]
