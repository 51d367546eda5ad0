"""Refusals: 401 and 403 on their way to the audit log, without letting a flood fill the disk.

Of equal refusals (status, key, address) the first within ten minutes is written at once, the others are counted and
written as one entry when the ten minutes are over. No more than twenty such groups are told apart; what is beyond them
is counted together. The log so grows by less than fifty entries in ten minutes, whatever comes.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Lock

from service.records.operations.audit import AuditEvent

WINDOW_S = 600.0
MAX_GROUPS = 20
_OTHERS = ("", "", "")


@dataclass
class _Group:
    """Refusals counted, but not written."""

    last: AuditEvent
    times: int = 0


class Refusals:
    """Counters of the requests refused lately, one audit entry a group.

    Parameters
    ----------
    monotonic_s : callable
        Gives the time.
    """

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._monotonic_s = monotonic_s
        self._groups: dict[tuple[str, str, str], _Group] = {}
        self._until_s = monotonic_s() + WINDOW_S
        #: requests come on the loop, another thread takes away what was counted
        self._lock = Lock()

    def admit(self, audit_event: AuditEvent) -> bool:
        """Return whether a refusal is to be written now; the others are counted."""
        with self._lock:
            return self._is_first(audit_event)

    def settled(self, *, is_last: bool = False) -> list[AuditEvent]:
        """Return the counted refusals at the end of their window or of the service, and clear the counters."""
        now_s = self._monotonic_s()
        if now_s < self._until_s and not is_last:
            return []
        with self._lock:
            groups, self._groups, self._until_s = self._groups, {}, now_s + WINDOW_S
        return [replace(group.last, times=group.times) for group in groups.values() if group.times]

    def _is_first(self, audit_event: AuditEvent) -> bool:
        name = (audit_event.outcome, audit_event.key_id, audit_event.address)
        group = self._groups.get(name)
        is_new = group is None
        if group is None:
            name = name if len(self._groups) < MAX_GROUPS else _OTHERS
            is_new = name not in self._groups
            group = self._groups.setdefault(name, _Group(audit_event))
        if is_new:
            return True
        group.last, group.times = audit_event, group.times + 1
        return False
