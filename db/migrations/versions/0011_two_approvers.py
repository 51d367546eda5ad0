"""Real spacecraft under release automatic become two_step: two approvers set it; when that happened is kept."""

import json

import sqlalchemy as sa
from alembic import op

from db.schema.columns import spacecraft_key

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None

_SPACECRAFT = sa.table("spacecraft", sa.column("spacecraft_key"), sa.column("document"))


def upgrade() -> None:
    made = op.create_table(
        "release_made_two_step",
        spacecraft_key(is_referencing=False),
        sa.Column("at_us", sa.BigInteger(), nullable=False),
    )
    connection = op.get_bind()
    now_s = connection.execute(sa.select(sa.extract("epoch", sa.func.current_timestamp()))).scalar_one()
    for key, text in connection.execute(sa.select(_SPACECRAFT.c.spacecraft_key, _SPACECRAFT.c.document)).all():
        document = json.loads(text)
        if document.get("simulated") or document.get("control", {}).get("release") != "automatic":
            continue
        document["control"]["release"] = "two_step"
        is_it = _SPACECRAFT.c.spacecraft_key == key
        connection.execute(_SPACECRAFT.update().where(is_it).values(document=json.dumps(document)))
        connection.execute(made.insert().values(spacecraft_key=key, at_us=int(now_s) * 1_000_000))


def downgrade() -> None:
    op.drop_table("release_made_two_step")
