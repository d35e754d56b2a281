"""What each machine of a family teaches its sisters; the table begins empty."""

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "sister_records",
        sa.Column("asset", sa.String(), nullable=False),
        sa.Column("family", sa.String(), nullable=False),
        sa.Column("machine", sa.JSON(), nullable=False),
        sa.Column("until_us", sa.BigInteger(), nullable=False),
        sa.Column("minutes", sa.BigInteger(), nullable=False),
        sa.Column("load_n_max", sa.Double(), nullable=False),
        sa.Column("speed_rpm_max", sa.Double(), nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("asset", name=op.f("pk_sister_records")),
    )
    op.create_index(op.f("ix_sister_records_family"), "sister_records", ["family"])
