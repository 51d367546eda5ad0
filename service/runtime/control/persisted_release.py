"""Release of one spacecraft: an event is judged, what follows is stored, and only then does it hold.

Law of this file: the state that is seen is the stored one, up to what a restart may forget. Two processes on one
database cannot both store a step from the same state; who comes second takes up what the other one has stored, and
control trips, for a release that two processes hold is held by none.
"""

import threading
import time
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

from service.errors import ConflictError, StorageError
from service.pipeline.control.release.advance import advance, restored
from service.pipeline.control.release.events import (
    Action,
    ActionKind,
    Cancel,
    CommandRecord,
    Confirm,
    Engage,
    Event,
    InputsChanged,
    Order,
    Prepare,
    ReleaseState,
    Report,
    Step,
)
from service.pipeline.control.release.interlock import Instant
from service.pipeline.control.release.settings import ReleaseSettings
from service.pipeline.control.release.state_document import ReleaseMemory, document_of, essence, memory_of
from service.ports import Releases
from service.records.epoch import US_PER_S
from service.records.levels.command import ReleasedCommand, ReportedCommand
from service.records.operations.audit import apart_from_request
from service.records.operations.release import (
    CommandView,
    InterlockHold,
    ReleaseChange,
    SignCheckView,
    StoredRelease,
    UplinkProduct,
)
from service.runtime.control.views import Dress, changed_view, released_entry, reported_entry, torque_product

#: another process that has stored counts as there for so long
_FOREIGN_US = 600 * US_PER_S
#: a state that matters is stored at least this often, so that a restart knows the time, s
_HEARTBEAT_S = 60.0
_ATTEMPTS = 3

Entry = ReleasedCommand | ReportedCommand | InterlockHold


@dataclass(frozen=True, slots=True)
class Annex:
    """What belongs to an event beside what the interlock looks at."""

    #: of a command that it makes
    dress: Dress | None = None
    #: of commands that it changes, by counter: fields of their records
    notes: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)
    products: tuple[UplinkProduct, ...] = ()


