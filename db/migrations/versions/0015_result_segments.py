"""Closed days of results in one row each."""

import sqlalchemy as sa
from alembic import op

from db.schema.columns import needed, optional

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "result_segment",
        sa.Column("segment_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), primary_key=True),
        sa.Column("spacecraft_key", sa.Integer(), sa.ForeignKey("spacecraft.spacecraft_key"), nullable=False),
        *needed(sa.Text(), "series", "version", "method"),
        *needed(sa.Integer(), "row_count", "codec"),
        *needed(sa.BigInteger(), "first_epoch_us", "last_epoch_us", "last_number"),
        *optional(sa.BigInteger(), "first_sequence", "last_sequence"),
        *needed(sa.LargeBinary(), "content"),
        sa.Column("checksum", sa.LargeBinary()),
        sa.UniqueConstraint(
            "spacecraft_key", "series", "version", "method", "first_epoch_us", name="result_segment_start"
        ),
    )
    op.create_index(
        "result_segment_sequence",
        "result_segment",
        ["spacecraft_key", "last_sequence", "first_sequence"],
        unique=False,
    )


def downgrade() -> None:
    # an older version finds rows only in the tables of rows
    from db.migrations.unsealing import unseal_results

    unseal_results(op.get_bind())
    op.drop_table("result_segment")
