"""Tables of access keys and of the audit log.

A key row holds a digest, never a key. Audit entries are only ever added: triggers refuse any change of one, on both
databases.
"""

from sqlalchemy import DDL, BigInteger, Column, Index, Integer, LargeBinary, Table, Text, event

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
for _dialect, _statements in (("postgresql", _POSTGRESQL_GUARD), ("sqlite", _SQLITE_GUARD)):
    for _statement in _statements:
        _guard: DDL = DDL(_statement)  # type: ignore[no-untyped-call]
        event.listen(audit_entry, "after_create", _guard.execute_if(dialect=_dialect))

#: one row: the newest entry; locking it orders all who write entries
audit_head = Table(
    "audit_head",
    metadata,
    Column("head_key", Integer, primary_key=True, autoincrement=False),
    Column("number", BigInteger, nullable=False),
    Column("hash", Text, nullable=False),
)
