"""Tables: one schema for SQLite and PostgreSQL; the layout of an archive, and the refusal of another one.

Until release 1.0 an archive is not carried over to another layout: a change of a table, or of what the bytes in its
columns mean, raises `LAYOUT`.
"""

import secrets

from sqlalchemy import (
    DDL,
    BigInteger,
    Boolean,
    Column,
    ColumnElement,
    Connection,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    Table,
    Text,
    UniqueConstraint,
    event,
    inspect,
    literal_column,
    select,
    text,
)

from db.columns import (
    Figure,
    checksum_column,
    keys,
    needed,
    optional,
    record_columns,
    spacecraft_key,
)
from service.records.levels.attitude import AttitudeRow, TorqueCommand

metadata = MetaData()


#: digest: see db.encoding.record_codec, here and in the other tables of documents
spacecraft = Table(
    "spacecraft",
    metadata,
    Column("spacecraft_key", Integer, primary_key=True),
    Column("id", Text, nullable=False, unique=True),
    *needed(Text, "document", "digest"),
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
    *keys(Integer, "plan_id"),
    *needed(Text, "sha256", "document", "digest"),
)

ephemeris = Table(
    "ephemeris",
    metadata,
    spacecraft_key(),
    *keys(Integer, "ephemeris_id"),
    *needed(Text, "document", "digest"),
)

source = Table(
    "source",
    metadata,
    spacecraft_key(),
    *keys(Integer, "source_key"),
    Column("name", Text, nullable=False),
    Column("is_prime", Boolean, nullable=False),
    Column("newest_epoch_us", BigInteger),
    Column("row_count", BigInteger, nullable=False),
    UniqueConstraint("spacecraft_key", "name", name="source_name"),
    # sequence numbers, see db.measurements.ingest; null until the source numbers its rows
    *optional(BigInteger, "seq_run", "seq_after_us", "seq_start", "seq_last", "rows_missing"),
    #: id of the key that its first row came with; null where that was not asked
    Column("created_by", Text),
    # its station, and the key of its newest rows
    *optional(Text, "station", "key_id"),
)

#: from which journal number on rows of a source came with a key, of a station or of a person (null)
source_key_run = Table(
    "source_key_run",
    metadata,
    spacecraft_key(is_referencing=False),
    *keys(BigInteger, "first_number"),
    Column("source_key", Integer, nullable=False),
    Column("key_id", Text, nullable=False),
    Column("station", Text),
    checksum_column(),
    sqlite_with_rowid=False,
)

#: numbers held below the newest interval of a source, which stands with the source itself
sequence_interval = Table(
    "sequence_interval",
    metadata,
    spacecraft_key(is_referencing=False),
    *keys(Integer, "source_key"),
    *keys(BigInteger, "run", "first_seq"),
    *needed(BigInteger, "last_seq", "after_us"),
    sqlite_with_rowid=False,
)

measurement = Table(
    "measurement",
    metadata,
    spacecraft_key(is_referencing=False),
    Column("epoch_us", BigInteger, primary_key=True, autoincrement=False),
    *keys(Integer, "source_key"),
    Column("number", BigInteger, nullable=False),
    Column("plan_id", Integer, nullable=False),
    Column("seq", BigInteger),
    # from the epoch to the receipt, microseconds
    Column("delay_us", BigInteger, nullable=False),
    *needed(Boolean, "is_late", "feeds"),
    # see db.encoding.measurement_rows
    Column("powers", LargeBinary, nullable=False),
    *optional(LargeBinary, "flags", "figures"),
    checksum_column(),
    Index("measurement_number", "spacecraft_key", "number", unique=True),
    sqlite_with_rowid=False,
)

