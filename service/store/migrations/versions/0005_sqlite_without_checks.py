"""SQLite: samples are not compared with the table of channels either, see migration 0003."""

import re

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

_CONSTRAINT = re.compile(
    r",\s*CONSTRAINT fk_samples_channel_id_channels"
    r"\s+FOREIGN KEY\s*\(channel_id\)\s*REFERENCES channels\s*\(id\)"
)


def upgrade() -> None:
    connection = op.get_bind()
    if connection.dialect.name != "sqlite":
        return
    # What SQLite's manual gives for dropping a constraint (lang_altertable.html, section 7):
    # rows are not touched, so that a large table takes no longer than a small one.
    described = sa.text("SELECT sql FROM sqlite_schema WHERE type = 'table' AND name = 'samples'")
    statement, count = _CONSTRAINT.subn("", connection.scalar(described))
    if count != 1:
        raise RuntimeError("table samples: expected one foreign key to the channels")
    version = connection.scalar(sa.text("PRAGMA schema_version"))
    connection.exec_driver_sql("PRAGMA writable_schema = ON")
    connection.execute(
        sa.text("UPDATE sqlite_schema SET sql = :sql WHERE type = 'table' AND name = 'samples'"),
        {"sql": statement},
    )
    connection.exec_driver_sql(f"PRAGMA schema_version = {version + 1}")
    connection.exec_driver_sql("PRAGMA writable_schema = OFF")
