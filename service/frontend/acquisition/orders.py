"""Orders of an operator to an acquisition, from another thread: rest, go on, reset.

Law of this file: an order is taken once, between two actions; a wait ends as soon as there is one.
"""

import threading
import time

from service.frontend.acquisition.states import AcquisitionEvent, AcquisitionState

#: an order is noticed within this time, s
_POLL_S = 0.2


class AcquisitionOrders:
    """Orders to one acquisition.

    Parameters
    ----------
    stop : threading.Event
        End of the run; ends every wait.
    """

    def __init__(self, stop: threading.Event) -> None:
        self._stop = stop
        self._lock = threading.Lock()
        self._is_enabled = True
        self._resets_wanted = 0
        self._is_reset_here = False
        #: how many of the service's resets have been carried out
        self.resets_seen = 0
        self._has_heard = False

    def apply(self, *, is_enabled: bool, resets: int) -> None:
        """Apply the state that the service requests: link enabled or not, and number of resets so far.

        Resets asked for before the first answer were meant for an earlier start and are not carried out once more.
        """
        with self._lock:
            if not self._has_heard:
                self._has_heard, self.resets_seen = True, max(self.resets_seen, resets)
            self._is_enabled, self._resets_wanted = is_enabled, resets

    def reset(self) -> None:
        """Order a reset at this station."""
        with self._lock:
            self._is_reset_here = True

    def next(self, state: AcquisitionState) -> AcquisitionEvent | None:
        """Return the order that applies in a state; a reset counts as carried out."""
        with self._lock:
            is_reset = self._is_reset_here or self._resets_wanted > self.resets_seen
            self._is_reset_here = False
            self.resets_seen = max(self.resets_seen, self._resets_wanted)
            if self._is_enabled != (state is not AcquisitionState.DISABLED):
                return AcquisitionEvent.ENABLE if self._is_enabled else AcquisitionEvent.DISABLE
            return AcquisitionEvent.RESET if is_reset else None

    def is_pending(self, state: AcquisitionState) -> bool:
        """Return whether there is an order that applies in a state."""
        with self._lock:
            is_reset = self._is_reset_here or self._resets_wanted > self.resets_seen
            return is_reset or self._is_enabled != (state is not AcquisitionState.DISABLED)

    def wait(self, wait_s: float, state: AcquisitionState) -> None:
        """Wait, but no longer than until an order or the stop comes."""
        end_s = time.monotonic() + wait_s
        while not self._stop.is_set() and not self.is_pending(state):
            remaining_s = end_s - time.monotonic()
            if remaining_s <= 0.0:
                return
            self._stop.wait(min(remaining_s, _POLL_S))
