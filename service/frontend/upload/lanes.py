"""Which rows go next: the live lane and the backfill lane take turns while both have rows, so that neither starves.

::

    lane       rows                                    order            turn
    LIVE       younger than the limit of lateness      oldest first     first, then every second request
    BACKFILL   older                                   oldest first     every second request
    (traces)   evidence                                oldest first     when no row waits

A request that failed is no turn: the same lane comes again.
"""

from service.frontend.spool.file import Lane

_OTHER = {Lane.LIVE: Lane.BACKFILL, Lane.BACKFILL: Lane.LIVE}


class LaneTurns:
    """Whose turn it is.

    Examples
    --------
    >>> turns = LaneTurns()
    >>> [lane.name for lane in turns.order()]
    ['LIVE', 'BACKFILL']
    >>> turns.took(Lane.LIVE)
    >>> [lane.name for lane in turns.order()]
    ['BACKFILL', 'LIVE']
    """

    def __init__(self) -> None:
        self._next = Lane.LIVE

    def order(self) -> tuple[Lane, Lane]:
        """Return the lanes in the order in which they are looked into for rows."""
        return self._next, _OTHER[self._next]

    def took(self, lane: Lane) -> None:
        """Note that a request of a lane has been answered for good."""
        self._next = _OTHER[lane]
