"""Results of the carriers, by method, in the attitude row."""

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("attitude", sa.Column("carriers", sa.LargeBinary()))


def downgrade() -> None:
    op.drop_column("attitude", "carriers")
