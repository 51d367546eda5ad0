"""Closed days of measurements in one row each; what retention has taken away."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "measurement_segment",
        sa.Column("segment_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), primary_key=True),
        sa.Column("spacecraft_key", sa.Integer(), sa.ForeignKey("spacecraft.spacecraft_key"), nullable=False),
        sa.Column("source_key", sa.Integer(), nullable=False),
        sa.Column("plan_id", sa.Integer(), nullable=False),
        sa.Column("day", sa.Integer(), nullable=False),
        sa.Column("row_count", sa.Integer(), nullable=False),
        sa.Column("feeding_count", sa.Integer(), nullable=False),
        sa.Column("first_epoch_us", sa.BigInteger(), nullable=False),
        sa.Column("last_epoch_us", sa.BigInteger(), nullable=False),
        sa.Column("first_number", sa.BigInteger(), nullable=False),
        sa.Column("last_number", sa.BigInteger(), nullable=False),
        sa.Column("codec", sa.Integer(), nullable=False),
        sa.Column("crc32", sa.BigInteger(), nullable=False),
        sa.Column("columns", sa.LargeBinary(), nullable=False),
        sa.Column("powers", sa.LargeBinary(), nullable=False),
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
        sa.Column("kept_from_us", sa.BigInteger(), nullable=False),
        sa.Column("rows_dropped", sa.BigInteger(), nullable=False),
    )


def downgrade() -> None:
    # an older version finds rows only in the table of rows
    from db.migrations.unsealing import unseal_everything

    unseal_everything(op.get_bind())
    op.drop_table("retention_mark")
    op.drop_table("measurement_segment")
