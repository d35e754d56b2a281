"""Rollups of the samples, which of them are stale, and how far back raw samples are kept."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

_HOUR_US = 3_600_000_000


def upgrade() -> None:
    op.create_table(
        "rollups",
        sa.Column("channel_id", sa.Integer(), nullable=False),
        sa.Column("resolution_s", sa.SmallInteger(), autoincrement=False, nullable=False),
        sa.Column("time_us", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("mean", sa.Double(), nullable=True),
        sa.Column("low", sa.Double(), nullable=True),
        sa.Column("high", sa.Double(), nullable=True),
        sa.Column("good", sa.Integer(), nullable=False),
        sa.Column("quality", sa.SmallInteger(), nullable=False),
        sa.ForeignKeyConstraint(
            ["channel_id"], ["channels.id"], name=op.f("fk_rollups_channel_id_channels")
        ),
        sa.PrimaryKeyConstraint("channel_id", "resolution_s", "time_us", name=op.f("pk_rollups")),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "stale_rollups",
        sa.Column("channel_id", sa.Integer(), nullable=False),
        sa.Column("hour_us", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.ForeignKeyConstraint(
            ["channel_id"], ["channels.id"], name=op.f("fk_stale_rollups_channel_id_channels")
        ),
        sa.PrimaryKeyConstraint("channel_id", "hour_us", name=op.f("pk_stale_rollups")),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "raw_horizon",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("time_us", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_raw_horizon")),
    )
    # What was stored before there were rollups.
    op.execute(
        "INSERT INTO stale_rollups (channel_id, hour_us) "
        f"SELECT DISTINCT channel_id, time_us - time_us % {_HOUR_US} FROM samples"
    )
