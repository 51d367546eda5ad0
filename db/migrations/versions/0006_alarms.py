"""Alarms, what happened to them, their limits and memory, and the shift log."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

_TABLES = ("alarm", "alarm_change", "alarm_memory", "alarm_limits", "note")


def upgrade() -> None:
    op.create_table(
        "alarm",
        sa.Column("alarm_id", _number(), primary_key=True),
        sa.Column("spacecraft_id", sa.Text()),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("is_open", sa.Boolean(), nullable=False),
        sa.Column("raised_at_us", sa.BigInteger(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
    )
    op.create_index("alarm_raised", "alarm", ["spacecraft_id", "raised_at_us", "alarm_id"], unique=False)
    op.create_index("alarm_open", "alarm", ["is_open", "spacecraft_id"], unique=False)
    op.create_table(
        "alarm_change",
        sa.Column("sequence", _number(), primary_key=True),
        sa.Column("alarm_id", sa.BigInteger(), nullable=False),
        sa.Column("spacecraft_id", sa.Text()),
        sa.Column("document", sa.Text(), nullable=False),
    )
    op.create_index("alarm_change_alarm", "alarm_change", ["alarm_id", "sequence"], unique=False)
    op.create_index("alarm_change_spacecraft", "alarm_change", ["spacecraft_id", "sequence"], unique=False)
    op.create_table(
        "alarm_memory",
        sa.Column("spacecraft_id", sa.Text(), primary_key=True),
        sa.Column("document", sa.Text(), nullable=False),
    )
    op.create_table(
        "alarm_limits",
        sa.Column("spacecraft_id", sa.Text(), primary_key=True),
        sa.Column("version", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("document", sa.Text(), nullable=False),
    )
    op.create_table(
        "note",
        sa.Column("note_id", _number(), primary_key=True),
        sa.Column("spacecraft_id", sa.Text()),
        sa.Column("epoch_us", sa.BigInteger(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
    )
    op.create_index("note_epoch", "note", ["epoch_us", "note_id"], unique=False)


def downgrade() -> None:
    for name in _TABLES:
        op.drop_table(name)


def _number() -> sa.types.TypeEngine[int]:
    """Return the type of a number that counts by itself."""
    return sa.BigInteger().with_variant(sa.Integer(), "sqlite")
