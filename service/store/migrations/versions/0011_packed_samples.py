"""Samples of hours that are over, in compressed blocks; the tables begin empty."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "sample_blocks",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("codec", sa.SmallInteger(), nullable=False),
        sa.Column("crc", sa.BigInteger(), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_sample_blocks")),
    )
    op.create_table(
        "packed_hours",
        sa.Column("channel_id", sa.Integer(), nullable=False),
        sa.Column("hour_us", sa.BigInteger(), nullable=False),
        sa.Column("block_id", sa.BigInteger(), nullable=False),
        sa.Column("position", sa.SmallInteger(), nullable=False),
        sa.Column("first_us", sa.BigInteger(), nullable=False),
        sa.Column("last_us", sa.BigInteger(), nullable=False),
        sa.Column("sample_count", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("channel_id", "hour_us", name=op.f("pk_packed_hours")),
        sqlite_with_rowid=False,
    )
    op.create_index(op.f("ix_packed_hours_hour_us"), "packed_hours", ["hour_us"])
    op.create_index(op.f("ix_packed_hours_block_id"), "packed_hours", ["block_id"])
    if op.get_bind().dialect.name == "postgresql":
        # It is compressed already.
        op.execute("ALTER TABLE sample_blocks ALTER COLUMN data SET STORAGE EXTERNAL")
