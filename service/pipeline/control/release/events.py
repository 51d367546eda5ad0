"""Events of the release of torques, and the document of its state."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import Enum
from functools import cache
from operator import attrgetter
from types import NoneType, UnionType
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

from service.core.control.sign_check import SignState
from service.core.control.slew_schedule import Effect, Envelope, Triple
from service.pipeline.control.release.command_states import CommandTransition
from service.pipeline.control.release.interlock import Instant, Interlock
from service.pipeline.control.release.interlock_conditions import InterlockInputs, InterlockRow
from service.pipeline.estimation.method import CommandEvidence
from service.ports.archive import Outcome
from service.records.levels.attitude import ReleasedCommand, ReportedCommand
from service.records.operations.release import Command, InterlockHold, SignCheck, SignRatios, UplinkProduct


@dataclass(frozen=True, slots=True)
class SentImpulse:
    """Impulse that a release may put on the spacecraft: sum of the sizes of its pulses, yaw, roll, pitch."""

    at_us: int
    impulse_n_m_s: Triple


@dataclass(frozen=True, slots=True)
class ReleaseState:
    """Interlock, commands and sign check of one spacecraft; what is stored is enough to go on after a restart."""

    interlock: Interlock = field(default_factory=Interlock)
    #: open ones, unreported ones, and those that ended within an hour
    commands: tuple[Command, ...] = ()
    next_counter: int = 1
    #: of the last hour
    sent: tuple[SentImpulse, ...] = ()
    #: of the estimate that the newest release was computed from
    released_epoch_us: int = 0
    #: the newest, or the one that is running
    sign_check: SignCheck | None = None


class StoredRow(NamedTuple):
    """Results of one measurement, after they were stored."""

    outcome: Outcome
    evidence: CommandEvidence | None = None


@dataclass(frozen=True, slots=True)
class Refusal:
    """Refusal of an event: code and reason."""

    code: str
    detail: str


@dataclass(frozen=True, slots=True)
class Event:
    """Event of a release at an instant."""

    at: Instant


@dataclass(frozen=True, slots=True)
class Tick(Event):
    """Time passes."""


@dataclass(frozen=True, slots=True)
class RowSeen(Event):
    """A row of the method that drives control."""

    row: InterlockRow


@dataclass(frozen=True, slots=True)
class InputsChanged(Event):
    """An input of the interlock other than the rows has changed."""

    inputs: InterlockInputs


@dataclass(frozen=True, slots=True)
class ResponseJudged(Event):
    """Log-likelihood ratio of "no effect" or "reversed" to a command's own response, by the powers."""

    log_ratio: float


@dataclass(frozen=True, slots=True)
class SignJudged(Event):
    """Verdict of a sign check on an axis so far; yaw: of powers and wheel telemetry together."""

    #: yaw, roll or pitch
    axis: str
    verdict: SignState
    #: by the powers
    log_ratio: SignRatios | None = None
    #: yaw: the verdict by wheel telemetry
    wheels: str | None = None


@dataclass(frozen=True, slots=True)
class PrepareLeg(Event):
    """The next leg of the running sign check is due; a refusal says why there can be none."""

    leg: Command | Refusal


@dataclass(frozen=True, slots=True)
class Automatic(Event):
    """The control law requests a command under the standing authorisation."""

    command: Command


@dataclass(frozen=True, slots=True)
class Applied(Event):
    """A computed command counts as applied (release automatic): it has been published already."""

    effect: Effect


@dataclass(frozen=True, slots=True)
class AnglesFit(Event):
    """Angles are fit for a spacecraft that computes its torques on board."""

    product: UplinkProduct


@dataclass(frozen=True, slots=True)
class PersonalEvent(Event):
    """A person's order."""

    by: str


class OrderKind(Enum):
    """Orders of an operator to the interlock."""

    ARM = "arm"
    DISENGAGE = "disengage"
    RESET = "reset"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class Order(PersonalEvent):
    """An operator's order to the interlock."""

    kind: OrderKind


@dataclass(frozen=True, slots=True)
class Engage(PersonalEvent):
    """A person asks for standing authorisation; the second must be an approver and ask for the same."""

    until_us: int
    envelope: Envelope
    is_approver: bool


@dataclass(frozen=True, slots=True)
class Prepare(PersonalEvent):
    """An operator requests a command, given without counter and digest."""

    command: Command


@dataclass(frozen=True, slots=True)
class BeginSignCheck(PersonalEvent):
    """An operator starts the sign check of an axis with its first leg."""

    #: yaw, roll or pitch
    axis: str
    command: Command


@dataclass(frozen=True, slots=True)
class Confirm(PersonalEvent):
    """Another person confirms a prepared command."""

    counter: int
    digest: str
    is_approver: bool
    comment: str = ""


@dataclass(frozen=True, slots=True)
class Cancel(PersonalEvent):
    """An operator takes a prepared command back."""

    counter: int


