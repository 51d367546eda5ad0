"""Attitude rows say what the operator is advised."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("attitude", sa.Column("advice", sa.Text()))


def downgrade() -> None:
    op.drop_column("attitude", "advice")
