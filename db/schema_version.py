"""Which schema a database has, and which one this version of the service knows."""

import re
from pathlib import Path

from sqlalchemy import Connection, inspect, text

_VERSIONS = Path(__file__).parent / "migrations" / "versions"
_REVISION = re.compile(r'^revision = "(\w+)"$', re.MULTILINE)


def known_versions() -> tuple[str, ...]:
    """Return the versions that this code can migrate from, oldest first."""
    found = (_REVISION.search(path.read_text(encoding="utf-8")) for path in _VERSIONS.glob("[0-9]*.py"))
    return tuple(sorted(match[1] for match in found if match is not None))


def newest_version() -> str:
    """Return the version that this code works with."""
    return known_versions()[-1]


def version_of(connection: Connection) -> str | None:
    """Return the version of a database, None where there is no schema."""
    if not inspect(connection).has_table("alembic_version"):
        return None
    version: str | None = connection.scalar(text("SELECT version_num FROM alembic_version"))
    return version
