"""Summaries of the states of rows."""

import sqlalchemy as sa
from alembic import op

from db.schema.columns import needed

revision = "0021"
down_revision = "0020"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make the table; summaries of attitude are made again, with the states, while the service runs."""
    number = sa.BigInteger().with_variant(sa.Integer, "sqlite")
    op.create_table(
        "state_summary",
        sa.Column(
            "summary_id",
            number,
            sa.ForeignKey("attitude_summary.summary_id", ondelete="CASCADE"),
            primary_key=True,
            autoincrement=False,
        ),
        *needed(sa.BigInteger, "first_us", "last_us", "period_us"),
        *needed(sa.LargeBinary, "content"),
        sa.Column("checksum", sa.LargeBinary),
    )
    op.execute("DELETE FROM carrier_summary")
    op.execute("DELETE FROM attitude_summary")


def downgrade() -> None:
    """Drop it; what else is summarised stays."""
    op.drop_table("state_summary")
