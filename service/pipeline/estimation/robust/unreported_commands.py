"""Released commands that nobody has reported: where the filter goes back to when a report comes.

Between release and report a command's whole effect is uncertain: its pulses act by a share among the filter's states.
When the report comes the filter goes back to where the command was released, takes what was executed as known from then
on and the rows again, so that detectors and faults too are those of a filter that always knew. Rows already told stay
as they were told. A command that takes the place of one before it, on board, takes it here: what that one had left
stays known until the new one is reported, and is part of what is uncertain. The law of this file: entries in the order
of the journal; the same entries give the same state.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from service.core.estimation.filtering.hidden_shares import with_share, without_shares
from service.pipeline.estimation.robust.method import RobustState
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.inputs.known_motion import heard, motions_of_released, without_replaced
from service.records.catalogue import Spacecraft
from service.records.inputs import Correction
from service.records.levels.attitude import AppliedCommand, Pulse, ReleasedCommand, ReportedCommand

#: rows that are kept to be taken again, an hour of rows a second; behind them the powers have told what happened
MAX_ROWS = 3600

#: what the filter did with a row or a change of its model
Step = Callable[[RobustState], RobustState]
Motion = Correction | AppliedCommand | ReportedCommand


@dataclass(frozen=True)
class ReportedMotion:
    """Motion or release known from the ground."""

    content: Motion | ReleasedCommand
    record: Spacecraft | None
    model: RobustModel


@dataclass(frozen=True)
class Branch:
    """State before the oldest command that is not reported, and all that happened since."""

    base: RobustState
    entries: tuple[ReportedMotion | Step, ...] = ()
    rows: int = 0


def open_branch(branch: Branch | None, state: RobustState, announced: ReportedMotion) -> Branch:
    """Return the branch with a release, begun at the state before it where there was none."""
    branch = branch or Branch(state)
    return replace(branch, entries=(*branch.entries, announced))


def stepped(branch: Branch, taken: Step) -> Branch:
    """Return the branch with a row, or a change of the model."""
    return replace(branch, entries=(*branch.entries, taken), rows=branch.rows + 1)


def apply_report(state: RobustState, announced: ReportedMotion) -> RobustState:
    """Return the state that has heard of a motion, or of a release whose effect is uncertain."""
    content, newest_us = announced.content, state.filter.epoch_us
    if isinstance(content, ReportedCommand):
        state = _with_replaced(state, content.counter, content.executed)
    if not isinstance(content, ReleasedCommand):
        return replace(state, commanded=heard(state.commanded, content, announced.record, newest_us))
    state = _with_replaced(state, content.counter, content.schedule)
    motion = motions_of_released(state.commanded, content, announced.record, newest_us)
    widened = with_share(announced.model.filter, state.filter, len(state.released))
    return replace(state, filter=widened, released=(*state.released, (content.counter, motion)))


def _with_replaced(state: RobustState, counter: int, schedule: Sequence[Pulse]) -> RobustState:
    """Return the state in which what is uncertain of earlier commands ends where the pulses of a later one begin."""
    newest_us = state.filter.epoch_us
    ended = ((n, without_replaced(motion, counter, schedule, newest_us)) for n, motion in state.released)
    return replace(state, released=tuple(ended))


def reported(branch: Branch, report: ReportedCommand) -> tuple[RobustState, Branch | None]:
    """Return state and branch after a report; the branch is None where nothing is uncertain any longer."""
    entries: list[ReportedMotion | Step] = []
    for entry in branch.entries:
        if not _is_release(entry, report.counter):
            entries.append(entry)
        elif isinstance(entry, ReportedMotion) and report.executed:
            entries.append(replace(entry, content=report))
    first = next((position for position, entry in enumerate(entries) if _is_release(entry)), len(entries))
    base = _taken(branch.base, entries[:first])
    if first == len(entries):
        return base, None
    left = tuple(entries[first:])
    return _taken(base, left), Branch(base, left, sum(not isinstance(entry, ReportedMotion) for entry in left))


def closed(state: RobustState, model: RobustModel) -> RobustState:
    """Return the state without its shares: what they have done stays uncertain until powers tell."""
    return replace(state, filter=without_shares(model.filter, state.filter, len(state.released)), released=())


def _taken(state: RobustState, entries: Sequence[ReportedMotion | Step]) -> RobustState:
    for entry in entries:
        state = apply_report(state, entry) if isinstance(entry, ReportedMotion) else entry(state)
    return state


def _is_release(entry: "ReportedMotion | Step", counter: int | None = None) -> bool:
    if not isinstance(entry, ReportedMotion) or not isinstance(entry.content, ReleasedCommand):
        return False
    return counter is None or entry.content.counter == counter
