"""Lines of the audit trail may go when they are older than a year, and never change."""

from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None

_YEAR_S = 365 * 86_400
_REFUSED = "the audit trail only grows"


def upgrade() -> None:
    if op.get_bind().dialect.name == "postgresql":
        op.execute("DROP TRIGGER audit_only_grows ON audit")
        op.execute(
            "CREATE TRIGGER audit_only_grows BEFORE UPDATE OR TRUNCATE ON audit "
            "FOR EACH STATEMENT EXECUTE FUNCTION audit_only_grows()"
        )
        op.execute(
            "CREATE TRIGGER audit_keeps_a_year BEFORE DELETE ON audit FOR EACH ROW "
            f"WHEN (OLD.time_us > (extract(epoch FROM now()) - {_YEAR_S}) * 1000000) "
            "EXECUTE FUNCTION audit_only_grows()"
        )
        return
    op.execute("DROP TRIGGER audit_no_delete")
    op.execute(
        "CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit "
        f"WHEN OLD.time_us > (CAST(strftime('%s', 'now') AS INTEGER) - {_YEAR_S}) * 1000000 "
        f"BEGIN SELECT RAISE(ABORT, '{_REFUSED}'); END"
    )
