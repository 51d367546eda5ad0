"""Lag of smoothed rows."""

import sqlalchemy as sa
from alembic import op

from db.schema.column_types import Figure

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column, null in older rows."""
    op.add_column("attitude", sa.Column("lag_s", Figure()))


def downgrade() -> None:
    """Drop it."""
    op.drop_column("attitude", "lag_s")
