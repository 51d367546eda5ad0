"""Replays count what they wrote, go on from a checkpoint, and are marked when they are deleted."""

import json

import sqlalchemy as sa
from alembic import op

from db.schema.columns import keys, needed, optional, spacecraft_key

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None

_REPLAY = sa.table("replay", *(sa.column(n) for n in ("spacecraft_key", "replay_id", "document", "job_id")))
_COUNT = """UPDATE replay SET {table}_rows = (SELECT count(*) FROM {table}
WHERE {table}.spacecraft_key = replay.spacecraft_key AND {table}.version = 'replay-' || replay.replay_id)
+ (SELECT coalesce(sum(row_count), 0) FROM result_segment AS sealed WHERE sealed.series = '{table}'
AND sealed.spacecraft_key = replay.spacecraft_key AND sealed.version = 'replay-' || replay.replay_id)"""


def upgrade() -> None:
    for column in (sa.Column("job_id", sa.Text()), *optional(sa.BigInteger, "attitude_rows", "torque_rows")):
        op.add_column("replay", column)
    op.add_column("replay", sa.Column("is_deleted", sa.Boolean()))
    op.execute("UPDATE replay SET is_deleted = false")
    connection = op.get_bind()
    for key, number, document in connection.execute(sa.select(*list(_REPLAY.c)[:3])).all():
        is_it = (_REPLAY.c.spacecraft_key == key, _REPLAY.c.replay_id == number)
        connection.execute(_REPLAY.update().where(*is_it).values(job_id=json.loads(document)["job_id"]))
    for table in ("attitude", "torque"):
        op.execute(_COUNT.format(table=table))
    op.create_table(
        "replay_checkpoint",
        spacecraft_key(is_referencing=False),
        *keys(sa.Integer, "replay_id"),
        *needed(sa.BigInteger, "number", "epoch_us"),
        *needed(sa.Text, "fingerprint"),
        *needed(sa.LargeBinary, "content"),
        sa.Column("checksum", sa.LargeBinary()),
    )


def downgrade() -> None:
    op.drop_table("replay_checkpoint")
    # a version that was deleted is nobody's to read, and its number may come again
    op.execute("DELETE FROM replay WHERE is_deleted")
    for name in ("is_deleted", "torque_rows", "attitude_rows", "job_id"):
        op.drop_column("replay", name)
