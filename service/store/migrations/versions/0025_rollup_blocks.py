"""Minutes and seconds in compressed blocks; the table begins empty, and the rows stay.

A service moves the rows of an earlier version little by little, as it packs samples.
"""

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0024"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "rollup_blocks",
        sa.Column("channel_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("resolution_s", sa.SmallInteger(), autoincrement=False, nullable=False),
        sa.Column("begin_us", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("codec", sa.SmallInteger(), nullable=False),
        sa.Column("crc", sa.BigInteger(), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint(
            "channel_id", "resolution_s", "begin_us", name=op.f("pk_rollup_blocks")
        ),
        sqlite_with_rowid=False,
    )
    if op.get_bind().dialect.name == "postgresql":
        # It is compressed already.
        op.execute("ALTER TABLE rollup_blocks ALTER COLUMN data SET STORAGE EXTERNAL")
