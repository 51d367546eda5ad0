"""Tables of access keys and of the audit log.

A key row holds a digest, never a key. Audit entries are only ever added: triggers of the migration refuse any change of
one, on both databases.
"""

from sqlalchemy import BigInteger, Column, Index, Integer, LargeBinary, Table, Text

from db.schema.tables import metadata

access_key = Table(
    "access_key",
    metadata,
    Column("key_id", Text, primary_key=True),
    Column("name", Text, nullable=False),
    Column("role", Text, nullable=False),
    Column("digest", LargeBinary, nullable=False),
    Column("created_at_us", BigInteger, nullable=False),
    Column("created_by", Text, nullable=False),
    Column("expires_at_us", BigInteger),
    Column("last_used_us", BigInteger),
    Column("revoked_at_us", BigInteger),
)

audit_entry = Table(
    "audit_entry",
    metadata,
    Column("number", BigInteger().with_variant(Integer(), "sqlite"), primary_key=True, autoincrement=False),
    Column("at_us", BigInteger, nullable=False),
    Column("who", Text, nullable=False),
    Column("key_id", Text, nullable=False),
    Column("role", Text, nullable=False),
    Column("address", Text, nullable=False),
    Column("action", Text, nullable=False),
    Column("target", Text, nullable=False),
    Column("outcome", Text, nullable=False),
    Column("request_id", Text, nullable=False),
    Column("body_sha256", Text),
    Column("times", Integer, nullable=False),
    Column("previous_hash", Text, nullable=False),
    Column("hash", Text, nullable=False),
    Index("audit_entry_time", "at_us"),
)

#: one row: the newest entry; locking it orders all who write entries
audit_head = Table(
    "audit_head",
    metadata,
    Column("head_key", Integer, primary_key=True, autoincrement=False),
    Column("number", BigInteger, nullable=False),
    Column("hash", Text, nullable=False),
)
