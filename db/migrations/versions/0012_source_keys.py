"""Sources know the key that their first row came with: a key makes a bounded number of them."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("source", sa.Column("created_by", sa.Text()))


def downgrade() -> None:
    op.drop_column("source", "created_by")
