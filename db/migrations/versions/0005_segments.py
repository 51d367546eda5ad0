"""Closed days of measurements in one row each; what retention has taken away."""

import sqlalchemy as sa
from alembic import op

from db.schema.columns import needed

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "measurement_segment",
        sa.Column("segment_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), primary_key=True),
        sa.Column("spacecraft_key", sa.Integer(), sa.ForeignKey("spacecraft.spacecraft_key"), nullable=False),
        *needed(sa.Integer(), "source_key", "plan_id", "day", "row_count", "feeding_count"),
        *needed(sa.BigInteger(), "first_epoch_us", "last_epoch_us", "first_number", "last_number"),
        sa.Column("codec", sa.Integer(), nullable=False),
        sa.Column("crc32", sa.BigInteger(), nullable=False),
        *needed(sa.LargeBinary(), "columns", "powers"),
        sa.Column("extras", sa.LargeBinary()),
        sa.UniqueConstraint("spacecraft_key", "first_epoch_us", "source_key", name="measurement_segment_start"),
    )
    op.create_index(
        "measurement_segment_number",
        "measurement_segment",
        ["spacecraft_key", "last_number", "first_number"],
        unique=False,
    )
    op.create_table(
        "retention_mark",
        sa.Column("spacecraft_key", sa.Integer(), sa.ForeignKey("spacecraft.spacecraft_key"), primary_key=True),
        sa.Column("series", sa.Text(), primary_key=True),
        *needed(sa.BigInteger(), "kept_from_us", "rows_dropped"),
    )


def downgrade() -> None:
    # an older version finds rows only in the table of rows
    from db.migrations.unsealing import unseal_everything

    unseal_everything(op.get_bind())
    op.drop_table("retention_mark")
    op.drop_table("measurement_segment")
