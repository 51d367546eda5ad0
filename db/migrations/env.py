"""Alembic environment: migrations run in the transaction of the connection that ``migrate`` passes."""

from alembic import context

from db.schema.tables import metadata

context.configure(connection=context.config.attributes["connection"], target_metadata=metadata, transactional_ddl=True)
with context.begin_transaction():
    context.run_migrations()
