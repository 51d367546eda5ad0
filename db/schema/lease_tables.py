"""Tables of processes on one PostgreSQL server and of their leases; an archive in a file has no rows in them."""

from sqlalchemy import BigInteger, Boolean, Column, ColumnElement, Integer, Table, Text, literal_column, select, text

from db.schema.columns import needed
from db.schema.tables import metadata

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
