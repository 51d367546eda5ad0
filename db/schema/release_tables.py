"""Tables of the release of torques: its state, its commands, its uplink products."""

from sqlalchemy import BigInteger, Column, Index, Table, Text

from db.schema.columns import needed, spacecraft_key
from db.schema.row_checksum import checksum_column
from db.schema.tables import metadata

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
