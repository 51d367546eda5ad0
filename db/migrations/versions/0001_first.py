"""First schema: catalogue, journal, measurements, results."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

#: children before parents
_TABLES = (
    "attitude",
    "torque",
    "measurement",
    "journal",
    "operation",
    "source",
    "alignment",
    "calibration",
    "replay",
    "job",
    "ephemeris",
    "carrier_plan",
    "head",
    "spacecraft",
)


class _UntypedDouble(sa.types.UserDefinedType[float]):
    """A double in a SQLite column without affinity; a REAL column would lose the sign of -0.0."""

    cache_ok = True

    def get_col_spec(self, **_: Any) -> str:
        return "DOUBLE_BLOB"


_FIGURE: sa.types.TypeEngine[float] = sa.DOUBLE_PRECISION().with_variant(_UntypedDouble(), "sqlite")


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
        sa.Column("id", sa.Text(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.UniqueConstraint("id"),
    )
    op.create_table(
        "head",
        sa.Column(
            "spacecraft_key",
            sa.Integer(),
            sa.ForeignKey("spacecraft.spacecraft_key"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("newest_number", sa.BigInteger(), nullable=False),
        sa.Column("consumed_number", sa.BigInteger(), nullable=False),
        sa.Column("newest_epoch_us", sa.BigInteger()),
        sa.Column("consumed_epoch_us", sa.BigInteger()),
        sa.Column("result_sequence", sa.BigInteger(), nullable=False),
    )
    op.create_table(
        "carrier_plan",
        sa.Column(
            "spacecraft_key",
            sa.Integer(),
            sa.ForeignKey("spacecraft.spacecraft_key"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("plan_id", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
    )
    op.create_table(
        "ephemeris",
        sa.Column(
            "spacecraft_key",
            sa.Integer(),
            sa.ForeignKey("spacecraft.spacecraft_key"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("ephemeris_id", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("document", sa.Text(), nullable=False),
    )


def _inputs() -> None:
    op.create_table(
        "source",
        sa.Column(
            "spacecraft_key",
            sa.Integer(),
            sa.ForeignKey("spacecraft.spacecraft_key"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("source_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("is_prime", sa.Boolean(), nullable=False),
        sa.Column("newest_epoch_us", sa.BigInteger()),
        sa.Column("row_count", sa.BigInteger(), nullable=False),
        sa.UniqueConstraint("spacecraft_key", "name", name="source_name"),
    )
    op.create_table(
        "measurement",
        sa.Column("spacecraft_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("epoch_us", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("source_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
        sa.Column("plan_id", sa.Integer(), nullable=False),
        sa.Column("seq", sa.BigInteger()),
        sa.Column("received_at_us", sa.BigInteger(), nullable=False),
        sa.Column("is_late", sa.Boolean(), nullable=False),
        sa.Column("feeds", sa.Boolean(), nullable=False),
        sa.Column("powers", sa.LargeBinary(), nullable=False),
        sa.Column("flags", sa.LargeBinary()),
        sqlite_with_rowid=False,
    )
    op.create_index("measurement_number", "measurement", ["spacecraft_key", "number"], unique=True)
    op.create_table(
        "journal",
        sa.Column("spacecraft_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("number", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("key", sa.Text(), nullable=False),
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
        sa.Column(
            "spacecraft_key",
            sa.Integer(),
            sa.ForeignKey("spacecraft.spacecraft_key"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("operation_id", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
    )


def _decisions() -> None:
    op.create_table(
        "calibration",
        sa.Column(
            "spacecraft_key",
            sa.Integer(),
            sa.ForeignKey("spacecraft.spacecraft_key"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("calibration_id", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("method", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("plan_id", sa.Integer(), nullable=False),
        sa.Column("ephemeris_id", sa.Integer(), nullable=False),
        sa.Column("created_at_us", sa.BigInteger(), nullable=False),
        sa.Column("created_by", sa.Text(), nullable=False),
        sa.Column("request", sa.Text(), nullable=False),
        sa.Column("result", sa.Text()),
        sa.Column("error", sa.Text()),
    )
    op.create_table(
        "alignment",
        sa.Column(
            "spacecraft_key",
            sa.Integer(),
            sa.ForeignKey("spacecraft.spacecraft_key"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("alignment_id", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("epoch_us", sa.BigInteger(), nullable=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
    )
    op.create_table(
        "job",
        sa.Column("job_id", sa.Text(), primary_key=True),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("progress", _FIGURE),
        sa.Column("created_at_us", sa.BigInteger(), nullable=False),
        sa.Column("error", sa.Text()),
    )
    op.create_table(
        "replay",
        sa.Column(
            "spacecraft_key",
            sa.Integer(),
            sa.ForeignKey("spacecraft.spacecraft_key"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("replay_id", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("document", sa.Text(), nullable=False),
    )


def _attitude() -> None:
    op.create_table(
        "attitude",
        sa.Column("spacecraft_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("version", sa.Text(), primary_key=True),
        sa.Column("method", sa.Text(), primary_key=True),
        sa.Column("epoch_us", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("number", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("sequence", sa.BigInteger()),
        sa.Column("received_at_us", sa.BigInteger(), nullable=False),
        sa.Column("yaw_deg", _FIGURE),
        sa.Column("roll_deg", _FIGURE),
        sa.Column("pitch_deg", _FIGURE),
        sa.Column("yaw_sigma_deg", _FIGURE),
        sa.Column("roll_sigma_deg", _FIGURE),
        sa.Column("pitch_sigma_deg", _FIGURE),
        sa.Column("has_rates", sa.Boolean(), nullable=False),
        sa.Column("yaw_rate_deg_s", _FIGURE),
        sa.Column("roll_rate_deg_s", _FIGURE),
        sa.Column("pitch_rate_deg_s", _FIGURE),
        sa.Column("status", sa.Text(), nullable=False),
        sa.Column("control_allowed", sa.Boolean(), nullable=False),
        sa.Column("yaw_control_allowed", sa.Boolean(), nullable=False),
        sa.Column("roll_control_allowed", sa.Boolean(), nullable=False),
        sa.Column("pitch_control_allowed", sa.Boolean(), nullable=False),
        sa.Column("inhibitions", sa.Text(), nullable=False),
        sa.Column("carriers_used", sa.Integer(), nullable=False),
        sa.Column("excluded", sa.Text(), nullable=False),
        sa.Column("downlink_fade", sa.Boolean(), nullable=False),
        sa.Column("downlink_fade_db", _FIGURE),
        sa.Column("common_db", _FIGURE),
        sa.Column("residual_rms_db", _FIGURE),
        sa.Column("calibration_id", sa.Integer()),
        sa.Column("alignment_id", sa.Integer()),
        sqlite_with_rowid=False,
    )
    op.create_index("attitude_sequence", "attitude", ["spacecraft_key", "sequence"], unique=True)


def _torque() -> None:
    op.create_table(
        "torque",
        sa.Column("spacecraft_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("version", sa.Text(), primary_key=True),
        sa.Column("epoch_us", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("number", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("sequence", sa.BigInteger()),
        sa.Column("attitude_epoch_us", sa.BigInteger(), nullable=False),
        sa.Column("mode", sa.Text(), nullable=False),
        sa.Column("yaw_n_m", _FIGURE),
        sa.Column("roll_n_m", _FIGURE),
        sa.Column("pitch_n_m", _FIGURE),
        sa.Column("wheels_n_m", sa.Text(), nullable=False),
        sa.Column("saturated", sa.Boolean(), nullable=False),
        sa.Column("command_period_s", _FIGURE),
        sa.Column("valid_until_us", sa.BigInteger(), nullable=False),
        sa.Column("schedule", sa.Text(), nullable=False),
        sa.Column("yaw_impulse_n_m_s", _FIGURE),
        sa.Column("roll_impulse_n_m_s", _FIGURE),
        sa.Column("pitch_impulse_n_m_s", _FIGURE),
        sa.Column("predicted_yaw_change_deg", _FIGURE),
        sa.Column("predicted_roll_change_deg", _FIGURE),
        sa.Column("predicted_pitch_change_deg", _FIGURE),
        sa.Column("predicted_yaw_rate_change_deg_s", _FIGURE),
        sa.Column("predicted_roll_rate_change_deg_s", _FIGURE),
        sa.Column("predicted_pitch_rate_change_deg_s", _FIGURE),
        sa.Column("predicted_wheel_momentum_n_m_s", sa.Text(), nullable=False),
        sa.Column("control_allowed", sa.Boolean(), nullable=False),
        sa.Column("inhibitions", sa.Text(), nullable=False),
        sqlite_with_rowid=False,
    )
    op.create_index("torque_sequence", "torque", ["spacecraft_key", "sequence"], unique=True)
