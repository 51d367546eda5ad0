"""Rows get a checksum; rows that are there already get theirs in the background, and only their tables are noted."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None

_TABLES = ("measurement", "journal", "attitude", "torque", "trace", "alarm_change", "note", "uplink_product")


def upgrade() -> None:
    op.create_table("checksum_backlog", sa.Column("table_name", sa.Text(), primary_key=True))
    for table in _TABLES:
        op.add_column(table, sa.Column("checksum", sa.LargeBinary()))
        op.execute(f"INSERT INTO checksum_backlog SELECT '{table}' WHERE EXISTS (SELECT 1 FROM {table})")  # noqa: S608


def downgrade() -> None:
    for table in _TABLES:
        op.drop_column(table, "checksum")
    op.drop_table("checksum_backlog")
