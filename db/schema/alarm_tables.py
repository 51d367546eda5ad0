"""Tables of alarms, their changes, limits and memory, and of the shift log."""

from sqlalchemy import BigInteger, Boolean, Column, Index, Integer, Table, Text

from db.schema.row_checksum import checksum_column
from db.schema.tables import metadata

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

#: what is about to alarm; the empty id stands for the service as a whole
alarm_memory = Table(
    "alarm_memory",
    metadata,
    Column("spacecraft_id", Text, primary_key=True),
    Column("document", Text, nullable=False),
)

alarm_limits = Table(
    "alarm_limits",
    metadata,
    Column("spacecraft_id", Text, primary_key=True),
    Column("version", Integer, primary_key=True, autoincrement=False),
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
