"""Summaries of closed days, and up to where every row has its results."""

import sqlalchemy as sa
from alembic import op

from db.schema.columns import keys, needed, optional, spacecraft_key

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make the tables; the service fills them while it runs."""
    number = sa.BigInteger().with_variant(sa.Integer, "sqlite")
    of_segment = sa.ForeignKey("measurement_segment.segment_id", ondelete="CASCADE")
    op.create_table(
        "power_summary",
        sa.Column("segment_id", number, of_segment, primary_key=True),
        *needed(sa.LargeBinary, "day", "hours"),
        *optional(sa.LargeBinary, "minute_frames"),
        *needed(sa.LargeBinary, "row_frames"),
        *optional(sa.LargeBinary, "checksum"),
    )
    op.create_table(
        "attitude_summary",
        sa.Column("summary_id", number, primary_key=True),
        sa.Column("spacecraft_key", sa.Integer, sa.ForeignKey("spacecraft.spacecraft_key"), nullable=False),
        sa.Column("method", sa.Text, nullable=False),
        sa.Column("start_us", sa.BigInteger, nullable=False),
        *optional(sa.LargeBinary, "day", "hours", "minute_frames", "row_frames", "checksum"),
        sa.UniqueConstraint("spacecraft_key", "method", "start_us", name="attitude_summary_day"),
    )
    op.create_table(
        "complete_mark",
        spacecraft_key(is_referencing=False),
        *keys(sa.Text, "methods"),
        sa.Column("alignment_id", sa.Integer, nullable=False),
        sa.Column("number", sa.BigInteger, nullable=False),
    )


def downgrade() -> None:
    """Drop them; rows have all that they say."""
    for name in ("complete_mark", "attitude_summary", "power_summary"):
        op.drop_table(name)
