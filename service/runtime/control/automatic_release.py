"""Release automatic of a real spacecraft: two approvers ask for it within a time, each by an order of their own."""

from dataclasses import dataclass, field, replace
from threading import Lock

from service.errors import ForbiddenError
from service.ports.storage import Catalogue
from service.records.catalogue import Release
from service.records.epoch import US_PER_S

#: how long the first request waits for the second, s
WAIT_S = 900.0


@dataclass
class AutomaticRelease:
    """Requests that wait for a second approver; a restart forgets them.

    Parameters
    ----------
    catalogue : Catalogue
        Where the release is set.
    """

    catalogue: Catalogue
    #: who asked and when, by spacecraft
    _requests: dict[str, tuple[str, int]] = field(default_factory=dict)
    _lock: Lock = field(default_factory=Lock)

    def ask(self, spacecraft_id: str, by: str, now_us: int) -> str | None:
        """Ask for release automatic; return who asked before when that sets it, None while a second one is missing.

        ForbiddenError ``interlock.second_person`` when the same approver asks again.
        """
        with self._lock:
            first, asked_us = self._requests.get(spacecraft_id, (by, 0))
            is_waiting = asked_us <= now_us < asked_us + round(WAIT_S * US_PER_S)
            if not is_waiting:
                self._requests[spacecraft_id] = by, now_us
                return None
            if first == by:
                raise ForbiddenError("interlock.second_person", "release automatic needs two approvers")
            del self._requests[spacecraft_id]
            spacecraft = self.catalogue.spacecraft(spacecraft_id)
            control = replace(spacecraft.control, release=Release.AUTOMATIC)
            self.catalogue.replace_spacecraft(replace(spacecraft, control=control))
            return first
