"""Leading: which spacecraft this process estimates, alarms, releases and maintains.

One thread asks for leases again and again, so that a process takes over within about a second of the end of another
one. Each time a lease is acquired a term begins: what was computed in an earlier term may be out of date and is read
from the archive again.
"""

import logging
import threading
import time
from collections.abc import Callable, Sequence

from service.errors import StorageError
from service.ports.storage import ARCHIVE, Leases, Term

_LOG = logging.getLogger("soo.leading")
#: between two polls of the leases, s
POLL_S = 1.0
#: longest wait for announcements before the end of this service is noticed, s
_WAIT_S = 0.1


def always(_name: str) -> int:
    """Return the one term of a service that is alone."""
    return 1


def _never(_name: str) -> int:
    """Return 0: nothing is led."""
    return 0


class Leading:
    """Holds leases, or waits for them.

    Parameters
    ----------
    leases : Leases
        Of the archive.
    is_estimator : bool, optional
        Whether this process leads at all.
    changed : callable, optional
        Gets the id of a spacecraft that another process has changed.
    """

    def __init__(
        self, leases: Leases, *, is_estimator: bool = True, changed: Callable[[str], None] = lambda _: None
    ) -> None:
        self._leases = leases
        self._is_estimator = is_estimator
        self._changed = changed
        self._term: Term = _never
        self._archive_term = self._ended = 0
        self._taking_over: tuple[Callable[[], None], ...] = ()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def term(self, name: str) -> int:
        """Return the number of this process's present term of a spacecraft, 0 while another one leads it."""
        return self._term(name)

    def silent_s(self) -> float:
        """Return for how long no process has been seen to lead the archive; 0 while this one does."""
        return 0.0 if self._archive_term else self._leases.silent_s()

    def start(self, taking_over: Sequence[Callable[[], None]] = ()) -> None:
        """Ask for leases, and from then on again and again.

        Parameters
        ----------
        taking_over : sequence of callables
            Called when this process begins to lead the archive, and when another one has ended while it does.
        """
        self._taking_over = tuple(taking_over)
        self._poll()
        if not self._archive_term:
            _LOG.info(
                "another service leads; this one stores rows and answers requests, and takes over when the other ends"
                if self._is_estimator
                else "this service stores rows and answers requests, estimators lead"
            )
        self._thread = threading.Thread(target=self._run, name="soo-leading", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Give the leases back."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
        self._term = _never
        self._leases.give_back()

    def _run(self) -> None:
        due_s = time.monotonic() + POLL_S
        while not self._stopping.is_set():
            try:
                for spacecraft_id in self._leases.wait(min(_WAIT_S, POLL_S)):
                    self._changed(spacecraft_id)
                if time.monotonic() >= due_s:
                    due_s = time.monotonic() + POLL_S
                    self._poll()
            except Exception:  # noqa: BLE001 the thread outlives every fault; it is asked again
                _LOG.exception("the leases could not be checked; checked again")
                self._stopping.wait(POLL_S)

    def _poll(self) -> None:
        """Ask which leases are ours; begin a term of the archive when it has become so."""
        self._term = self._leases.poll(is_estimator=self._is_estimator)
        before, ended = (self._archive_term, self._ended)
        self._archive_term, self._ended = self._term(ARCHIVE), self._leases.ended()
        if before and not self._archive_term:
            _LOG.warning("the lease is lost, another service may lead; this one requests it again")
        if not self._archive_term or (before, ended) == (self._archive_term, self._ended):
            return
        if before != self._archive_term:
            _LOG.info("this service leads")
        for each in self._taking_over:
            try:
                each()
            except StorageError as error:
                _LOG.warning("this service leads, but a step of taking over failed: %s", error)


def elsewhere(leases: Leases, spacecraft_id: str) -> StorageError:
    """Return the error for an order that only the leading process can execute."""
    process = leases.leaders().get(spacecraft_id, "another process, or none yet")
    led = spacecraft_id or "what belongs to no spacecraft"
    detail = f"{led} is led by {process}."
    return StorageError("lease.elsewhere", detail)


def is_moving(fault: Exception) -> bool:
    """Return whether a step failed because another process leads the spacecraft now, which is no error."""
    return isinstance(fault, StorageError) and fault.code in ("lease.lost", "lease.elsewhere")
