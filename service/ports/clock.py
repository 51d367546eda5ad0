"""The port of time."""

from typing import Protocol


class Clock(Protocol):
    """The only source of time."""

    def now_us(self, spacecraft_id: str) -> int | None:
        """Return the present of a spacecraft, microseconds UTC; None before its first row under the data clock."""

    def is_data(self, spacecraft_id: str) -> bool:
        """Return whether a spacecraft lives under the data clock, where its present is the newest epoch it sent."""

    def system_us(self) -> int:
        """Return the system's present, microseconds UTC, for receipt and creation times."""