class PersistedRelease:
    """Release of one spacecraft.

    Parameters
    ----------
    releases : Releases
        Where it is kept.
    spacecraft_id : str
        An existing spacecraft.
    holder : str
        This process.

    Raises
    ------
    StorageError
        ``release.unreadable``: what is stored is no state of this program.
    """

    def __init__(self, releases: Releases, spacecraft_id: str, holder: str) -> None:
        self._releases = releases
        self._spacecraft_id = spacecraft_id
        self._holder = holder
        self._memory = ReleaseMemory()
        self._version = 0
        self._views: dict[int, CommandView] = {}
        self._foreign_us: int | None = None
        #: newest epoch of which results are stored
        self.stored_us = 0
        self._stored_s = time.monotonic()
        #: events and their storing are one
        self.lock = threading.RLock()
        self._take_up(releases.stored(spacecraft_id))

    @property
    def state(self) -> ReleaseState:
        """State after the newest event."""
        return self._memory.state

    @property
    def sign_check(self) -> SignCheckView | None:
        """The newest sign check."""
        return self._memory.sign_check

    def lease_holders(self, now_us: int) -> int:
        """Return how many processes have stored lately."""
        is_shared = self._foreign_us is not None and now_us - self._foreign_us < _FOREIGN_US
        return 2 if is_shared else 1

    def view(self, counter: int) -> CommandView:
        """Return a command as it is stored; NotFoundError ``command.unknown``."""
        if counter not in self._views:
            self._views[counter] = self._releases.command(self._spacecraft_id, counter)
        return self._views[counter]

    def step(
        self, event: Event, settings: ReleaseSettings, annex: Annex | None = None
    ) -> tuple[Step, tuple[Entry, ...]]:
        """Judge an event, store what follows, and return both with what entered the journal.

        StorageError ``release.busy`` where another process keeps storing, and those of the storage: nothing holds then.
        """
        with self.lock:
            for _ in range(_ATTEMPTS):
                step = self._judged(event, settings)
                try:
                    with nullcontext() if is_order(event, step) else apart_from_request():
                        return step, self._keep(step, event.at, annex or Annex())
                except ConflictError as error:
                    if error.code != "release.changed":
                        raise
                    self._yield_to_other(event.at)
            raise _busy(self._spacecraft_id)

    def put(self, at: Instant, sign_check: SignCheckView | None, product: UplinkProduct | None = None) -> None:
        """Store how far a sign check is, and an uplink product that no command brought about; errors as `step`."""
        with self.lock:
            try:
                products = () if product is None else (product,)
                self._store(replace(self._memory, sign_check=sign_check), (), products, ())
            except ConflictError as error:
                self._yield_to_other(at)
                raise _busy(self._spacecraft_id) from error

    def _judged(self, event: Event, settings: ReleaseSettings) -> Step:
        """Return the step of an event, of a lease that is held twice as well."""
        before = self.state
        told: tuple[Action, ...] = ()
        if self.lease_holders(event.at.now_us) > before.interlock.inputs.lease_holders:
            inputs = replace(before.interlock.inputs, lease_holders=2)
            first = advance(before, InputsChanged(event.at, inputs), settings)
            before, told = first.state, first.actions
            if isinstance(event, InputsChanged):
                event = InputsChanged(event.at, replace(event.inputs, lease_holders=2))
        step = advance(before, event, settings)
        return replace(step, actions=(*told, *step.actions))

    def _keep(self, step: Step, at: Instant, annex: Annex) -> tuple[Entry, ...]:
        """Store what a step must not lose, and hold it."""
        before = self.state
        memory = replace(self._memory, state=step.state)
        known = {command.counter: command for command in before.commands}
        records = [command for command in step.state.commands if known.get(command.counter) != command]
        views = tuple(self._view_of(record, annex) for record in records)
        entries = self._entries(step, at)
        products = (*annex.products, *self._products(step, views))
        is_same = essence(before) == essence(step.state)
        if is_same and not products and not entries and not self._is_due(step.state):
            self._memory = memory
            return ()
        self._store(memory, views, products, entries)
        for view in views:
            self._views[view.counter] = view
        return entries

    def _store(
        self,
        memory: ReleaseMemory,
        views: tuple[CommandView, ...],
        products: tuple[UplinkProduct, ...],
        entries: tuple[Entry, ...],
    ) -> None:
        """Store a memory and what came with it; only then is it this case's."""
        change = ReleaseChange(document_of(memory), self._holder, views, products, entries)
        self._version = self._releases.save(self._spacecraft_id, self._version, change)
        self._memory = memory
        self._stored_s = time.monotonic()

    def _view_of(self, record: CommandRecord, annex: Annex) -> CommandView:
        """Return a command as it is to be stored."""
        if record.counter >= self.state.next_counter:
            if annex.dress is None:
                message = f"command {record.counter} was made without what belongs to it"
                raise ValueError(message)
            view = annex.dress.view(record)
        else:
            view = changed_view(self.view(record.counter), record)
        return replace(view, **annex.notes.get(record.counter, {}))

    def _entries(self, step: Step, at: Instant) -> tuple[Entry, ...]:
        """Return what the estimator must be told: releases, reports, and whether torques are withheld."""
        entries: list[Entry] = []
        for action in step.actions:
            record = _record(step.state, action)
            if record is None or record.proposal.is_sign_check:
                continue
            if action.kind is ActionKind.RELEASE:
                entries.append(released_entry(record))
            elif action.kind is ActionKind.CERTAIN:
                entries.append(reported_entry(record))
        interlock = step.state.interlock
        is_withheld = interlock.is_withholding
        if is_withheld is not self.state.interlock.is_withholding:
            # no row whose results are stored is later than the trip, also not one from a clock that is ahead
            at_us, word, version = max(at.now_us, self.stored_us), interlock.state.name, self._version + 1
            entries.append(InterlockHold(at_us, word, interlock.reasons, is_withheld, version))
        return tuple(entries)

    def _products(self, step: Step, views: tuple[CommandView, ...]) -> tuple[UplinkProduct, ...]:
        """Return what goes up because of a step."""
        simulated = {view.counter: view.is_simulated for view in views}
        released = [_record(step.state, action) for action in step.actions if action.kind is ActionKind.RELEASE]
        return tuple(torque_product(each, is_simulated=simulated[each.counter]) for each in released if each)

    def _is_due(self, state: ReleaseState) -> bool:
        """Whether a state that somebody relies on was stored long ago."""
        is_relied_on = state.interlock.is_armed or bool(state.interlock.trips) or bool(state.commands)
        return is_relied_on and time.monotonic() - self._stored_s > _HEARTBEAT_S

    def _yield_to_other(self, at: Instant) -> None:
        """Take up what another process, or this one without knowing, has stored."""
        stored = self._releases.stored(self._spacecraft_id)
        if stored.holder != self._holder:
            self._foreign_us = at.now_us
        self._take_up(stored)

    def _take_up(self, stored: StoredRelease) -> None:
        """Go on from what is stored; a sign check that was under way is over."""
        try:
            memory = memory_of(stored.document)
        except ValueError as error:
            raise StorageError("release.unreadable", f"{self._spacecraft_id}: {error}") from error
        check = memory.sign_check
        if check is not None and check.state == "running":
            check = replace(check, state="interrupted", detail="the service was started anew")
        self._memory = ReleaseMemory(restored(memory.state), check)
        self._version = stored.version
        self._views.clear()


def is_order(event: Event, step: Step) -> bool:
    """Whether a step is what a person ordered, and not what time, rows or a refusal brought along."""
    return isinstance(event, Order | Engage | Prepare | Confirm | Cancel | Report) and step.refusal is None


def _record(state: ReleaseState, action: Action) -> CommandRecord | None:
    """Return the command that an action is about."""
    return next((command for command in state.commands if command.counter == action.counter), None)


def _busy(spacecraft_id: str) -> StorageError:
    return StorageError("release.busy", f"another process changes the release of {spacecraft_id} too; try again")
