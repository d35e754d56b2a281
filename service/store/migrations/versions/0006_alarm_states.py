"""Alarms that are shelved, suppressed, out of service or latched; a journal with events."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for column in (
        sa.Column("present", sa.Boolean(), nullable=False, server_default=sa.false()),
        sa.Column("latched", sa.Boolean(), nullable=False, server_default=sa.false()),
        sa.Column("shelved_until_us", sa.BigInteger(), nullable=True),
        sa.Column("shelved_by", sa.String(), nullable=True),
        sa.Column("suppressed_reason", sa.String(), nullable=True),
        sa.Column("comment", sa.String(), nullable=True),
    ):
        op.add_column("alarms", column)
    op.execute(f"UPDATE alarms SET present = {_true()} WHERE state IN ('UNACK', 'ACKED')")
    for column in (
        sa.Column("event", sa.String(), nullable=True),
        sa.Column("priority", sa.SmallInteger(), nullable=True),
        sa.Column("until_us", sa.BigInteger(), nullable=True),
    ):
        op.add_column("alarm_journal", column)
    op.execute("UPDATE alarm_journal SET event = ''")
    with op.batch_alter_table("alarm_journal") as journal:
        journal.alter_column("event", existing_type=sa.String(), nullable=False)
        # An event of the journal's own belongs to no alarm.
        journal.alter_column("alarm_id", existing_type=sa.String(), nullable=True)
    op.create_index("ix_alarm_journal_alarm_id", "alarm_journal", ["alarm_id"])


def _true() -> str:
    return "1" if op.get_bind().dialect.name == "sqlite" else "true"
