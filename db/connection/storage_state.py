"""State of the storage: schema against program, queue, disk. Asks the database once and never waits for the writer."""

import os
import shutil
from functools import cache
from pathlib import Path

from sqlalchemy import Engine, inspect, text

from db.connection.engines import translated_faults

_VERSIONS = Path(__file__).parents[1] / "migrations" / "versions"


@cache
def newest_revision() -> str:
    """Return the revision that this program needs: the files of the migrations are numbered."""
    return max(path.stem.partition("_")[0] for path in _VERSIONS.glob("[0-9]*_*.py"))


def present_revision(engine: Engine) -> str | None:
    """Return the revision of a database, None before its first migration."""
    with translated_faults(), engine.connect() as connection:
        if not inspect(connection).has_table("alembic_version"):
            return None
        found = connection.execute(text("SELECT version_num FROM alembic_version")).scalar()
    return None if found is None else str(found)


def disk_of(engine: Engine) -> tuple[int | None, bool | None]:
    """Return free bytes beside a database's file and whether it can be written; None for one behind a server."""
    name = engine.url.database
    if engine.dialect.name != "sqlite" or name is None:
        return None, None
    path = Path(name).absolute()
    try:
        free_bytes = shutil.disk_usage(path.parent).free
    except OSError:
        return 0, False
    return free_bytes, os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)
