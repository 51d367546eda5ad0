"""State of the release of torques, its commands and its uplink products."""

import sqlalchemy as sa
from alembic import op

from db.schema.columns import needed, spacecraft_key

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "release_state",
        spacecraft_key(is_referencing=False),
        sa.Column("version", sa.BigInteger(), nullable=False),
        *needed(sa.Text(), "holder", "document"),
    )
    op.create_table(
        "release_command",
        spacecraft_key(is_referencing=False),
        sa.Column("counter", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("prepared_us", sa.BigInteger(), nullable=False),
        *needed(sa.Text(), "state", "digest", "document"),
    )
    op.create_index(
        "release_command_prepared", "release_command", ["spacecraft_key", "prepared_us", "counter"], unique=False
    )
    op.create_table(
        "uplink_product",
        spacecraft_key(is_referencing=False),
        sa.Column("form", sa.Text(), primary_key=True),
        sa.Column("counter", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("created_us", sa.BigInteger(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
    )


def downgrade() -> None:
    for name in ("uplink_product", "release_command", "release_state"):
        op.drop_table(name)