#: rows of closed days, many in one (db.encoding.segments); the blob stands last, so that other columns read fast
segment = Table(
    "segment",
    metadata,
    Column("segment_id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("spacecraft_key", Integer, ForeignKey("spacecraft.spacecraft_key"), nullable=False),
    # name of the table of rows; version and method of results, source and plan of measurements, empty or 0 elsewhere
    *needed(Text, "series", "version", "method"),
    *needed(Integer, "source_key", "plan_id"),
    # whole days since 1970; rows that feed the estimator, of measurements
    *needed(Integer, "day", "row_count", "feeding_count"),
    # all rows of an epoch are in one segment
    *needed(BigInteger, "first_epoch_us", "last_epoch_us", "first_number", "last_number"),
    *optional(BigInteger, "first_sequence", "last_sequence"),
    # Parquet, see db.encoding.column_blob
    Column("content", LargeBinary, nullable=False),
    checksum_column(),
    # a source has one row an epoch, so no two of its segments begin together
    UniqueConstraint(
        "spacecraft_key", "series", "version", "method", "first_epoch_us", "source_key", name="segment_start"
    ),
    # who follows the newest numbers finds at once that none of them is sealed
    Index("segment_number", "spacecraft_key", "series", "last_number", "first_number"),
    Index("segment_sequence", "spacecraft_key", "last_sequence", "first_sequence"),
)

#: of the rows of a segment (db.sealing); goes with it
summary = Table(
    "summary",
    metadata,
    Column(
        "segment_id",
        BigInteger().with_variant(Integer, "sqlite"),
        ForeignKey(segment.c.segment_id, ondelete="CASCADE"),
        primary_key=True,
    ),
    # what is summarised, and the length of its bins; 0 where there are none
    Column("quantity", Text, primary_key=True),
    *keys(Integer, "bin_s"),
    Column("content", LargeBinary, nullable=False),
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
    Index("journal_key", "spacecraft_key", "kind", "key", unique=True),
    Index("journal_start", "spacecraft_key", "kind", "start_us", "number", "stop_us"),
    sqlite_with_rowid=False,
)
# without figures the planner of SQLite assumes ten rows a spacecraft, and reads a whole journal to find a key
_JOURNAL_SIZES = (
    "ANALYZE journal",
    """INSERT INTO sqlite_stat1 (tbl, idx, stat) VALUES ('journal', 'journal', '1000000 100000 1'),
    ('journal', 'journal_key', '1000000 100000 100 1'), ('journal', 'journal_start', '1000000 100000 100 1 1 1')""",
    # so that the connection which makes the tables reads them too
    "ANALYZE sqlite_master",
)

#: the newest revision of each operation
operation = Table(
    "operation",
    metadata,
    spacecraft_key(),
    *keys(Integer, "operation_id"),
    Column("revision", Integer, nullable=False),
    Column("number", BigInteger, nullable=False),
)

calibration = Table(
    "calibration",
    metadata,
    spacecraft_key(),
    *keys(Integer, "calibration_id"),
    *needed(Text, "method", "state"),
    *needed(Integer, "plan_id", "ephemeris_id"),
    Column("created_at_us", BigInteger, nullable=False),
    *needed(Text, "created_by", "request", "digest"),
    *optional(Text, "result", "error", "override_reason"),
)

alignment = Table(
    "alignment",
    metadata,
    spacecraft_key(),
    *keys(Integer, "alignment_id"),
    *needed(BigInteger, "epoch_us", "number"),
    *needed(Text, "document", "digest"),
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
    # see db.encoding.measurement_rows
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

#: states from which a chain goes on: of the live version several, of a replay that may be interrupted one
checkpoint = Table(
    "checkpoint",
    metadata,
    spacecraft_key(is_referencing=False),
    *keys(Text, "version"),
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
    # what it is about: the number of a calibration, the version of a replay
    *optional(Text, "error", "spacecraft_id", "subject"),
    # the least first
    Column("priority", Integer, nullable=False),
    # the process that runs it, and its number on a server
    *(Column("holder", Text), Column("member_id", BigInteger)),
    Index("job_order", "state", "priority", "created_at_us"),
)

replay = Table(
    "replay",
    metadata,
    spacecraft_key(),
    *keys(Integer, "replay_id"),
    Column("document", Text, nullable=False),
    Column("job_id", Text),
    # what it wrote, whatever retention has taken since
    *optional(BigInteger, "attitude_rows", "torque_rows"),
    Column("is_deleted", Boolean),
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


access_key = Table(
    "access_key",
    metadata,
    Column("key_id", Text, primary_key=True),
    *needed(Text, "name", "role"),
    Column("digest", LargeBinary, nullable=False),
    Column("created_at_us", BigInteger, nullable=False),
    Column("created_by", Text, nullable=False),
    *optional(BigInteger, "expires_at_us", "last_used_us", "revoked_at_us"),
    Column("station", Text),
    # words by commas
    *needed(Text, "spacecraft", "kinds"),
)

browser_session = Table(
    "browser_session",
    metadata,
    Column("digest", LargeBinary, primary_key=True),
    Column("key_id", Text, nullable=False),
    Column("ends_at_us", BigInteger, nullable=False),
)

audit_entry = Table(
    "audit_entry",
    metadata,
    Column("number", BigInteger().with_variant(Integer(), "sqlite"), primary_key=True, autoincrement=False),
    Column("at_us", BigInteger, nullable=False),
    *needed(Text, "who", "key_id", "role", "address", "action", "target", "outcome", "request_id"),
    Column("body_sha256", Text),
    Column("times", Integer, nullable=False),
    *needed(Text, "previous_hash", "hash"),
    Index("audit_entry_time", "at_us"),
)

_POSTGRESQL_GUARD = (
    """
CREATE FUNCTION audit_entry_guard() RETURNS trigger LANGUAGE plpgsql AS
$$ BEGIN RAISE EXCEPTION 'audit entries are never changed'; END $$
""",
    """
CREATE TRIGGER audit_entry_guard BEFORE UPDATE OR DELETE OR TRUNCATE ON audit_entry
FOR EACH STATEMENT EXECUTE FUNCTION audit_entry_guard()
""",
)
_SQLITE_GUARD = tuple(
    f"""
CREATE TRIGGER audit_entry_no_{change} BEFORE {change} ON audit_entry
BEGIN SELECT RAISE(ABORT, 'audit entries are never changed'); END
"""
    for change in ("UPDATE", "DELETE")
)
for _table, _dialect, _statements in (
    (journal, "sqlite", _JOURNAL_SIZES),
    (audit_entry, "postgresql", _POSTGRESQL_GUARD),
    (audit_entry, "sqlite", _SQLITE_GUARD),
):
    for _statement in _statements:
        _definition: DDL = DDL(_statement)  # type: ignore[no-untyped-call]
        event.listen(_table, "after_create", _definition.execute_if(dialect=_dialect))

#: one row: the newest entry; locking it orders all who write entries
audit_head = Table(
    "audit_head",
    metadata,
    *keys(Integer, "head_key"),
    Column("number", BigInteger, nullable=False),
    Column("hash", Text, nullable=False),
)


#: alarms of the service as a whole have no spacecraft
alarm = Table(
    "alarm",
    metadata,
    Column("alarm_id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("spacecraft_id", Text),
    Column("state", Text, nullable=False),
    Column("is_open", Boolean, nullable=False),
    Column("raised_at_us", BigInteger, nullable=False),
    Column("document", Text, nullable=False),
    Index("alarm_raised", "spacecraft_id", "raised_at_us", "alarm_id"),
    Index("alarm_open", "is_open", "spacecraft_id"),
)

#: every change of every alarm with the alarm as it was after it; only ever added to
alarm_change = Table(
    "alarm_change",
    metadata,
    Column("sequence", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("alarm_id", BigInteger, nullable=False),
    Column("spacecraft_id", Text),
    Column("document", Text, nullable=False),
    checksum_column(),
    Index("alarm_change_alarm", "alarm_id", "sequence"),
    Index("alarm_change_spacecraft", "spacecraft_id", "sequence"),
)

#: what is about to alarm, and records of telemetry that every process of the archive refused since one was accepted;
#: the empty id stands for the service as a whole
alarm_memory = Table(
    "alarm_memory",
    metadata,
    Column("spacecraft_id", Text, primary_key=True),
    Column("document", Text, nullable=False),
    Column("refused", Integer, nullable=False, default=0),
)

alarm_limits = Table(
    "alarm_limits",
    metadata,
    Column("spacecraft_id", Text, primary_key=True),
    *keys(Integer, "version"),
    Column("document", Text, nullable=False),
)

#: only ever added to
note = Table(
    "note",
    metadata,
    Column("note_id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("spacecraft_id", Text),
    Column("epoch_us", BigInteger, nullable=False),
    Column("document", Text, nullable=False),
    checksum_column(),
    Index("note_epoch", "epoch_us", "note_id"),
)


#: a member that was silent for so long has lost its leases, microseconds
LEASE_US = 15_000_000
#: class of the advisory locks that members hold under their numbers; any number, the same in every process
MEMBERS_LOCK = 5_210_122
#: present of the server, microseconds UTC
SERVER_NOW_US: ColumnElement[int] = literal_column("(extract(epoch FROM clock_timestamp()) * 1000000)::bigint")

#: processes; seen_at_us by the clock of the server
member = Table(
    "member",
    metadata,
    Column("member_id", Integer, primary_key=True),
    Column("name", Text, nullable=False),
    Column("is_estimator", Boolean, nullable=False),
    Column("seen_at_us", BigInteger, nullable=False),
)

#: by spacecraft id, and of the archive under the empty name; holder 0 = nobody's
lease = Table(
    "lease",
    metadata,
    Column("name", Text, primary_key=True),
    *needed(BigInteger, "holder", "term"),
)

_HAS_SESSION = text(
    "EXISTS (SELECT FROM pg_locks WHERE locktype = 'advisory' AND classid = :locks AND objid::bigint = member_id AND "
    "objsubid = 2 AND granted AND database = (SELECT oid FROM pg_database WHERE datname = current_database()))"
).bindparams(locks=MEMBERS_LOCK)
#: members that live, on PostgreSQL
live_member = select(member).where(member.c.seen_at_us > SERVER_NOW_US - LEASE_US, _HAS_SESSION).subquery("live")


#: one document a spacecraft; a writer must name the version that it changes
release_state = Table(
    "release_state",
    metadata,
    spacecraft_key(is_referencing=False),
    Column("version", BigInteger, nullable=False),
    *needed(Text, "holder", "document"),
)

release_command = Table(
    "release_command",
    metadata,
    spacecraft_key(is_referencing=False),
    Column("counter", BigInteger, primary_key=True, autoincrement=False),
    Column("prepared_us", BigInteger, nullable=False),
    *needed(Text, "state", "digest", "document"),
    Index("release_command_prepared", "spacecraft_key", "prepared_us", "counter"),
)

#: only ever added to
uplink_product = Table(
    "uplink_product",
    metadata,
    spacecraft_key(is_referencing=False),
    Column("form", Text, primary_key=True),
    Column("counter", BigInteger, primary_key=True, autoincrement=False),
    Column("created_us", BigInteger, nullable=False),
    Column("document", Text, nullable=False),
    checksum_column(),
)


#: number of the layout that this program makes and reads
LAYOUT = 10

#: one row; apart from the tables that a copy of an archive fills
archive_layout = Table(
    "archive_layout",
    MetaData(),
    *keys(Integer, "number"),
    # of the service: two of them on one host have cookies of different names
    Column("service_id", Text, nullable=False),
)


def create_tables(connection: Connection) -> None:
    """Make every table of an archive in a database that has none of them."""
    metadata.create_all(connection, checkfirst=False)
    archive_layout.create(connection, checkfirst=False)
    connection.execute(archive_layout.insert().values(number=LAYOUT, service_id=secrets.token_hex(8)))


def layout_of(connection: Connection) -> int | None:
    """Return the layout of an archive; None where there is no archive, 0 where it has no number."""
    inspector = inspect(connection)
    if inspector.has_table(archive_layout.name):
        return connection.scalar(select(archive_layout.c.number)) or 0
    return 0 if inspector.has_table(spacecraft.name) else None


def refusal(layout: int, what: str = "archive") -> str:
    """Return why an archive, or a backup, of another layout is not used, and what to do."""
    return (
        f"the {what} has layout {layout}, this program uses layout {LAYOUT}, and until release 1.0 no archive is "
        "carried over to another layout: use the version of SOO that made it, or start a new archive"
    )
