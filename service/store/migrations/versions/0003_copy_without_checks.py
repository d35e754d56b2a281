"""PostgreSQL: samples are copied in without a look at the table of channels for each one.

That look cost as much as all the rest. Channels are never removed, and their numbers reach the
samples only through the one function that makes them.
"""

from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # SQLite looks them up at a tenth of the price, and would have to write the table again.
    if op.get_bind().dialect.name == "postgresql":
        op.drop_constraint("fk_samples_channel_id_channels", "samples", type_="foreignkey")
