"""Checkpoints: the state of a live chain, from which a restart goes on."""

import sqlalchemy as sa
from alembic import op

from db.schema.columns import keys, needed, spacecraft_key

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "checkpoint",
        spacecraft_key(is_referencing=False),
        *keys(sa.BigInteger, "number"),
        *needed(sa.BigInteger, "epoch_us"),
        *needed(sa.Text, "fingerprint"),
        *needed(sa.LargeBinary, "content"),
        sa.Column("checksum", sa.LargeBinary()),
    )


def downgrade() -> None:
    op.drop_table("checkpoint")
