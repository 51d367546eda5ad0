"""The port of the lease: of several services on one archive one estimates, alarms, releases and keeps house."""

from typing import Protocol


class Lease(Protocol):
    """Lease of an archive: its holder alone computes, maintains and releases.

    It ends with its holder, however that ends. What was written under it is refused, inside the transaction, once it
    is another's: StorageError ``lease.lost``.
    """

    def acquire(self) -> bool:
        """Take the lease unless another service has it; return whether it is ours. What its last holder began is over.

        Waits for nobody.
        """

    def is_held(self) -> bool:
        """Return whether it is ours still, as the archive knows it; False where the archive does not answer."""

    def give_back(self) -> None:
        """Let another service have it."""
