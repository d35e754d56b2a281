"""API keys and browser sessions, by their hashes.

A key and a session cookie are 256 random bits each, so a plain SHA-256 protects them: there is
nothing to guess and no dictionary to try. Times are wall time in UTC microseconds.
"""

from uuid import uuid4

from sqlalchemy import RowMapping, delete, insert, select, update

from service.domain.roles import Role
from service.store.access_tables import ApiKeyRow, BrowserSessionRow
from service.store.audit import add_line
from service.store.part import StorePart
from service.store.records import ApiKey, AuditEntry, BrowserSession

_KEY_COLUMNS = (
    ApiKeyRow.id,
    ApiKeyRow.prefix,
    ApiKeyRow.role,
    ApiKeyRow.label,
    ApiKeyRow.created_us,
    ApiKeyRow.expires_us,
    ApiKeyRow.revoked_us,
)


class Access(StorePart):
    """The text of a key is never stored, only its prefix and its hash."""

    def add_key(
        self,
        *,
        prefix: str,
        sha256: str,
        role: Role,
        created_us: int,
        expires_us: int | None,
        label: str = "",
        line: AuditEntry | None = None,
    ) -> ApiKey:
        """Store a key, and the line of the audit trail in the same transaction.

        - ``prefix``: the first characters of the key, by which people recognise it.
        - ``sha256``: hash of the key, hexadecimal.
        - ``created_us``, ``expires_us``: wall time, UTC microseconds; a key without expiry lives
          until it is revoked.
        """
        key = ApiKey(uuid4().hex, prefix, role, label, created_us, expires_us, revoked_us=None)
        with self._database.writing() as connection:
            connection.execute(
                insert(ApiKeyRow).values(
                    id=key.id,
                    prefix=prefix,
                    sha256=sha256,
                    role=role,
                    label=label,
                    created_us=created_us,
                    expires_us=expires_us,
                    revoked_us=None,
                )
            )
            add_line(connection, line)
        return key

    def list_keys(self) -> list[ApiKey]:
        """All keys, revoked and expired ones too, oldest first."""
        query = select(*_KEY_COLUMNS).order_by(ApiKeyRow.created_us, ApiKeyRow.id)
        with self._database.reading() as connection:
            return [_key(row._mapping) for row in connection.execute(query)]

    def find_key(self, sha256: str) -> ApiKey | None:
        """Find the key of this hash, valid or not (see `ApiKey.is_valid`), or None."""
        query = select(*_KEY_COLUMNS).where(ApiKeyRow.sha256 == sha256)
        with self._database.reading() as connection:
            row = connection.execute(query).one_or_none()
        return _key(row._mapping) if row else None

    def revoke_key(self, key_id: str, at_us: int, line: AuditEntry | None = None) -> bool:
        """Revoke a key and with it its sessions; False when there is no such key.

        The line of the audit trail is written in the same transaction, and only for a key that
        was not revoked yet.
        """
        with self._database.writing() as connection:
            connection.execute(delete(BrowserSessionRow).where(BrowserSessionRow.key_id == key_id))
            changed = connection.execute(
                update(ApiKeyRow)
                .where(ApiKeyRow.id == key_id, ApiKeyRow.revoked_us.is_(None))
                .values(revoked_us=at_us)
            ).rowcount
            add_line(connection, line if changed else None)
            found = connection.scalar(select(ApiKeyRow.id).where(ApiKeyRow.id == key_id))
        return found is not None

    def add_session(
        self,
        *,
        sha256: str,
        key_id: str,
        created_us: int,
        expires_us: int,
        most: int | None = None,
    ) -> BrowserSession:
        """Store a browser session of a key; sessions that are over by then are cleared away.

        Raises `KeyError` if there is no such key.

        - ``sha256``: hash of the cookie, hexadecimal.
        - ``created_us``, ``expires_us``: wall time, UTC microseconds.
        - ``most``: sessions that the key has then; the ones opened first end.
        """
        with self._database.writing() as connection:
            row = connection.execute(
                select(*_KEY_COLUMNS).where(ApiKeyRow.id == key_id)
            ).one_or_none()
            if row is None:
                raise KeyError(f"no API key {key_id!r}")
            session = BrowserSession(uuid4().hex, _key(row._mapping), created_us, expires_us)
            connection.execute(
                delete(BrowserSessionRow).where(BrowserSessionRow.expires_us <= created_us)
            )
            connection.execute(
                insert(BrowserSessionRow).values(
                    id=session.id,
                    sha256=sha256,
                    key_id=key_id,
                    created_us=created_us,
                    expires_us=expires_us,
                )
            )
            if most is not None:
                oldest = (
                    select(BrowserSessionRow.id)
                    .where(BrowserSessionRow.key_id == key_id)
                    .order_by(BrowserSessionRow.created_us.desc(), BrowserSessionRow.id)
                    .offset(most)
                )
                ended = list(connection.scalars(oldest))
                connection.execute(delete(BrowserSessionRow).where(BrowserSessionRow.id.in_(ended)))
        return session

    def find_session(self, sha256: str) -> BrowserSession | None:
        """Find the session of this hash, valid or not (see `BrowserSession.is_valid`), or None."""
        query = (
            select(
                BrowserSessionRow.id.label("session_id"),
                BrowserSessionRow.created_us.label("session_created_us"),
                BrowserSessionRow.expires_us.label("session_expires_us"),
                *_KEY_COLUMNS,
            )
            .join(ApiKeyRow, ApiKeyRow.id == BrowserSessionRow.key_id)
            .where(BrowserSessionRow.sha256 == sha256)
        )
        with self._database.reading() as connection:
            row = connection.execute(query).one_or_none()
        if row is None:
            return None
        return BrowserSession(
            row.session_id, _key(row._mapping), row.session_created_us, row.session_expires_us
        )

    def end_session(self, sha256: str, line: AuditEntry | None = None) -> None:
        """Forget a session (log out), with the line of the audit trail that says so."""
        with self._database.writing() as connection:
            ended = connection.execute(
                delete(BrowserSessionRow).where(BrowserSessionRow.sha256 == sha256)
            ).rowcount
            add_line(connection, line if ended else None)


def _key(row: RowMapping) -> ApiKey:
    return ApiKey(**{column.key: row[column.key] for column in _KEY_COLUMNS})
