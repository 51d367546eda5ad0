"""Schema version of a database, and the versions from which this service can migrate."""

from pathlib import Path

from sqlalchemy import Connection, inspect, text

_VERSIONS = Path(__file__).parents[1] / "migrations" / "versions"


def known_versions() -> tuple[str, ...]:
    """Return the versions that this code can migrate from, oldest first."""
    # the files of the migrations are numbered
    return tuple(sorted(path.stem.partition("_")[0] for path in _VERSIONS.glob("[0-9]*_*.py")))


def version_of(connection: Connection) -> str | None:
    """Return the version of a database, None where there is no schema."""
    if not inspect(connection).has_table("alembic_version"):
        return None
    version: str | None = connection.scalar(text("SELECT version_num FROM alembic_version"))
    return version