@dataclass(frozen=True, slots=True)
class Report(Event):
    """The centre reports the fate of a released command."""

    counter: int
    #: SENT, EXECUTED or FAILED
    transition: CommandTransition
    #: executed part; None: all of it (EXECUTED), nothing (FAILED)
    executed_from_us: int | None = None
    executed_until_us: int | None = None
    by: str | None = None
    #: when it happened, by the centre; None: now
    reported_at_us: int | None = None


@dataclass(frozen=True, slots=True)
class JournalEffect:
    """Effect: an entry of the journal, known to the filter from then on."""

    entry: ReleasedCommand | ReportedCommand | InterlockHold


@dataclass(frozen=True, slots=True)
class UplinkEffect:
    """Effect: a product is given out for uplink, once."""

    product: UplinkProduct


@dataclass(frozen=True, slots=True)
class AuditEffect:
    """Effect: an audit event that no person caused."""

    action: str
    #: below the path of the spacecraft
    target: str


@dataclass(frozen=True, slots=True)
class PublishEffect:
    """Effect: listeners are notified of the new state; a warning goes to the log as well."""

    warning: str = ""


ReleaseEffect = JournalEffect | UplinkEffect | AuditEffect | PublishEffect


@dataclass(frozen=True, slots=True)
class Step:
    """State and effects that an event leads to; with a refusal no more than a tick does."""

    state: ReleaseState
    effects: tuple[ReleaseEffect, ...] = ()
    refusal: Refusal | None = None


def digest_of(counter: int, command: Command) -> str:
    """Return what a person confirms: SHA-256 of counter, estimate, start and pulses to the last bit."""
    pulses = ";".join(
        f"{pulse.start_us},{pulse.duration_s.hex()},{','.join(torque.hex() for torque in pulse.torque_n_m)}"
        for pulse in command.schedule
    )
    text = f"soo-command-2|{counter}|{command.attitude_epoch_us}|{command.start_us}|{pulses}"
    return hashlib.sha256(text.encode("ascii")).hexdigest()


#: what of the interlock may be lost
_FORGOTTEN = ("row", "inputs", "innovation_since_us", "clock", "good_since_us", "standing", "since")
_lasting = attrgetter(*(each.name for each in fields(Interlock) if each.name not in _FORGOTTEN))


def document_of(state: ReleaseState) -> str:
    """Return the text of a state; of its commands the counters, because their records are stored by themselves."""
    document = _plain(replace(state, commands=(), sign_check=None))
    document["commands"] = [command.counter for command in state.commands]
    return json.dumps({"state": document, "sign_check": _plain(state.sign_check)}, separators=(",", ":"))


def state_of(document: str, command_of: Callable[[int], Command]) -> ReleaseState:
    """Return the state of a text of `document_of`, that before the first event for an empty one.

    `command_of` gives the stored command of a counter. ValueError: the text is not that of a state.
    """
    if not document:
        return ReleaseState()
    try:
        stored = json.loads(document)
        counters: tuple[int, ...] = _read(tuple[int, ...], stored["state"].pop("commands"))
        state: ReleaseState = _read(ReleaseState, stored["state"])
        check: SignCheck | None = _read(SignCheck | None, stored["sign_check"])
    except (KeyError, TypeError, AttributeError) as error:
        message = f"the stored state of the release cannot be read: {error!r}"
        raise ValueError(message) from error
    return replace(state, commands=tuple(map(command_of, counters)), sign_check=check)


def essence(state: ReleaseState) -> tuple[object, ...]:
    """Return what of a state must not be lost; rows and inputs are read again after a restart."""
    check = state.sign_check
    # impulses are kept with the release that they belong to, likelihoods with the next leg
    kept = None if check is None else replace(check, log_ratio=None)
    own = state.commands, state.next_counter, state.released_epoch_us, kept
    return *_lasting(state.interlock), state.interlock.configuration, *own


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.name
    kind: Any = type(value)
    kinds = _kinds(kind)
    if kinds is not None:
        return {name: _plain(getattr(value, name)) for name in kinds}
    return [_plain(each) for each in value] if isinstance(value, tuple) else value


def _read(kind: Any, value: Any) -> Any:
    if get_origin(kind) is UnionType:
        if value is None:
            return None
        (kind,) = (each for each in get_args(kind) if each is not NoneType)
    if get_origin(kind) is tuple:
        first, *others = get_args(kind)
        each = (first,) * len(value) if Ellipsis in others else (first, *others)
        return tuple(_read(one, part) for one, part in zip(each, value, strict=True))
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind[value]
    kinds = _kinds(kind)
    if kinds is not None:
        return kind(**{name: _read(kinds[name], part) for name, part in value.items()})
    if not isinstance(value, (int, float) if kind is float else kind):
        message = f"{value!r} is no {kind.__name__}"
        raise TypeError(message)
    return float(value) if kind is float else value


@cache
def _kinds(kind: Any) -> Mapping[str, Any] | None:
    """Return the kind of each field of a record, None for what is no record."""
    return get_type_hints(kind) if is_dataclass(kind) or hasattr(kind, "_fields") else None
