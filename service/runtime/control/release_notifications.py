"""Who is told of what the release has stored: the estimator of new journal entries, streams, and the audit log."""

import logging
from collections.abc import Callable

from service.errors import SooError
from service.pipeline.control.release.events import ActionKind, Step
from service.pipeline.control.release.interlock import Instant
from service.ports import Audit
from service.records.catalogue import Spacecraft
from service.records.operations.audit import CURRENT_NOTE, DONE, AuditEvent
from service.runtime.live.live_feed import Cursor, FeedEvent, LiveFeed

_LOG = logging.getLogger("soo.release")

#: who did what nobody ordered
_WHO = "interlock"


class ReleasePublisher:
    """Tells of what was stored.

    Parameters
    ----------
    audit : Audit
        What happened by itself is entered; what a person did, the request's own release tells.
    feed : LiveFeed
        Streams look at the state anew.
    on_journal : callable
        Told the spacecraft whose journal has grown.
    """

    def __init__(self, audit: Audit, feed: LiveFeed, on_journal: Callable[[str], None]) -> None:
        self._audit = audit
        self._feed = feed
        self._on_journal = on_journal

    def told(self, spacecraft: Spacecraft, step: Step, at: Instant, *, has_entries: bool) -> None:
        """Tell of a step that is stored."""
        if has_entries:
            self._on_journal(spacecraft.id)
        for action in step.actions:
            if action.kind is ActionKind.RELEASE and action.detail == "authorised":
                self._enter("release_torque", f"/spacecraft/{spacecraft.id}/torques/{action.counter}", at)
            elif action.kind is ActionKind.STATE:
                self._enter(f"interlock_{action.detail.lower()}", f"/spacecraft/{spacecraft.id}/control", at)
            elif action.kind is ActionKind.ALARM:
                _LOG.warning("release of %s: %s", spacecraft.id, action.detail)

    def changed(self, spacecraft_id: str) -> None:
        """Let streams look at the state."""
        if self._feed.has_subscribers(spacecraft_id):
            self._feed.publish(spacecraft_id, (FeedEvent("status", Cursor(0, 0), None),))

    def _enter(self, action: str, target: str, at: Instant) -> None:
        """Enter a event of the interlock itself; the archive may be away, and control does not wait for it."""
        if CURRENT_NOTE.get() is not None:
            return
        event = AuditEvent(
            at_us=at.now_us,
            who=_WHO,
            key_id="",
            role="",
            address="",
            action=action,
            target=target,
            outcome=DONE,
            request_id="",
        )
        try:
            self._audit.append(event)
        except SooError as error:
            _LOG.error("%s of %s is not in the audit log: %s", action, target, error)
