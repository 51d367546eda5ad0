"""Failures of the estimator that come back with every try, so that they are reported and not only logged.

There are two kinds: a *step* that ends by an error stores nothing and is tried again, ever later; a *row* whose
computation fails is stored without an attitude, and the next row is computed.
"""

import threading
import time
from collections.abc import Callable
from typing import Literal, NamedTuple

from service.runtime.clock import system_now_us

Kind = Literal["step", "row"]
#: failures one after another that are no accident
LASTING = 3
#: wait before a step is tried again, s: as often as failures are an accident, and at most
_RETRY_S, _LONGEST_RETRY_S = 1.0, 60.0


class StepFailure(NamedTuple):
    """Failures of one spacecraft without a success between them."""

    spacecraft_id: str
    kind: Kind
    #: the first of them
    error: str
    since_us: int
    times: int
    #: when the step is tried again, by the clock of waits
    retry_s: float


class StepFailures:
    """Failures of the spacecraft that a service estimates; safe from any thread.

    Parameters
    ----------
    now_us : callable
        The system's present, microseconds UTC.
    """

    def __init__(self, now_us: Callable[[], int] = system_now_us) -> None:
        self._now_us = now_us
        self._lock = threading.Lock()
        self._found: dict[tuple[str, Kind], StepFailure] = {}

    def note(self, spacecraft_id: str, kind: Kind, error: str, *, is_outage: bool = False) -> None:
        """Note one more failure; an outage of the database never lasts here: it has a readiness of its own."""
        with self._lock:
            first = self._found.get((spacecraft_id, kind))
            times = 1 if first is None or is_outage else first.times + 1
            wait_s = min(_LONGEST_RETRY_S, _RETRY_S * 2.0 ** max(0, times - LASTING))
            error, since_us = (error, self._now_us()) if first is None else (first.error, first.since_us)
            failure = StepFailure(spacecraft_id, kind, error, since_us, times, time.monotonic() + wait_s)
            self._found[spacecraft_id, kind] = failure

    def forget(self, spacecraft_id: str, *kinds: Kind) -> None:
        """Forget failures of a spacecraft: a step or a row has succeeded, or another process estimates it."""
        with self._lock:
            for kind in kinds:
                self._found.pop((spacecraft_id, kind), None)

    def is_waiting(self, spacecraft_id: str) -> bool:
        """Return whether the next step of a spacecraft is to wait."""
        with self._lock:
            failure = self._found.get((spacecraft_id, "step"))
        return failure is not None and time.monotonic() < failure.retry_s

    def lasting(self, spacecraft_id: str | None = None) -> tuple[StepFailure, ...]:
        """Return the failures that are no accident, of one spacecraft or of all."""
        with self._lock:
            found = tuple(self._found.values())
        return tuple(one for one in found if one.times >= LASTING and spacecraft_id in (None, one.spacecraft_id))
