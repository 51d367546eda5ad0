"""State of the release of torques, its commands and its uplink products."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "release_state",
        sa.Column("spacecraft_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("version", sa.BigInteger(), nullable=False),
        sa.Column("holder", sa.Text(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
    )
    op.create_table(
        "release_command",
        sa.Column("spacecraft_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("counter", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("prepared_us", sa.BigInteger(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("digest", sa.Text(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
    )
    op.create_index(
        "release_command_prepared", "release_command", ["spacecraft_key", "prepared_us", "counter"], unique=False
    )
    op.create_table(
        "uplink_product",
        sa.Column("spacecraft_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("form", sa.Text(), primary_key=True),
        sa.Column("counter", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("created_us", sa.BigInteger(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
    )


def downgrade() -> None:
    for name in ("uplink_product", "release_command", "release_state"):
        op.drop_table(name)
