"""The tables of access: keys, browser sessions, and the audit trail."""

from sqlalchemy import Connection, ForeignKey, Table, event, text
from sqlalchemy.orm import Mapped, mapped_column

from service.store.tables import Base, Serial


class ApiKeyRow(Base):
    """An API key: only its hash is kept.

    A key is 256 random bits, so a plain SHA-256 is enough: there is no dictionary to try.
    """

    __tablename__ = "api_keys"

    id: Mapped[str] = mapped_column(primary_key=True)
    prefix: Mapped[str]
    sha256: Mapped[str] = mapped_column(unique=True)
    role: Mapped[str]
    created_us: Mapped[int]
    expires_us: Mapped[int | None]
    revoked_us: Mapped[int | None]
    label: Mapped[str] = mapped_column(server_default=text("''"))


class BrowserSessionRow(Base):
    """A browser session; its cookie holds 256 random bits, of which only the hash is kept."""

    __tablename__ = "browser_sessions"

    id: Mapped[str] = mapped_column(primary_key=True)
    sha256: Mapped[str] = mapped_column(unique=True)
    key_id: Mapped[str] = mapped_column(ForeignKey("api_keys.id"))
    created_us: Mapped[int]
    expires_us: Mapped[int]


class AuditRow(Base):
    """The audit trail: one line per change that someone asked for.

    The database changes none, and deletes none of the last year; see migrations 0004 and 0008.
    """

    __tablename__ = "audit"

    id: Mapped[int] = mapped_column(Serial, primary_key=True)
    time_us: Mapped[int]
    who: Mapped[str]
    address: Mapped[str]
    action: Mapped[str]
    target: Mapped[str]
    detail: Mapped[str]


#: What keeps the audit trail from being rewritten in a new SQLite file; for PostgreSQL the
#: migrations do it.
_AUDIT_TRIGGERS = (
    "CREATE TRIGGER audit_no_update BEFORE UPDATE ON audit "
    "BEGIN SELECT RAISE(ABORT, 'the audit trail only grows'); END",
    "CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit "
    "WHEN OLD.time_us > (CAST(strftime('%s', 'now') AS INTEGER) - 31536000) * 1000000 "
    "BEGIN SELECT RAISE(ABORT, 'the audit trail only grows'); END",
)


def _protect_audit(table: Table, connection: Connection, **_options: object) -> None:
    if connection.dialect.name == "sqlite":
        for trigger in _AUDIT_TRIGGERS:
            connection.exec_driver_sql(trigger)


event.listen(AuditRow.__table__, "after_create", _protect_audit)
