"""The highest value of an alarm's life with its time, and how long the condition was there."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for table in ("alarms", "alarm_journal"):
        op.add_column(table, sa.Column("peak_value", sa.Double(), nullable=True))
        op.add_column(table, sa.Column("peak_at_us", sa.BigInteger(), nullable=True))
    op.add_column("alarm_journal", sa.Column("duration_s", sa.Double(), nullable=True))
