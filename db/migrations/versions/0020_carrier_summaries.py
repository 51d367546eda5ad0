"""Summaries of the results of the carriers."""

import sqlalchemy as sa
from alembic import op

from db.schema.columns import needed, optional

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make the table; summaries, in smaller bytes and with the carriers, are made again while the service runs."""
    number = sa.BigInteger().with_variant(sa.Integer, "sqlite")
    op.create_table(
        "carrier_summary",
        sa.Column("carrier_summary_id", number, primary_key=True),
        sa.Column(
            "summary_id", number, sa.ForeignKey("attitude_summary.summary_id", ondelete="CASCADE"), nullable=False
        ),
        sa.Column("plan_id", sa.Integer, nullable=False),
        *needed(sa.LargeBinary, "day", "hours"),
        *optional(sa.LargeBinary, "minute_frames", "checksum"),
        sa.UniqueConstraint("summary_id", "plan_id", name="carrier_summary_plan"),
    )
    _forget_summaries()


def downgrade() -> None:
    """Drop it; an older version cannot read the summaries and makes them again, from rows that have all they say."""
    op.drop_table("carrier_summary")
    _forget_summaries()


def _forget_summaries() -> None:
    for name in ("attitude_summary", "power_summary"):
        op.execute(f"DELETE FROM {name}")  # noqa: S608 - names of ours
