"""Leading: whether this service is the one of its archive that estimates, alarms, releases and keeps house.

One thread asks for the lease again and again, so that a service takes over within about a second of the end of the one
that had it. Each time it is taken counts as a turn: what was worked out in an earlier turn may be out of date and is
read from the archive again.
"""

import logging
import threading
from collections.abc import Callable, Sequence

from service.errors import StorageError
from service.ports import Lease

_LOG = logging.getLogger("soo.leading")
#: between two looks at the lease, s
POLL_S = 1.0

#: turn in which this service leads, 0 when it does not
Term = Callable[[], int]


def always() -> int:
    """Return the one turn of a service that is alone."""
    return 1


class Leading:
    """Holds the lease, or waits for it.

    Parameters
    ----------
    lease : Lease
        Of the archive.
    """

    def __init__(self, lease: Lease) -> None:
        self._lease = lease
        self._turns = 0
        self._is_leading = False
        self._taking_over: tuple[Callable[[], None], ...] = ()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def turn(self) -> int:
        """Return the number of this service's present turn, 0 while another service leads."""
        return self._turns if self._is_leading else 0

    def require(self) -> None:
        """Raise StorageError ``lease.elsewhere`` while another service leads."""
        if not self._is_leading:
            raise elsewhere()

    def start(self, taking_over: Sequence[Callable[[], None]] = ()) -> None:
        """Ask for the lease, and from then on again and again.

        Parameters
        ----------
        taking_over : sequence of callables
            Called at the begin of each turn.
        """
        self._taking_over = tuple(taking_over)
        self._poll()
        if not self._is_leading:
            _LOG.info(
                "another service leads; this one stores rows and answers requests, and takes over when the other ends"
            )
        self._thread = threading.Thread(target=self._run, name="soo-leading", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Give the lease back."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
        self._is_leading = False
        self._lease.give_back()

    def _run(self) -> None:
        while not self._stopping.wait(POLL_S):
            try:
                self._poll()
            except Exception:  # noqa: BLE001 the thread outlives every fault; it is asked again
                _LOG.exception("the lease could not be checked; checked again")

    def _poll(self) -> None:
        """Ask whether the lease is ours; begin a turn when it has become so."""
        if self._is_leading:
            if not self._lease.is_held():
                self._is_leading = False
                _LOG.warning("the lease is lost, another service may lead; this one requests it again")
            return
        if not self._lease.acquire():
            return
        self._turns += 1
        self._is_leading = True
        _LOG.info("this service leads")
        for each in self._taking_over:
            try:
                each()
            except StorageError as error:
                _LOG.warning("this service leads, but a step of taking over failed: %s", error)


def elsewhere() -> StorageError:
    """Return the error for an order that only the leading service can execute."""
    detail = "Another service of this archive leads: send the request to it, or retry when this one has taken over."
    return StorageError("lease.elsewhere", detail)
