"""Release of one spacecraft: an event is judged, what follows is stored, and only then does it hold.

Law of this file: the state that is seen is the stored one, up to what a restart may forget. Two processes on one
database cannot both store a step from the same state; the second one loads what the first has stored, and control
trips, for a release that two processes hold is held by none.
"""

import threading
import time
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial

from service.errors import ConflictError, NotFoundError, StorageError
from service.pipeline.control.release.advance import advance, restored
from service.pipeline.control.release.command_transitions import command_of
from service.pipeline.control.release.events import (
    Event,
    InputsChanged,
    JournalEffect,
    PersonalEvent,
    ReleaseEffect,
    ReleaseState,
    Report,
    Step,
    UplinkEffect,
)
from service.pipeline.control.release.interlock import Instant
from service.pipeline.control.release.settings import ReleaseSettings
from service.pipeline.control.release.state_document import document_of, essence, state_of
from service.ports import Releases
from service.records.epoch import US_PER_S
from service.records.levels.command import ReleasedCommand, ReportedCommand
from service.records.operations.audit import apart_from_request
from service.records.operations.release import Command, InterlockHold, ReleaseChange
from service.runtime.control.release_publisher import ReleasePublisher

#: another process that has stored counts as there for so long
_FOREIGN_US = 600 * US_PER_S
#: a state that matters is stored at least this often, so that a restart knows the time, s
_HEARTBEAT_S = 60.0
_ATTEMPTS = 3


@dataclass(eq=False)
class SpacecraftRelease:
    """Release of one spacecraft; StorageError ``release.unreadable`` where what is stored is no state."""

    #: of an existing one
    spacecraft_id: str
    #: where its state is stored
    releases: Releases
    #: gets the effects that are not stored here
    publisher: ReleasePublisher
    settings: ReleaseSettings
    #: this process
    holder: str

    def __post_init__(self) -> None:
        self._foreign_us: int | None = None
        #: newest epoch of which results are stored
        self.stored_us = 0
        self._stored_s = time.monotonic()
        #: an event and its storing are one
        self.lock = threading.RLock()
        self.state, self._version = self._loaded()

    def lease_holders(self, now_us: int) -> int:
        """Return how many processes have stored lately."""
        is_shared = self._foreign_us is not None and now_us - self._foreign_us < _FOREIGN_US
        return 2 if is_shared else 1

    def command(self, counter: int) -> Command:
        """Return a command as it is stored; NotFoundError ``command.unknown``."""
        return command_of(self.state, counter) or self.releases.command(self.spacecraft_id, counter)

    def handle(self, event: Event) -> Step:
        """Judge an event, store what follows, apply its effects, and return the step.

        StorageError ``release.busy`` where another process keeps storing, and those of the storage: nothing holds then.
        """
        with self.lock:
            for _ in range(_ATTEMPTS):
                step = self._judged(event)
                is_ordered = isinstance(event, PersonalEvent | Report) and step.refusal is None
                with nullcontext() if is_ordered else apart_from_request():
                    try:
                        self._store(step, event.at)
                    except ConflictError as error:
                        if error.code != "release.changed":
                            raise
                        self.state, self._version = self._loaded(event.at)
                        continue
                    self.publisher.publish(self.spacecraft_id, step.effects, event.at)
                    return step
            detail = f"another process changes the release of {self.spacecraft_id} too"
            raise StorageError("release.busy", detail)

    def _judged(self, event: Event) -> Step:
        """Return the step of an event; a lease that is held twice counts first."""
        before, now_us = self.state, event.at.now_us
        effects: tuple[ReleaseEffect, ...] = ()
        if self.lease_holders(now_us) > before.interlock.inputs.lease_holders:
            shared = InputsChanged(event.at, replace(before.interlock.inputs, lease_holders=2))
            first = advance(before, shared, self.settings)
            before, effects = first.state, first.effects
            if isinstance(event, InputsChanged):
                event = InputsChanged(event.at, replace(event.inputs, lease_holders=2))
        step = advance(before, event, self.settings)
        return replace(step, effects=(*effects, *step.effects))

    def _store(self, step: Step, at: Instant) -> None:
        """Store what a step must not lose, in one transaction; only then does the state hold."""
        known = {command.counter: command for command in self.state.commands}
        commands = tuple(each for each in step.state.commands if known.get(each.counter) != each)
        entries = tuple(self._numbered(each, at) for each in step.effects if isinstance(each, JournalEffect))
        products = tuple(each.product for each in step.effects if isinstance(each, UplinkEffect))
        is_same = essence(self.state) == essence(step.state)
        if not is_same or products or entries or self._is_due(step.state):
            change = ReleaseChange(document_of(step.state), self.holder, commands, products, entries)
            self._version = self.releases.save(self.spacecraft_id, self._version, change)
            self._stored_s = time.monotonic()
        self.state = step.state

    def _numbered(self, effect: JournalEffect, at: Instant) -> ReleasedCommand | ReportedCommand | InterlockHold:
        """Return a journal entry with the version that it is stored with."""
        entry = effect.entry
        if not isinstance(entry, InterlockHold):
            return entry
        # no row whose results are stored is later than the trip, also not one from a clock that is ahead
        return replace(entry, at_us=max(at.now_us, self.stored_us), version=self._version + 1)

    def _is_due(self, state: ReleaseState) -> bool:
        """Return whether a state that somebody relies on was stored long ago."""
        is_relied_on = state.interlock.is_armed or bool(state.interlock.trips) or bool(state.commands)
        return is_relied_on and time.monotonic() - self._stored_s > _HEARTBEAT_S

    def _loaded(self, at: Instant | None = None) -> tuple[ReleaseState, int]:
        """Return the stored state and its version, at an instant at which somebody else has changed it."""
        stored = self.releases.stored(self.spacecraft_id)
        if at is not None and stored.holder != self.holder:
            self._foreign_us = at.now_us
        try:
            state = state_of(stored.document, partial(self.releases.command, self.spacecraft_id))
        except (ValueError, NotFoundError) as error:
            raise StorageError("release.unreadable", f"{self.spacecraft_id}: {error}") from error
        return restored(state), stored.version
