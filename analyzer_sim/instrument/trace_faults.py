"""Faults of what the instrument shows, armed from a test, each spent by one trace that is read.

Law of this file: the line and the answer's syntax stay right, the numbers in it are wrong; nothing happens unless
armed. Frequencies of points are never touched.
"""

import threading
from collections import deque
from collections.abc import Callable
from enum import Enum

import numpy as np

from analyzer_sim.streams import FloatArray

#: every so many points a fault of values takes one, so that no carrier of a wide sweep is spared
_EVERY = 10
#: 1 mW in 50 ohm above 1 uV, dB
_DBUV_ABOVE_DBM = 106.9897


class TraceFault(Enum):
    """Faults in the numbers of one trace."""

    #: every tenth point is not a number
    NAN = "nan"
    #: every tenth point is -999, what some makers show where there is no result
    NO_RESULT = "no_result"
    #: every tenth point is 9.91E37, SCPI's number for "not a number" (SCPI-99, 7.2.1.5)
    SCPI_NAN = "scpi_nan"
    #: every tenth point is 9.9E37, SCPI's infinity
    SCPI_INFINITY = "scpi_infinity"
    #: the last point is missing
    SHORT = "short"
    #: one point too many
    LONG = "long"
    #: there is not a single point
    EMPTY = "empty"
    #: levels are in dBuV, whatever unit is set
    UNIT_DBUV = "unit_dbuv"
    #: levels are in W, whatever unit is set
    UNIT_WATT = "unit_watt"


_VALUES = {
    TraceFault.NAN: float("nan"),
    TraceFault.NO_RESULT: -999.0,
    TraceFault.SCPI_NAN: 9.91e37,
    TraceFault.SCPI_INFINITY: 9.9e37,
}

_SHAPES: dict[TraceFault, Callable[[FloatArray], FloatArray]] = {
    TraceFault.SHORT: lambda shown: shown[:-1],
    TraceFault.LONG: lambda shown: np.concatenate([shown, shown[-1:]]),
    TraceFault.EMPTY: lambda shown: shown[:0],
    TraceFault.UNIT_DBUV: lambda shown: shown + _DBUV_ABOVE_DBM,
    TraceFault.UNIT_WATT: lambda shown: np.asarray(10.0 ** (0.1 * shown - 3.0)),
}


class TraceFaults:
    """Faults to come, in order; may be armed from any thread.

    Examples
    --------
    >>> faults = TraceFaults()
    >>> faults.arm(TraceFault.SHORT)
    >>> faults.spoil(np.zeros(3)).shape, faults.spoil(np.zeros(3)).shape
    ((2,), (3,))
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._armed: deque[TraceFault] = deque()

    def arm(self, fault: TraceFault, times: int = 1) -> None:
        """Let the next traces read suffer this fault."""
        with self._lock:
            self._armed.extend([fault] * times)

    def disarm(self) -> None:
        """Forget all faults to come."""
        with self._lock:
            self._armed.clear()

    @property
    def remaining(self) -> int:
        """Faults armed and not yet spent."""
        with self._lock:
            return len(self._armed)

    def spoil(self, shown: FloatArray) -> FloatArray:
        """Return levels as they are shown, shape (B,), with the next fault in them, if there is one."""
        with self._lock:
            fault = self._armed.popleft() if self._armed else None
        return shown if fault is None else _spoiled(fault, shown)


def _spoiled(fault: TraceFault, shown: FloatArray) -> FloatArray:
    if fault in _VALUES:
        wrong = shown.copy()
        wrong[::_EVERY] = _VALUES[fault]
        return wrong
    return _SHAPES[fault](shown)
