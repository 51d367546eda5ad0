"""Tables: one schema for SQLite and PostgreSQL.

Epochs are BIGINT microseconds UTC, the powers of a row are one BLOB (see
db.encoding.power_codec), records that no query looks into are JSON documents.
Tables that grow with every measurement carry no foreign keys: their rows are written
under the lock of the spacecraft's head by code that has just read the parents.
"""

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    Table,
    Text,
    UniqueConstraint,
)

from db.schema.column_types import Figure
from db.schema.columns import keys, needed, optional, spacecraft_key
from db.schema.record_columns import record_columns
from db.schema.row_checksum import checksum_column
from service.records.levels.attitude import AttitudeRow
from service.records.levels.command import TorqueCommand

metadata = MetaData()


spacecraft = Table(
    "spacecraft",
    metadata,
    Column("spacecraft_key", Integer, primary_key=True),
    Column("id", Text, nullable=False, unique=True),
    Column("document", Text, nullable=False),
)

#: where the journal and its consumer stand; locking this row orders all writers of a spacecraft
head = Table(
    "head",
    metadata,
    spacecraft_key(),
    *needed(BigInteger, "newest_number", "consumed_number"),
    *optional(BigInteger, "newest_epoch_us", "consumed_epoch_us"),
    Column("result_sequence", BigInteger, nullable=False),
)

carrier_plan = Table(
    "carrier_plan",
    metadata,
    spacecraft_key(),
    Column("plan_id", Integer, primary_key=True, autoincrement=False),
    *needed(Text, "sha256", "document"),
)

ephemeris = Table(
    "ephemeris",
    metadata,
    spacecraft_key(),
    Column("ephemeris_id", Integer, primary_key=True, autoincrement=False),
    Column("document", Text, nullable=False),
)

source = Table(
    "source",
    metadata,
    spacecraft_key(),
    Column("source_key", Integer, primary_key=True, autoincrement=False),
    Column("name", Text, nullable=False),
    Column("is_prime", Boolean, nullable=False),
    Column("newest_epoch_us", BigInteger),
    Column("row_count", BigInteger, nullable=False),
    UniqueConstraint("spacecraft_key", "name", name="source_name"),
    # sequence numbers, see db.measurements.sequence_numbers; null until the source numbers its rows
    *optional(BigInteger, "seq_run", "seq_after_us", "seq_start", "seq_last", "rows_missing"),
    #: id of the key that its first row came with; null where that was not asked
    Column("created_by", Text),
)

#: numbers held below the newest interval of a source, which stands with the source itself
sequence_interval = Table(
    "sequence_interval",
    metadata,
    spacecraft_key(is_referencing=False),
    Column("source_key", Integer, primary_key=True, autoincrement=False),
    *keys(BigInteger, "run", "first_seq"),
    *needed(BigInteger, "last_seq", "after_us"),
    sqlite_with_rowid=False,
)

measurement = Table(
    "measurement",
    metadata,
    spacecraft_key(is_referencing=False),
    Column("epoch_us", BigInteger, primary_key=True, autoincrement=False),
    Column("source_key", Integer, primary_key=True, autoincrement=False),
    Column("number", BigInteger, nullable=False),
    Column("plan_id", Integer, nullable=False),
    Column("seq", BigInteger),
    # from the epoch to the receipt, microseconds
    Column("delay_us", BigInteger, nullable=False),
    *needed(Boolean, "is_late", "feeds"),
    # both as db.encoding.power_codec lays them out
    Column("powers", LargeBinary, nullable=False),
    Column("flags", LargeBinary),
    # of the row and of its details; see db.schema.row_checksum
    Column("checksum", LargeBinary),
    Index("measurement_number", "spacecraft_key", "number", unique=True),
    sqlite_with_rowid=False,
)

#: what front ends state beside powers: a table of its own, so that rows without it cost not one byte
measurement_detail = Table(
    "measurement_detail",
    metadata,
    spacecraft_key(is_referencing=False),
    Column("epoch_us", BigInteger, primary_key=True, autoincrement=False),
    Column("source_key", Integer, primary_key=True, autoincrement=False),
    Column("figures", LargeBinary, nullable=False),
    sqlite_with_rowid=False,
)

