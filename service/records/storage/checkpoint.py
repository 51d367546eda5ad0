"""Checkpoint: the state of a live chain after an entry of the journal."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """State of a chain as the archive keeps it."""

    #: journal number of the last entry that the state knows
    number: int
    #: newest consumed epoch, microseconds UTC
    epoch_us: int
    #: layout, kernels and configuration, which must be the same where it is taken up
    fingerprint: str
    content: bytes
