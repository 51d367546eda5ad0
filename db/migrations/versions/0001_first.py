"""First schema: catalogue, journal, measurements, results."""

import sqlalchemy as sa
from alembic import op

from db.schema.column_types import Figure
from db.schema.columns import keys, needed, optional, spacecraft_key

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

#: children before parents
_TABLES = (
    *("attitude", "torque", "measurement", "journal", "operation", "source", "alignment", "calibration"),
    *("replay", "job", "ephemeris", "carrier_plan", "head", "spacecraft"),
)


def upgrade() -> None:
    _catalogue()
    _inputs()
    _decisions()
    _attitude()
    _torque()


def downgrade() -> None:
    for table in _TABLES:
        op.drop_table(table)


def _catalogue() -> None:
    op.create_table(
        "spacecraft",
        sa.Column("spacecraft_key", sa.Integer(), primary_key=True),
        *needed(sa.Text(), "id", "document"),
        sa.UniqueConstraint("id"),
    )
    op.create_table(
        "head",
        spacecraft_key(),
        *needed(sa.BigInteger(), "newest_number", "consumed_number"),
        *optional(sa.BigInteger(), "newest_epoch_us", "consumed_epoch_us"),
        sa.Column("result_sequence", sa.BigInteger(), nullable=False),
    )
    op.create_table(
        "carrier_plan",
        spacecraft_key(),
        sa.Column("plan_id", sa.Integer(), primary_key=True, autoincrement=False),
        *needed(sa.Text(), "sha256", "document"),
    )
    op.create_table(
        "ephemeris",
        spacecraft_key(),
        sa.Column("ephemeris_id", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("document", sa.Text(), nullable=False),
    )


def _inputs() -> None:
    op.create_table(
        "source",
        spacecraft_key(),
        sa.Column("source_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("is_prime", sa.Boolean(), nullable=False),
        sa.Column("newest_epoch_us", sa.BigInteger()),
        sa.Column("row_count", sa.BigInteger(), nullable=False),
        sa.UniqueConstraint("spacecraft_key", "name", name="source_name"),
    )
    op.create_table(
        "measurement",
        spacecraft_key(is_referencing=False),
        sa.Column("epoch_us", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("source_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
        sa.Column("plan_id", sa.Integer(), nullable=False),
        sa.Column("seq", sa.BigInteger()),
        sa.Column("received_at_us", sa.BigInteger(), nullable=False),
        *needed(sa.Boolean(), "is_late", "feeds"),
        sa.Column("powers", sa.LargeBinary(), nullable=False),
        sa.Column("flags", sa.LargeBinary()),
        sqlite_with_rowid=False,
    )
    op.create_index("measurement_number", "measurement", ["spacecraft_key", "number"], unique=True)
    op.create_table(
        "journal",
        spacecraft_key(is_referencing=False),
        sa.Column("number", sa.BigInteger(), primary_key=True, autoincrement=False),
        *needed(sa.Text(), "kind", "key"),
        sa.Column("start_us", sa.BigInteger(), nullable=False),
        sa.Column("stop_us", sa.BigInteger()),
        sa.Column("document", sa.Text(), nullable=False),
        sa.UniqueConstraint("spacecraft_key", "kind", "key", name="journal_key"),
        sqlite_with_rowid=False,
    )
    op.create_index(
        "journal_start", "journal", ["spacecraft_key", "kind", "start_us", "number", "stop_us"], unique=False
    )
    op.create_table(
        "operation",
        spacecraft_key(),
        sa.Column("operation_id", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
    )


def _decisions() -> None:
    op.create_table(
        "calibration",
        spacecraft_key(),
        sa.Column("calibration_id", sa.Integer(), primary_key=True, autoincrement=False),
        *needed(sa.Text(), "method", "state"),
        *needed(sa.Integer(), "plan_id", "ephemeris_id"),
        sa.Column("created_at_us", sa.BigInteger(), nullable=False),
        *needed(sa.Text(), "created_by", "request"),
        *optional(sa.Text(), "result", "error"),
    )
    op.create_table(
        "alignment",
        spacecraft_key(),
        sa.Column("alignment_id", sa.Integer(), primary_key=True, autoincrement=False),
        *needed(sa.BigInteger(), "epoch_us", "number"),
        sa.Column("document", sa.Text(), nullable=False),
    )
    op.create_table(
        "job",
        sa.Column("job_id", sa.Text(), primary_key=True),
        *needed(sa.Text(), "kind", "state"),
        sa.Column("progress", Figure),
        sa.Column("created_at_us", sa.BigInteger(), nullable=False),
        sa.Column("error", sa.Text()),
    )
    op.create_table(
        "replay",
        spacecraft_key(),
        sa.Column("replay_id", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("document", sa.Text(), nullable=False),
    )


def _attitude() -> None:
    op.create_table(
        "attitude",
        spacecraft_key(is_referencing=False),
        sa.Column("version", sa.Text(), primary_key=True),
        sa.Column("method", sa.Text(), primary_key=True),
        *keys(sa.BigInteger(), "epoch_us", "number"),
        sa.Column("sequence", sa.BigInteger()),
        sa.Column("received_at_us", sa.BigInteger(), nullable=False),
        *optional(Figure, "yaw_deg", "roll_deg", "pitch_deg", "yaw_sigma_deg", "roll_sigma_deg", "pitch_sigma_deg"),
        sa.Column("has_rates", sa.Boolean(), nullable=False),
        *optional(Figure, "yaw_rate_deg_s", "roll_rate_deg_s", "pitch_rate_deg_s"),
        sa.Column("status", sa.Text(), nullable=False),
        sa.Column("control_allowed", sa.Boolean(), nullable=False),
        *needed(sa.Boolean(), "yaw_control_allowed", "roll_control_allowed", "pitch_control_allowed"),
        sa.Column("inhibitions", sa.Text(), nullable=False),
        sa.Column("carriers_used", sa.Integer(), nullable=False),
        sa.Column("excluded", sa.Text(), nullable=False),
        sa.Column("downlink_fade", sa.Boolean(), nullable=False),
        *optional(Figure, "downlink_fade_db", "common_db", "residual_rms_db"),
        *optional(sa.Integer(), "calibration_id", "alignment_id"),
        sqlite_with_rowid=False,
    )
    op.create_index("attitude_sequence", "attitude", ["spacecraft_key", "sequence"], unique=True)


def _torque() -> None:
    op.create_table(
        "torque",
        spacecraft_key(is_referencing=False),
        sa.Column("version", sa.Text(), primary_key=True),
        *keys(sa.BigInteger(), "epoch_us", "number"),
        sa.Column("sequence", sa.BigInteger()),
        sa.Column("attitude_epoch_us", sa.BigInteger(), nullable=False),
        sa.Column("mode", sa.Text(), nullable=False),
        *optional(Figure, "yaw_n_m", "roll_n_m", "pitch_n_m"),
        sa.Column("wheels_n_m", sa.Text(), nullable=False),
        sa.Column("saturated", sa.Boolean(), nullable=False),
        sa.Column("command_period_s", Figure),
        sa.Column("valid_until_us", sa.BigInteger(), nullable=False),
        sa.Column("schedule", sa.Text(), nullable=False),
        *optional(Figure, "yaw_impulse_n_m_s", "roll_impulse_n_m_s", "pitch_impulse_n_m_s"),
        *optional(Figure, "predicted_yaw_change_deg", "predicted_roll_change_deg", "predicted_pitch_change_deg"),
        *optional(Figure, *(f"predicted_{axis}_rate_change_deg_s" for axis in ("yaw", "roll", "pitch"))),
        sa.Column("predicted_wheel_momentum_n_m_s", sa.Text(), nullable=False),
        sa.Column("control_allowed", sa.Boolean(), nullable=False),
        sa.Column("inhibitions", sa.Text(), nullable=False),
        sqlite_with_rowid=False,
    )
    op.create_index("torque_sequence", "torque", ["spacecraft_key", "sequence"], unique=True)
