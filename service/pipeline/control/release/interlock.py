"""The interlock: its memory, and how an instant or an order moves it through its table.

Law of this file: only `fire` changes the state, by a row of the table; what a state remembers follows from the row.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from service.core.control.slew_schedule import Envelope
from service.pipeline.control.release.command_states import UNREPORTED, Guard, State, Transition, Trigger, rows_of
from service.pipeline.control.release.interlock_conditions import (
    BALANCED_CONDITIONS,
    Condition,
    Consequence,
    InterlockInputs,
    InterlockRow,
    ReleaseSettings,
    input_conditions,
    is_beyond,
    microseconds,
    row_conditions,
)
from service.records.operations.release import Command


@dataclass(frozen=True, slots=True)
class Instant:
    """The service's clock and one that nobody sets, read together."""

    now_us: int
    #: None: not comparable, as after a restart
    steady_us: int | None


@dataclass(frozen=True, slots=True)
class Terms:
    """Terms of a standing authorisation."""

    until_us: int
    envelope: Envelope


@dataclass(frozen=True, slots=True)
class Request:
    """Request of a first person."""

    by: str
    at_us: int
    terms: Terms


@dataclass(frozen=True, slots=True)
class Authorisation:
    """Standing authorisation of two persons."""

    persons: tuple[str, str]
    terms: Terms


