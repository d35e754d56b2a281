"""When each sample was received; unknown for those stored before.

A column that may be empty is added without a rewrite of the table, also of its partitions.
"""

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("samples", sa.Column("received_us", sa.BigInteger(), nullable=True))
