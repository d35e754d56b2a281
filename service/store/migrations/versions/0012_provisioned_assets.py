"""Assets that are not in the configuration file; the table begins empty."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "provisioned_assets",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("document", sa.String(), nullable=True),
        sa.Column("revision", sa.BigInteger(), nullable=False),
        sa.Column("changed_us", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_provisioned_assets")),
    )
    op.create_index(op.f("ix_provisioned_assets_revision"), "provisioned_assets", ["revision"])
