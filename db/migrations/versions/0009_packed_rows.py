"""Rows tell how long after its epoch each was received, which takes half the bytes; new ones have packed powers."""

from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.execute("ALTER TABLE measurement RENAME COLUMN received_at_us TO delay_us")
    op.execute("UPDATE measurement SET delay_us = delay_us - epoch_us")


def downgrade() -> None:
    # an older version knows only powers and flags of four bytes a carrier
    from db.migrations.unsealing import unpack_everything

    unpack_everything(op.get_bind())
    op.execute("UPDATE measurement SET delay_us = delay_us + epoch_us")
    op.execute("ALTER TABLE measurement RENAME COLUMN delay_us TO received_at_us")
