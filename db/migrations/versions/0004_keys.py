"""Access keys and the audit log, whose entries no statement can change."""

import sqlalchemy as sa
from alembic import op

from db.schema.columns import needed, optional

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

_WORDS = "audit entries are never changed"
_SQLITE_GUARD = """
CREATE TRIGGER audit_entry_no_{deed} BEFORE {deed} ON audit_entry
BEGIN SELECT RAISE(ABORT, '{words}'); END
"""
_POSTGRESQL_FUNCTION = """
CREATE FUNCTION audit_entry_guard() RETURNS trigger LANGUAGE plpgsql AS
$$ BEGIN RAISE EXCEPTION '{words}'; END $$
"""
_POSTGRESQL_GUARD = """
CREATE TRIGGER audit_entry_guard BEFORE UPDATE OR DELETE OR TRUNCATE ON audit_entry
FOR EACH STATEMENT EXECUTE FUNCTION audit_entry_guard()
"""


def upgrade() -> None:
    op.create_table(
        "access_key",
        sa.Column("key_id", sa.Text(), primary_key=True),
        *needed(sa.Text(), "name", "role"),
        sa.Column("digest", sa.LargeBinary(), nullable=False),
        sa.Column("created_at_us", sa.BigInteger(), nullable=False),
        sa.Column("created_by", sa.Text(), nullable=False),
        *optional(sa.BigInteger(), "expires_at_us", "last_used_us", "revoked_at_us"),
    )
    _entries()
    op.create_table(
        "audit_head",
        sa.Column("head_key", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
        sa.Column("hash", sa.Text(), nullable=False),
    )
    _guard()


def downgrade() -> None:
    for name in ("audit_head", "audit_entry", "access_key"):
        op.drop_table(name)
    if op.get_bind().dialect.name == "postgresql":
        op.execute("DROP FUNCTION audit_entry_guard()")


def _entries() -> None:
    op.create_table(
        "audit_entry",
        sa.Column(
            "number", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), primary_key=True, autoincrement=False
        ),
        sa.Column("at_us", sa.BigInteger(), nullable=False),
        *needed(sa.Text(), "who", "key_id", "role", "address", "action", "target", "outcome", "request_id"),
        sa.Column("body_sha256", sa.Text()),
        sa.Column("times", sa.Integer(), nullable=False),
        *needed(sa.Text(), "previous_hash", "hash"),
    )
    op.create_index("audit_entry_time", "audit_entry", ["at_us"], unique=False)


def _guard() -> None:
    if op.get_bind().dialect.name == "postgresql":
        op.execute(_POSTGRESQL_FUNCTION.format(words=_WORDS))
        op.execute(_POSTGRESQL_GUARD)
        return
    for deed in ("UPDATE", "DELETE"):
        op.execute(_SQLITE_GUARD.format(deed=deed, words=_WORDS))
