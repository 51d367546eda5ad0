"""Tables of access keys and of the audit log.

A key row holds a digest, never a key. Audit entries are only ever added: triggers of the migration refuse any change of
one, on both databases.
"""

from sqlalchemy import BigInteger, Column, Index, Integer, LargeBinary, Table, Text

from db.schema.columns import needed, optional
from db.schema.tables import metadata

access_key = Table(
    "access_key",
    metadata,
    Column("key_id", Text, primary_key=True),
    *needed(Text, "name", "role"),
    Column("digest", LargeBinary, nullable=False),
    Column("created_at_us", BigInteger, nullable=False),
    Column("created_by", Text, nullable=False),
    *optional(BigInteger, "expires_at_us", "last_used_us", "revoked_at_us"),
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

#: one row: the newest entry; locking it orders all who write entries
audit_head = Table(
    "audit_head",
    metadata,
    Column("head_key", Integer, primary_key=True, autoincrement=False),
    Column("number", BigInteger, nullable=False),
    Column("hash", Text, nullable=False),
)
