"""Processes of a server and their leases, one a spacecraft; jobs know whose they are."""

import sqlalchemy as sa
from alembic import op

from db.schema.columns import needed

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "member",
        sa.Column("member_id", sa.Integer(), primary_key=True),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("is_estimator", sa.Boolean(), nullable=False),
        sa.Column("seen_at_us", sa.BigInteger(), nullable=False),
    )
    op.create_table("lease", sa.Column("name", sa.Text(), primary_key=True), *needed(sa.BigInteger, "holder", "term"))
    op.add_column("job", sa.Column("member_id", sa.BigInteger()))


def downgrade() -> None:
    op.drop_column("job", "member_id")
    op.drop_table("lease")
    op.drop_table("member")
