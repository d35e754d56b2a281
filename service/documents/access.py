"""Keys, sessions and the audit trail."""

from typing import Self

from pydantic import Field

from service.clock import rfc3339
from service.documents.base import Document, Page, Time, time_or_none
from service.domain.roles import Role
from service.security.authenticator import Principal
from service.store import ApiKey, AuditEntry


class SessionDocument(Document):
    """The current session."""

    role: Role = Field(examples=["operator"])
    key_id: str
    prefix: str = Field(examples=["bt_1a2b3c4d"])
    label: str = Field(description="Label of the key.", examples=["control room"])
    expires_at: Time | None = Field(description="Wall time; null: it does not expire.")
    session: bool = Field(description="True for a browser session, false for a key.")

    @classmethod
    def of(cls, principal: Principal) -> Self:
        """Show who is calling."""
        return cls(
            role=principal.role,
            key_id=principal.key_id,
            prefix=principal.prefix,
            label=principal.label,
            expires_at=time_or_none(principal.expires_us),
            session=principal.session,
        )


class KeyDocument(Document):
    """An API key; the key itself is never shown again. Times are wall times."""

    id: str = Field(examples=["9b1f0c2d3e4f5a6b7c8d9e0f1a2b3c4d"])
    prefix: str = Field(examples=["bt_1a2b3c4d"])
    role: Role
    label: str = Field(examples=["control room"])
    created_at: Time
    expires_at: Time | None = Field(description="Null: it does not expire.")
    revoked_at: Time | None = Field(description="Null: it is not revoked.")

    @classmethod
    def of(cls, key: ApiKey) -> Self:
        """Show a key."""
        return cls(
            id=key.id,
            prefix=key.prefix,
            role=key.role,
            label=key.label,
            created_at=rfc3339(key.created_us),
            expires_at=time_or_none(key.expires_us),
            revoked_at=time_or_none(key.revoked_us),
        )


class NewKeyDocument(KeyDocument):
    """A key that was just made."""

    key: str = Field(description="The key, shown this once.", examples=["bt_1a2b3c4d_…"])

    @classmethod
    def made(cls, key: ApiKey, text: str) -> Self:
        """Show a new key with its text."""
        return cls(**dict(KeyDocument.of(key)), key=text)


class KeyList(Page):
    """API keys, newest first."""

    items: list[KeyDocument]


class AuditLine(Document):
    """One change that somebody asked for."""

    time: Time = Field(description="Wall time.")
    who: str = Field(
        description="Role, prefix and label of the key.",
        examples=["operator bt_1a2b3c4d (control room)"],
    )
    address: str = Field(description="Where the call came from.", examples=["192.0.2.7"])
    action: str = Field(examples=["alarm.acknowledge"])
    target: str = Field(examples=["alarm 3f2b8c0e"])
    detail: str = Field(description="What was requested.", examples=["comment: load is reduced"])

    @classmethod
    def of(cls, entry: AuditEntry) -> Self:
        """Show a line of the trail."""
        return cls(
            time=rfc3339(entry.time_us),
            who=entry.who,
            address=entry.address,
            action=entry.action,
            target=entry.target,
            detail=entry.detail,
        )


class AuditList(Page):
    """The audit trail, newest first."""

    items: list[AuditLine]
