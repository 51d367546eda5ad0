"""Choice of the rows to send next: the live lane and the backfill lane alternate while both have rows.

::

    lane       rows                                    order            turn
    LIVE       younger than the limit of lateness      oldest first     first, then every second request
    BACKFILL   older                                   oldest first     every second request
    (traces)   evidence                                oldest first     when no row waits

A request that failed is no turn: the same lane comes again.
"""

from service.frontend.spool.file import UploadLane

_OTHER = {UploadLane.LIVE: UploadLane.BACKFILL, UploadLane.BACKFILL: UploadLane.LIVE}


class LaneRotation:
    """Whose turn it is.

    Examples
    --------
    >>> turns = LaneRotation()
    >>> [lane.name for lane in turns.order()]
    ['LIVE', 'BACKFILL']
    >>> turns.served(UploadLane.LIVE)
    >>> [lane.name for lane in turns.order()]
    ['BACKFILL', 'LIVE']
    """

    def __init__(self) -> None:
        self._next = UploadLane.LIVE

    def order(self) -> tuple[UploadLane, UploadLane]:
        """Return the lanes in the order in which they are looked into for rows."""
        return self._next, _OTHER[self._next]

    def served(self, lane: UploadLane) -> None:
        """Note that a request of a lane has been answered for good."""
        self._next = _OTHER[lane]
