"""Layout of an archive: the tables of a new one, and the refusal of an archive with another layout.

Until release 1.0 an archive is not carried over to another layout: a change of a table, or of what the bytes in its
columns mean, raises `LAYOUT`.
"""

import secrets

from sqlalchemy import Column, Connection, Integer, MetaData, Table, Text, inspect, select

from db.schema import tables  # noqa: F401 - they add their tables
from db.schema.tables import metadata, spacecraft

#: number of the layout that this program makes and reads
LAYOUT = 8

#: one row; apart from the tables that a copy of an archive fills
archive_layout = Table(
    "archive_layout",
    MetaData(),
    Column("number", Integer, primary_key=True, autoincrement=False),
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
