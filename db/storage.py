"""Storage: the repositories over one database; implements ``service.ports.storage.Storage``."""

from sqlalchemy import Connection, select

from db.connection.engines import disk_of
from db.database import Database
from db.measurements.archive import SqlArchive
from db.operations.access import SqlAudit, SqlKeys
from db.operations.alarms import SqlAlarms, SqlNotes
from db.operations.catalogue import SqlCatalogue
from db.operations.links import SqlLinks, SqlTraces
from db.operations.releases import SqlReleases
from db.results.results import SqlResults
from db.tables import LAYOUT, create_tables, head, layout_of, refusal
from service.ports.storage import Storage
from service.records.storage import StorageState


class SqlStorage(Storage):
    """One SQLite file or PostgreSQL database.

    Parameters
    ----------
    url : str
        SQLAlchemy URL, for example ``sqlite:///soo.db`` or ``postgresql+psycopg://user@host/soo``.
    limit_s : float
        Longest wait for a lock or for an answer of a server; what takes longer fails and can be tried again.

    Raises
    ------
    ValueError
        The URL names a database that cannot keep the promise of the archive.
    """

    def __init__(self, url: str, limit_s: float = 10.0) -> None:
        self._database = Database(url, limit_s)
        self.catalogue = SqlCatalogue(self._database)
        self.archive = SqlArchive(self._database)
        self.results = SqlResults(self._database)
        self.links = SqlLinks(self._database)
        self.alarms = SqlAlarms(self._database)
        self.notes = SqlNotes(self._database)
        self.releases = SqlReleases(self._database)
        self.traces = SqlTraces(self._database)
        self.keys = SqlKeys(self._database)
        self.audit = SqlAudit(self._database)
        self.leases = self._database.leases

    def require_sessions(self) -> None:
        """Raise ValueError where a pooler stands before a server and keeps no sessions."""
        self._database.leases.require_sessions()

    def prepare(self) -> None:
        """Make the tables of an archive in an empty database; ValueError for an archive of another layout."""
        if self._layout() is None:
            self._database.write(_create_where_empty)
        self.require_layout()

    def require_layout(self) -> None:
        """Raise ValueError unless this is an archive of the layout of this program."""
        layout = self._layout()
        if layout != LAYOUT:
            raise ValueError("it holds no archive" if layout is None else refusal(layout))

    def _layout(self) -> int | None:
        with self._database.read() as connection:
            return layout_of(connection)

    def state(self) -> StorageState:
        """Return the state of the storage; StorageError unless the database answers."""
        self._database.fetch_one(select(head.c.spacecraft_key).limit(1))
        free_bytes, is_writable = disk_of(self._database.engines.read)
        return StorageState(self._database.queued_writes, free_bytes, is_writable)

    def close(self) -> None:
        """Commit what is queued and let go of the database."""
        self._database.close()


def _create_where_empty(connection: Connection) -> None:
    """Make the tables unless another process, which had the lock of all writers first, has made them."""
    if layout_of(connection) is None:
        create_tables(connection)