@dataclass(frozen=True, slots=True)
class Interlock:
    """State and memory of the interlock of one spacecraft."""

    state: State = State.INHIBITED
    since_us: int = 0
    row: InterlockRow | None = None
    inputs: InterlockInputs = field(default_factory=InterlockInputs)
    #: since when innovations have been outside their band; None: they are inside
    innovation_since_us: int | None = None
    clock: Instant | None = None
    #: since when no condition inhibits
    good_since_us: int | None = None
    is_armed: bool = False
    #: calibration, plan, spacecraft and control settings with which it was armed
    armed_with: tuple[int | None, ...] | None = None
    request: Request | None = None
    authorisation: Authorisation | None = None
    #: latched until reset
    trips: tuple[Condition, ...] = ()
    #: a trip was reset, and ten good minutes are not over: torques stay withheld
    is_after_reset: bool = False
    #: everything that stands at the newest instant
    standing: tuple[Condition, ...] = ()
    #: since when each reason has stood without a break
    since: tuple[tuple[str, int], ...] = ()
    #: axes whose sign is proven
    proven_axes: tuple[str, ...] = ()

    @property
    def tripping(self) -> tuple[Condition, ...]:
        """Conditions that stand and trip."""
        return tuple(each for each in self.standing if each.consequence is Consequence.TRIP)

    @property
    def inhibiting(self) -> tuple[Condition, ...]:
        """Conditions for which no torque may go."""
        return tuple(each for each in self.standing if each.consequence in _INHIBITING)

    @property
    def may_balance(self) -> bool:
        """Return whether commands may balance the known torque: nothing stands but what the row allows it under."""
        axes = (False,) if self.row is None else self.row.balance_axes
        return any(axes) and BALANCED_CONDITIONS.issuperset(self.inhibiting)

    @property
    def is_yaw_withheld(self) -> bool:
        """Return whether the yaw torque must be zero."""
        return any(condition.consequence is Consequence.YAW for condition in self.standing)

    @property
    def is_withholding(self) -> bool:
        """Return whether torques are withheld by a trip: from it until ten good minutes after its reset."""
        return self.state is State.TRIPPED or self.is_after_reset

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return the codes of the reasons that withhold torques or one axis."""
        words = [each.word for each in (*self.trips, *self.standing) if each is not Condition.DISAGREEMENT]
        words += () if self.row is None else self.row.inhibitions
        if self.state is State.INHIBITED and not self.is_armed and not self.inputs.is_automatic:
            words.append("not_armed")
        is_waiting = self.state in (State.INHIBITED, State.BALANCE) and (self.is_armed or self.is_after_reset)
        if is_waiting and not self.inhibiting:
            words.append("good_minutes")
        return tuple(dict.fromkeys(words))

    @property
    def configuration(self) -> tuple[int | None, ...]:
        """Versions that must not change while control is armed."""
        inputs = self.inputs
        return inputs.calibration_id, inputs.plan_id, inputs.spacecraft_version, inputs.control_version


#: places in the table of conditions
_ORDER = {condition: place for place, condition in enumerate(Condition)}
#: what withholds every torque
_INHIBITING = (Consequence.INHIBIT, Consequence.TRIP)


def settle(interlock: Interlock, at: Instant, commands: Sequence[Command], settings: ReleaseSettings) -> Interlock:
    """Return the interlock at an instant: conditions judged, and every change of state that follows."""
    standing = conditions_at(interlock, at, commands, settings)
    good_since_us = None if any(each.consequence in _INHIBITING for each in standing) else _good_since(interlock, at)
    settled = replace(interlock, standing=standing, clock=at, good_since_us=good_since_us)
    for trigger, is_due in _OF_TIME.items():
        if rows_of(settled.state, trigger) and is_due(settled, at, settings):
            settled = fire(settled, trigger, at, settings) or settled
    known = dict(interlock.since)
    since = tuple((word, known.get(word, at.now_us)) for word in settled.reasons)
    return settled if since == settled.since else replace(settled, since=since)


def conditions_at(
    interlock: Interlock, at: Instant, commands: Sequence[Command], settings: ReleaseSettings
) -> tuple[Condition, ...]:
    """Return everything that stands, in the order of the table of conditions."""
    unreported = [command for command in commands if command.state in UNREPORTED]
    oldest_us = min(map(unreported_since_us, unreported), default=None)
    stands = {
        **row_conditions(interlock.row, at.now_us, settings),
        **input_conditions(interlock.inputs, at.now_us, settings),
        Condition.INNOVATION: _has_lasted(interlock.innovation_since_us, at, settings.innovation_s),
        Condition.REPORT_LATE: _has_lasted(oldest_us, at, settings.report_s),
        Condition.UNREPORTED: len(unreported) > settings.max_unreported,
        Condition.CLOCK_JUMP: _has_jumped(interlock.clock, at, settings),
        Condition.CONFIGURATION: interlock.armed_with not in (None, interlock.configuration),
        # computed commands pass no check of the interlock: the estimator alone withholds their yaw torque
        Condition.YAW_SIGN: not interlock.inputs.is_automatic and "yaw" not in interlock.proven_axes,
    }
    return tuple(
        sorted((condition for condition, is_standing in stands.items() if is_standing), key=_ORDER.__getitem__)
    )


def unreported_since_us(command: Command) -> int:
    """Return since when the report of a released command could be there."""
    return max(command.stop_us, command.released_us or 0)


def fire(
    interlock: Interlock, trigger: Trigger, at: Instant, settings: ReleaseSettings, asked: Request | None = None
) -> Interlock | None:
    """Return the interlock after a trigger, None where no row of the table holds."""
    for row in rows_of(interlock.state, trigger):
        if _GUARDS[row.guard](interlock, at, settings, asked):
            since_us = at.now_us if row.target is not interlock.state else interlock.since_us
            return replace(_remembering(interlock, row, asked), state=row.target, since_us=since_us)
    return None


def tripped(interlock: Interlock, condition: Condition, at: Instant, settings: ReleaseSettings) -> Interlock:
    """Return the interlock after something that trips at one instant only."""
    latched = tuple(dict.fromkeys((*interlock.trips, condition)))
    moved = fire(interlock, Trigger.TRIP, at, settings) or interlock
    return replace(moved, trips=latched)


def _may_arm(interlock: Interlock, at: Instant, settings: ReleaseSettings) -> bool:
    """Return whether nothing has inhibited for the good minutes."""
    return not interlock.inhibiting and _has_lasted(interlock.good_since_us, at, settings.good_s)


def _good_since(interlock: Interlock, at: Instant) -> int:
    """Return since when no condition inhibits, moved with a clock that was set: the minutes count by the steady one."""
    before, since_us = interlock.clock, interlock.good_since_us
    if since_us is None or before is None:
        return at.now_us
    return since_us + (_shift_us(before, at) or 0)


def _has_lasted(since_us: int | None, at: Instant, seconds: float) -> bool:
    return since_us is not None and at.now_us - since_us >= microseconds(seconds)


def _is_second(former: Request | None, asked: Request | None, settings: ReleaseSettings) -> bool:
    """Return whether a request is that of another person for the same, in time."""
    if former is None or asked is None or former.by == asked.by or former.terms != asked.terms:
        return False
    return 0 <= asked.at_us - former.at_us <= microseconds(settings.request_s)


def _is_first(former: Request | None, asked: Request | None, settings: ReleaseSettings) -> bool:
    """Return whether a request is a first one: none is open, it is too old, or the same person asks again."""
    if former is None or asked is None or former.by == asked.by:
        return asked is not None
    return asked.at_us - former.at_us > microseconds(settings.request_s)


def _remembering(interlock: Interlock, row: Transition, asked: Request | None) -> Interlock:
    """Return the interlock with what a transition makes it remember and forget."""
    if row.trigger is Trigger.TRIP:
        return replace(_disarmed(interlock), trips=tuple(dict.fromkeys((*interlock.trips, *interlock.tripping))))
    if row.trigger is Trigger.ARM:
        return replace(interlock, is_armed=True, armed_with=interlock.configuration)
    if row.trigger is Trigger.ENGAGE:
        return _engaged(interlock, row, asked)
    if row.trigger is Trigger.DISENGAGE and row.target is State.INHIBITED:
        return _disarmed(interlock)
    if row.trigger in (Trigger.BEYOND, Trigger.EXPIRE, Trigger.DISENGAGE) or row.target is State.RECOVERY:
        return replace(interlock, authorisation=None, request=None)
    if row.trigger is Trigger.RESET:
        return replace(interlock, trips=(), good_since_us=None, is_after_reset=True)
    if row.guard is Guard.AFTER_RESET:
        return replace(interlock, is_after_reset=False)
    return replace(interlock, request=None)


def _disarmed(interlock: Interlock) -> Interlock:
    return replace(interlock, is_armed=False, armed_with=None, request=None, authorisation=None)


def _engaged(interlock: Interlock, row: Transition, asked: Request | None) -> Interlock:
    """Return the interlock with a request kept, or joined to an authorisation."""
    if row.guard is not Guard.SECOND_PERSON or interlock.request is None or asked is None:
        return replace(interlock, request=asked)
    authorisation = Authorisation((interlock.request.by, asked.by), asked.terms)
    return replace(interlock, request=None, authorisation=authorisation)


def _has_jumped(before: Instant | None, at: Instant, settings: ReleaseSettings) -> bool:
    """Return whether the clock moved otherwise than the steady one; after a restart only a step back is seen."""
    if before is None:
        return False
    allowed_us = microseconds(settings.clock_jump_s)
    shift_us = _shift_us(before, at)
    return at.now_us < before.now_us - allowed_us if shift_us is None else abs(shift_us) > allowed_us


def _shift_us(before: Instant, at: Instant) -> int | None:
    """Return by how much the clock was set between two instants, None where the steady one is not known."""
    if before.steady_us is None or at.steady_us is None:
        return None
    return (at.now_us - before.now_us) - (at.steady_us - before.steady_us)


def _has_ended(interlock: Interlock, at: Instant) -> bool:
    return interlock.authorisation is not None and at.now_us >= interlock.authorisation.terms.until_us


#: triggers that an instant may bring about, in the order in which they fire, and whether it does
_OF_TIME: dict[Trigger, Callable[[Interlock, Instant, ReleaseSettings], bool]] = {
    Trigger.TRIP: lambda interlock, _at, _settings: bool(interlock.tripping),
    Trigger.EXPIRE: lambda interlock, at, _settings: _has_ended(interlock, at),
    Trigger.LAPSE: lambda interlock, _at, _settings: not interlock.may_balance,
    Trigger.INHIBIT: lambda interlock, _at, _settings: bool(interlock.inhibiting),
    Trigger.CLEAR: _may_arm,
    Trigger.BEYOND: lambda interlock, _at, settings: is_beyond(interlock.row, settings),
    Trigger.WITHIN: lambda interlock, _at, settings: not (interlock.inhibiting or is_beyond(interlock.row, settings)),
}
#: whether guards let a transition happen
_GUARDS: dict[Guard, Callable[[Interlock, Instant, ReleaseSettings, Request | None], bool]] = {
    Guard.ALWAYS: lambda *_: True,
    Guard.BEYOND_AND_ARMED: lambda interlock, _, settings, __: (
        interlock.is_armed and is_beyond(interlock.row, settings)
    ),
    Guard.AUTHORISED: lambda interlock, *_: interlock.authorisation is not None,
    Guard.ARMED: lambda interlock, *_: interlock.is_armed,
    Guard.AFTER_RESET: lambda interlock, *_: interlock.is_after_reset,
    Guard.MAY_BALANCE: lambda interlock, *_: interlock.may_balance,
    Guard.MAY_ARM_BEYOND: lambda interlock, at, settings, _: (
        is_beyond(interlock.row, settings) and _may_arm(interlock, at, settings)
    ),
    Guard.MAY_ARM: lambda interlock, at, settings, _: _may_arm(interlock, at, settings),
    Guard.SECOND_PERSON: lambda interlock, _, settings, asked: _is_second(interlock.request, asked, settings),
    Guard.FIRST_PERSON: lambda interlock, _, settings, asked: _is_first(interlock.request, asked, settings),
    Guard.NO_TRIP_STANDS: lambda interlock, *_: not interlock.tripping,
}
