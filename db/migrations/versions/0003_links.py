"""Details beside powers, sequence numbers of sources, links, evidence traces."""

import sqlalchemy as sa
from alembic import op

from db.schema.column_types import Figure
from db.schema.columns import keys, needed, optional, spacecraft_key

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

#: children before parents
_TABLES = ("measurement_detail", "sequence_interval", "link", "trace")
_SEQUENCE_COLUMNS = ("seq_run", "seq_after_us", "seq_start", "seq_last", "rows_missing")

#: what was numbered before this version counts as one closed run without gaps: the next rows start a new one
_CLOSE_RUNS = """
UPDATE source SET seq_run = 1, seq_after_us = newest_epoch_us, rows_missing = 0,
  seq_start = (SELECT m.seq FROM measurement AS m WHERE m.spacecraft_key = source.spacecraft_key
    AND m.epoch_us = source.newest_epoch_us AND m.source_key = source.source_key),
  seq_last = (SELECT m.seq FROM measurement AS m WHERE m.spacecraft_key = source.spacecraft_key
    AND m.epoch_us = source.newest_epoch_us AND m.source_key = source.source_key)
WHERE EXISTS (SELECT 1 FROM measurement AS m WHERE m.spacecraft_key = source.spacecraft_key
    AND m.epoch_us = source.newest_epoch_us AND m.source_key = source.source_key AND m.seq IS NOT NULL)
"""


def upgrade() -> None:
    _sequences()
    op.create_table(
        "measurement_detail",
        spacecraft_key(is_referencing=False),
        sa.Column("epoch_us", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("source_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("figures", sa.LargeBinary(), nullable=False),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "link",
        sa.Column("link_id", sa.Text(), primary_key=True),
        sa.Column("spacecraft_id", sa.Text()),
        sa.Column("reported_at_us", sa.BigInteger(), nullable=False),
        sa.Column("learned_period_s", Figure),
        sa.Column("enabled", sa.Boolean(), nullable=False),
        sa.Column("resets", sa.Integer(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
    )
    _traces()


def downgrade() -> None:
    for name in _TABLES:
        op.drop_table(name)
    for name in _SEQUENCE_COLUMNS:
        op.drop_column("source", name)


def _sequences() -> None:
    for name in _SEQUENCE_COLUMNS:
        op.add_column("source", sa.Column(name, sa.BigInteger()))
    op.execute(_CLOSE_RUNS)
    op.create_table(
        "sequence_interval",
        *keys(sa.Integer(), "spacecraft_key", "source_key"),
        *keys(sa.BigInteger(), "run", "first_seq"),
        *needed(sa.BigInteger(), "last_seq", "after_us"),
        sqlite_with_rowid=False,
    )


def _traces() -> None:
    op.create_table(
        "trace",
        sa.Column("trace_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), primary_key=True),
        sa.Column("spacecraft_key", sa.Integer(), sa.ForeignKey("spacecraft.spacecraft_key"), nullable=False),
        sa.Column("source", sa.Text(), nullable=False),
        sa.Column("epoch_us", sa.BigInteger(), nullable=False),
        sa.Column("sweep", sa.Text(), nullable=False),
        sa.Column("size_bytes", sa.Integer(), nullable=False),
        sa.Column("received_at_us", sa.BigInteger(), nullable=False),
        sa.Column("points", sa.Integer(), nullable=False),
        *optional(Figure, "start_hz", "step_hz", "rbw_hz", "enbw_hz", "sweep_time_s"),
        sa.Column("powers", sa.LargeBinary(), nullable=False),
        sa.UniqueConstraint("spacecraft_key", "source", "epoch_us", "sweep", name="trace_key"),
    )
    op.create_index("trace_epoch", "trace", ["spacecraft_key", "epoch_us", "trace_id"], unique=False)
    op.create_index(
        "trace_size", "trace", ["spacecraft_key", "source", "epoch_us", "trace_id", "size_bytes"], unique=False
    )
