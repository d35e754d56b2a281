"""An alarm of a cause that many assets share names all of them, and so does its journal."""

import sqlalchemy as sa
from alembic import op

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for table in ("alarms", "alarm_journal"):
        op.add_column(table, sa.Column("assets", sa.String(), nullable=True))
