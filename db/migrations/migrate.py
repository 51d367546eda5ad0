"""Schema changes, driven from code: no configuration file on disk."""

from pathlib import Path

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, Engine, text

from db.connection.engines import translated_faults

_SCRIPTS = Path(__file__).parents[1] / "migrations"
#: any number, the same in every process
_LOCK = 5_210_119


def upgrade(engine: Engine, revision: str = "head") -> None:
    """Bring the schema up to a revision, all or nothing."""
    _run(engine, revision, is_up=True)


def downgrade(engine: Engine, revision: str = "base") -> None:
    """Take the schema down to a revision; what the older schema cannot hold is lost."""
    _run(engine, revision, is_up=False)


def _run(engine: Engine, revision: str, *, is_up: bool) -> None:
    with translated_faults(), engine.begin() as connection:
        wait_for_lock(connection)
        change_schema(connection, revision, is_up=is_up)


def wait_for_lock(connection: Connection) -> None:
    """Keep every other process from changing the schema until the transaction ends."""
    if connection.dialect.name == "postgresql":
        # one process migrates, and it does not wait for ever behind a reader
        connection.execute(text("SET LOCAL lock_timeout = '30s'"))
        connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _LOCK})


def change_schema(connection: Connection, revision: str = "head", *, is_up: bool = True) -> None:
    """Bring the schema to a revision in the transaction of a connection."""
    config = Config()
    config.set_main_option("script_location", str(_SCRIPTS))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    change = command.upgrade if is_up else command.downgrade
    change(config, revision)
