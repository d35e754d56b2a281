"""From which time retention counts its days back: it moves on by small steps only."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "retention_marks",
        sa.Column("clock", sa.String(), nullable=False),
        sa.Column("time_us", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("clock", name=op.f("pk_retention_marks")),
    )
    # What is stored was recorded before anything can go wrong with the clock of this start.
    # One look per channel: a plain maximum would read all samples.
    newest = (
        "SELECT max((SELECT time_us FROM samples WHERE channel_id = channels.id "
        "ORDER BY time_us DESC LIMIT 1)) FROM channels"
    )
    connection = op.get_bind()
    for clock, query in (("process", newest), ("wall", "SELECT max(time_us) FROM audit")):
        time_us = connection.execute(sa.text(query)).scalar()
        if time_us is not None:
            connection.execute(
                sa.text("INSERT INTO retention_marks (clock, time_us) VALUES (:clock, :time_us)"),
                {"clock": clock, "time_us": time_us},
            )
