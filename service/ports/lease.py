"""The port of leases: of several processes on one archive one at a time estimates, alarms and releases a spacecraft."""

from collections.abc import Callable
from typing import Protocol

#: lease of what belongs to no spacecraft: jobs, alarms of the service, checksums
ARCHIVE = ""
#: number of the leadership term of a spacecraft, or of the archive, in this process; 0 while another one leads it
Term = Callable[[str], int]


class Leases(Protocol):
    """Leases of an archive: one a spacecraft, and one of the archive.

    A lease ends with its holder, however that ends; one that does not answer for 15 s has lost it. A write under a
    lease that is another's is refused inside the transaction: StorageError ``lease.lost``.
    """

    def poll(self, *, is_estimator: bool) -> Term:
        """Renew the leases of this process, take its share of those that are free, give back what is above it.

        Waits for nobody. While the archive does not answer no term is held. Who is no estimator gets no lease.
        """

    def wait(self, limit_s: float) -> frozenset[str]:
        """Wait until other processes have announced changes, at most so long; return the ids of the spacecraft."""

    def leaders(self) -> dict[str, str]:
        """Return the name of the process that leads each spacecraft, and the archive, where the archive knows it."""

    def ended(self) -> int:
        """Return a number that changes when another process has ended; its jobs are nobody's then."""

    def give_back(self) -> None:
        """Let other processes have all leases."""
