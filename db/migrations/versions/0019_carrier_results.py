"""Results of the carriers, by method, in the attitude row."""

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("attitude", sa.Column("carriers", sa.LargeBinary()))


def downgrade() -> None:
    op.drop_column("attitude", "carriers")
