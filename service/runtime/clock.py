"""Clocks: the only reader of time in the service.

``SystemClock`` is the computer's UTC. ``DataClock`` is, for a simulated spacecraft, the newest epoch of an accepted
measurement, so that demonstrations and tests run faster than real time; nothing else moves it. A spacecraft that is
not simulated keeps the system's time under either.
"""

import time
from collections.abc import Callable

from service.ports.storage import ClockReading
from service.records.catalogue import Spacecraft


def system_now_us() -> int:
    """Return the system's present, microseconds UTC."""
    return time.time_ns() // 1000  # noqa: TID251 this module is the one place that reads time


class SystemClock:
    """The computer's UTC for every spacecraft."""

    def reading(self, spacecraft: Spacecraft, newest_epoch_us: int | None) -> ClockReading:  # noqa: ARG002 as below
        """Return the present, microseconds UTC."""
        return ClockReading(is_data=False, now_us=system_now_us())

    def now_us(self, spacecraft_id: str) -> int | None:  # noqa: ARG002 the port asks for it
        """Return the present, microseconds UTC."""
        return system_now_us()

    def system_us(self) -> int:
        """Return the system's present, microseconds UTC."""
        return system_now_us()

    def is_data(self, spacecraft_id: str) -> bool:  # noqa: ARG002 the port asks for it
        """Return False: epochs do not move this clock."""
        return False


class DataClock:
    """The newest accepted epoch for simulated spacecraft, the system's UTC for others.

    Parameters
    ----------
    is_simulated : callable
        Whether a spacecraft is simulated.
    newest_epoch_us : callable
        The newest epoch of an accepted measurement of a spacecraft, None before the first.
    """

    def __init__(self, is_simulated: Callable[[str], bool], newest_epoch_us: Callable[[str], int | None]) -> None:
        self._is_simulated = is_simulated
        self._newest_epoch_us = newest_epoch_us

    def reading(self, spacecraft: Spacecraft, newest_epoch_us: int | None) -> ClockReading:
        """Return the present of a spacecraft whose newest epoch is known."""
        is_data = spacecraft.simulated
        return ClockReading(is_data, newest_epoch_us if is_data else system_now_us())

    def now_us(self, spacecraft_id: str) -> int | None:
        """Return the present of a spacecraft, None before its first row."""
        return self._newest_epoch_us(spacecraft_id) if self.is_data(spacecraft_id) else system_now_us()

    def system_us(self) -> int:
        """Return the system's present, microseconds UTC."""
        return system_now_us()

    def is_data(self, spacecraft_id: str) -> bool:
        """Return whether accepted epochs move the clock of this spacecraft."""
        return self._is_simulated(spacecraft_id)
