"""When an asset was removed and when it was added again; a removed one was at its last change."""

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("provisioned_assets", sa.Column("removed_us", sa.BigInteger(), nullable=True))
    op.add_column("provisioned_assets", sa.Column("added_us", sa.BigInteger(), nullable=True))
    op.execute("UPDATE provisioned_assets SET removed_us = changed_us WHERE document IS NULL")
