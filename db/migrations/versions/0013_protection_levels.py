"""Attitude rows have protection levels."""

import sqlalchemy as sa
from alembic import op

from db.schema.column_types import Figure

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None

_LEVELS = ("yaw_protection_deg", "roll_protection_deg", "pitch_protection_deg")


def upgrade() -> None:
    for name in _LEVELS:
        op.add_column("attitude", sa.Column(name, Figure()))


def downgrade() -> None:
    for name in reversed(_LEVELS):
        op.drop_column("attitude", name)
