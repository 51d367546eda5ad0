"""Publisher of stored steps of the release: to the estimator, to streams and to the audit log."""

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from service.errors import SooError
from service.pipeline.control.release.events import AuditEffect, JournalEffect, PublishEffect, ReleaseEffect
from service.pipeline.control.release.interlock import Instant
from service.ports import Audit
from service.records.operations.audit import CURRENT_NOTE, DONE, AuditEvent
from service.runtime.live.live_feed import Cursor, FeedEvent, LiveFeed

_LOG = logging.getLogger("soo.release")

#: who did what no person ordered
_WHO = "interlock"


@dataclass
class ReleasePublisher:
    """Publishes the effects of a step that is stored."""

    #: gets what happened by itself; an order has the event of its request
    audit: Audit
    #: streams read the state again
    feed: LiveFeed
    #: called with the spacecraft whose journal has grown
    on_journal: Callable[[str], None]

    def publish(self, spacecraft_id: str, effects: Iterable[ReleaseEffect], at: Instant) -> None:
        """Apply the effects of a step; products and journal entries have been stored with it."""
        kinds = {type(effect) for effect in effects}
        if JournalEffect in kinds:
            self.on_journal(spacecraft_id)
        for effect in effects:
            if isinstance(effect, AuditEffect):
                self._append(effect.action, f"/spacecraft/{spacecraft_id}/{effect.target}", at)
            elif isinstance(effect, PublishEffect) and effect.warning:
                _LOG.warning("release warning of %s: %s", spacecraft_id, effect.warning)
        if PublishEffect in kinds and self.feed.has_subscribers(spacecraft_id):
            self.feed.publish(spacecraft_id, (FeedEvent("status", Cursor(0, 0), None),))

    def _append(self, action: str, target: str, at: Instant) -> None:
        """Append an event of the interlock itself; the archive may be away, and control does not wait for it."""
        if CURRENT_NOTE.get() is not None:
            return
        nobody: dict[str, Any] = dict.fromkeys(("key_id", "role", "address", "request_id"), "")
        event = AuditEvent(at_us=at.now_us, who=_WHO, action=action, target=target, outcome=DONE, **nobody)
        try:
            self.audit.append(event)
        except SooError as error:
            _LOG.error("audit entry %s of %s could not be written: %s", action, target, error)
