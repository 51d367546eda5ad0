"""One database seen as a whole."""

from typing import Protocol

from service.ports.access import Audit, Keys
from service.ports.archive import Archive
from service.ports.catalogue import Catalogue
from service.ports.lease import Leases
from service.ports.release import Releases
from service.ports.results import Results
from service.ports.stations import Links, Traces
from service.ports.watch import Alarms, Notes
from service.records.storage.storage_state import StorageState


class Storage(Protocol):
    """One database seen as a whole."""

    catalogue: Catalogue
    archive: Archive
    results: Results
    links: Links
    alarms: Alarms
    notes: Notes
    releases: Releases
    traces: Traces
    keys: Keys
    audit: Audit
    leases: Leases

    def prepare(self) -> None:
        """Make the tables of an archive in an empty database; ValueError for an archive of another layout."""

    def require_layout(self) -> None:
        """Raise ValueError unless this is an archive of the layout of this program."""

    def state(self) -> StorageState:
        """Return the state of the storage; StorageError unless the database answers."""

    def close(self) -> None:
        """Commit what is queued and let go of the database."""