#: rows of closed days, many in one (db.encoding.segment_codec); the blobs stand last, so that other columns read fast
measurement_segment = Table(
    "measurement_segment",
    metadata,
    Column("segment_id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("spacecraft_key", Integer, ForeignKey("spacecraft.spacecraft_key"), nullable=False),
    *needed(Integer, "source_key", "plan_id"),
    # whole days since 1970
    *needed(Integer, "day", "row_count", "feeding_count"),
    *needed(BigInteger, "first_epoch_us", "last_epoch_us", "first_number", "last_number"),
    Column("codec", Integer, nullable=False),
    # of everything else in the row but its id
    Column("crc32", BigInteger, nullable=False),
    *needed(LargeBinary, "columns", "powers"),
    Column("extras", LargeBinary),
    # a source has one row an epoch, so no two of its segments begin together
    UniqueConstraint("spacecraft_key", "first_epoch_us", "source_key", name="measurement_segment_start"),
    # who follows the newest numbers finds at once that none of them is sealed
    Index("measurement_segment_number", "spacecraft_key", "last_number", "first_number"),
)

#: of the sealed rows of a segment (db.encoding.summary_codec); goes with it
power_summary = Table(
    "power_summary",
    metadata,
    Column(
        "segment_id",
        BigInteger().with_variant(Integer, "sqlite"),
        ForeignKey(measurement_segment.c.segment_id, ondelete="CASCADE"),
        primary_key=True,
    ),
    *needed(LargeBinary, "day", "hours"),
    Column("minute_frames", LargeBinary),
    Column("row_frames", LargeBinary, nullable=False),
    checksum_column(),
)

#: what retention has taken away of a series: nothing older than the mark is taken in again
retention_mark = Table(
    "retention_mark",
    metadata,
    spacecraft_key(),
    Column("series", Text, primary_key=True),
    *needed(BigInteger, "kept_from_us", "rows_dropped"),
)

journal = Table(
    "journal",
    metadata,
    spacecraft_key(is_referencing=False),
    Column("number", BigInteger, primary_key=True, autoincrement=False),
    *needed(Text, "kind", "key"),
    Column("start_us", BigInteger, nullable=False),
    Column("stop_us", BigInteger),
    Column("document", Text, nullable=False),
    checksum_column(),
    UniqueConstraint("spacecraft_key", "kind", "key", name="journal_key"),
    Index("journal_start", "spacecraft_key", "kind", "start_us", "number", "stop_us"),
    sqlite_with_rowid=False,
)

#: the newest revision of each operation
operation = Table(
    "operation",
    metadata,
    spacecraft_key(),
    Column("operation_id", Integer, primary_key=True, autoincrement=False),
    Column("revision", Integer, nullable=False),
    Column("number", BigInteger, nullable=False),
)

calibration = Table(
    "calibration",
    metadata,
    spacecraft_key(),
    Column("calibration_id", Integer, primary_key=True, autoincrement=False),
    *needed(Text, "method", "state"),
    *needed(Integer, "plan_id", "ephemeris_id"),
    Column("created_at_us", BigInteger, nullable=False),
    *needed(Text, "created_by", "request"),
    *optional(Text, "result", "error"),
)

alignment = Table(
    "alignment",
    metadata,
    spacecraft_key(),
    Column("alignment_id", Integer, primary_key=True, autoincrement=False),
    *needed(BigInteger, "epoch_us", "number"),
    Column("document", Text, nullable=False),
)

attitude = Table(
    "attitude",
    metadata,
    spacecraft_key(is_referencing=False),
    Column("version", Text, primary_key=True),
    Column("method", Text, primary_key=True),
    *keys(BigInteger, "epoch_us", "number"),
    Column("sequence", BigInteger),
    *record_columns(AttitudeRow, without=("method", "epoch_us", "number")),
    # see db.encoding.carrier_codec
    Column("carriers", LargeBinary),
    checksum_column(),
    Index("attitude_sequence", "spacecraft_key", "sequence", unique=True),
    sqlite_with_rowid=False,
)

torque = Table(
    "torque",
    metadata,
    spacecraft_key(is_referencing=False),
    Column("version", Text, primary_key=True),
    *keys(BigInteger, "epoch_us", "number"),
    Column("sequence", BigInteger),
    *record_columns(TorqueCommand, without=("epoch_us", "number")),
    checksum_column(),
    Index("torque_sequence", "spacecraft_key", "sequence", unique=True),
    sqlite_with_rowid=False,
)

#: rows of results of closed days, see db.results.result_segments
result_segment = Table(
    "result_segment",
    metadata,
    Column("segment_id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("spacecraft_key", Integer, ForeignKey("spacecraft.spacecraft_key"), nullable=False),
    # name of the table of rows; method is empty where it has none
    *needed(Text, "series", "version", "method"),
    *needed(Integer, "row_count", "codec"),
    # all rows of an epoch are in one segment
    *needed(BigInteger, "first_epoch_us", "last_epoch_us", "last_number"),
    *optional(BigInteger, "first_sequence", "last_sequence"),
    Column("content", LargeBinary, nullable=False),
    checksum_column(),
    UniqueConstraint("spacecraft_key", "series", "version", "method", "first_epoch_us", name="result_segment_start"),
    Index("result_segment_sequence", "spacecraft_key", "last_sequence", "first_sequence"),
)

#: of the live rows of a method on one day; without bytes while it is being made
attitude_summary = Table(
    "attitude_summary",
    metadata,
    Column("summary_id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("spacecraft_key", Integer, ForeignKey("spacecraft.spacecraft_key"), nullable=False),
    # "torque" for the commands of all methods
    Column("method", Text, nullable=False),
    Column("start_us", BigInteger, nullable=False),
    *optional(LargeBinary, "day", "hours", "minute_frames", "row_frames"),
    checksum_column(),
    UniqueConstraint("spacecraft_key", "method", "start_us", name="attitude_summary_day"),
)

#: of the results of the carriers of one plan on the day of a summary of attitude; goes with it
carrier_summary = Table(
    "carrier_summary",
    metadata,
    Column("carrier_summary_id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("summary_id", ForeignKey(attitude_summary.c.summary_id, ondelete="CASCADE"), nullable=False),
    Column("plan_id", Integer, nullable=False),
    *needed(LargeBinary, "day", "hours"),
    Column("minute_frames", LargeBinary),
    checksum_column(),
    UniqueConstraint("summary_id", "plan_id", name="carrier_summary_plan"),
)

#: runs of states and gaps on the day of a summary of attitude (db.results.state_summaries); goes with it
state_summary = Table(
    "state_summary",
    metadata,
    Column(
        "summary_id",
        BigInteger().with_variant(Integer, "sqlite"),
        ForeignKey(attitude_summary.c.summary_id, ondelete="CASCADE"),
        primary_key=True,
    ),
    *needed(BigInteger, "first_us", "last_us", "period_us"),
    Column("content", LargeBinary, nullable=False),
    checksum_column(),
)

#: up to which journal number every row after an alignment has results of some methods
complete_mark = Table(
    "complete_mark",
    metadata,
    spacecraft_key(is_referencing=False),
    *keys(Text, "methods"),
    Column("alignment_id", Integer, nullable=False),
    Column("number", BigInteger, nullable=False),
)

checkpoint = Table(
    "checkpoint",
    metadata,
    spacecraft_key(is_referencing=False),
    *keys(BigInteger, "number"),
    *needed(BigInteger, "epoch_us"),
    *needed(Text, "fingerprint"),
    *needed(LargeBinary, "content"),
    checksum_column(),
)

job = Table(
    "job",
    metadata,
    Column("job_id", Text, primary_key=True),
    *needed(Text, "kind", "state"),
    Column("progress", Figure),
    Column("created_at_us", BigInteger, nullable=False),
    Column("error", Text),
    #: process on a server that runs it
    Column("member_id", BigInteger),
)

replay = Table(
    "replay",
    metadata,
    spacecraft_key(),
    Column("replay_id", Integer, primary_key=True, autoincrement=False),
    Column("document", Text, nullable=False),
    Column("job_id", Text),
    # what it wrote, whatever retention has taken since
    *optional(BigInteger, "attitude_rows", "torque_rows"),
    Column("is_deleted", Boolean),
)

#: state from which a replay that was interrupted goes on
replay_checkpoint = Table(
    "replay_checkpoint",
    metadata,
    spacecraft_key(is_referencing=False),
    *keys(Integer, "replay_id"),
    *needed(BigInteger, "number", "epoch_us"),
    *needed(Text, "fingerprint"),
    *needed(LargeBinary, "content"),
    checksum_column(),
)

#: what front ends report of themselves, and what operators want of them
link = Table(
    "link",
    metadata,
    Column("link_id", Text, primary_key=True),
    Column("spacecraft_id", Text),
    Column("reported_at_us", BigInteger, nullable=False),
    Column("learned_period_s", Figure),
    Column("enabled", Boolean, nullable=False),
    Column("resets", Integer, nullable=False),
    Column("document", Text, nullable=False),
)

#: a ring of sweeps a source; the blob stands last, so that a look at the rest does not read it
trace = Table(
    "trace",
    metadata,
    Column("trace_id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("spacecraft_key", Integer, ForeignKey("spacecraft.spacecraft_key"), nullable=False),
    Column("source", Text, nullable=False),
    Column("epoch_us", BigInteger, nullable=False),
    Column("sweep", Text, nullable=False),
    Column("size_bytes", Integer, nullable=False),
    Column("received_at_us", BigInteger, nullable=False),
    Column("points", Integer, nullable=False),
    *optional(Figure, "start_hz", "step_hz", "rbw_hz", "enbw_hz", "sweep_time_s"),
    Column("powers", LargeBinary, nullable=False),
    checksum_column(),
    UniqueConstraint("spacecraft_key", "source", "epoch_us", "sweep", name="trace_key"),
    Index("trace_epoch", "spacecraft_key", "epoch_us", "trace_id"),
    Index("trace_size", "spacecraft_key", "source", "epoch_us", "trace_id", "size_bytes"),
)
