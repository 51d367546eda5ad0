"""State of the storage, as readiness and metrics tell it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class StorageState:
    """State of the storage, queried just now."""

    #: writes that wait for the writer
    queued_writes: int
    #: free bytes beside the database and whether it can be written there; None where it is on another machine
    free_bytes: int | None = None
    is_writable: bool | None = None
