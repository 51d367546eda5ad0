"""What the flexible modes say of a torque command's schedule."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("torque", sa.Column("schedule_check", sa.Text()))


def downgrade() -> None:
    op.drop_column("torque", "schedule_check")
