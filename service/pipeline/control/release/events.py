"""What reaches the release, what it keeps, and what it answers: plain frozen records."""

import hashlib
from dataclasses import dataclass, field
from enum import Enum

from service.core.control.envelope import Envelope
from service.core.control.sign_check import SignState
from service.core.control.slew_schedule import AxisPulse, Effect, Triple
from service.pipeline.control.release.command_states import CommandState, CommandTransition
from service.pipeline.control.release.interlock import Instant, Interlock
from service.pipeline.control.release.interlock_conditions import InterlockInputs, RowFacts
from service.records.epoch import US_PER_S


@dataclass(frozen=True, slots=True)
class Proposal:
    """A schedule that somebody, or the law, wants to send."""

    #: of the estimate from which it was computed
    attitude_epoch_us: int
    #: when the schedule begins
    start_us: int
    pulses: tuple[AxisPulse, ...]
    #: against no command, at the end of its horizon
    effect: Effect
    #: of the flexible-response check: accept, warn or reject
    schedule_verdict: str
    reason: str = ""
    #: a turn by which a sign is proven: the filter is not told of its torque
    is_sign_check: bool = False

    @property
    def stop_us(self) -> int:
        """When the last pulse ends."""
        return self.start_us + round(US_PER_S * max((pulse.stop_s for pulse in self.pulses), default=0.0))


@dataclass(frozen=True, slots=True)
class CommandRecord:
    """One command and its life."""

    #: rises by one with each command of a spacecraft; the uplink product carries it
    counter: int
    life: CommandState
    proposal: Proposal
    digest: str
    prepared_by: str
    prepared_us: int
    expires_us: int
    is_automatic: bool = False
    confirmed_by: str | None = None
    released_us: int | None = None
    reported_us: int | None = None
    #: what of the schedule was carried out
    executed: tuple[AxisPulse, ...] = ()


@dataclass(frozen=True, slots=True)
class SentImpulse:
    """What a release may put on the craft: sum of the sizes of its pulses, yaw, roll, pitch."""

    at_us: int
    impulse_n_m_s: Triple


@dataclass(frozen=True, slots=True)
class ReleaseState:
    """Interlock and commands of one spacecraft; what is stored is enough to go on after a restart."""

    interlock: Interlock = field(default_factory=Interlock)
    #: open ones, unreported ones, and those that ended within an hour
    commands: tuple[CommandRecord, ...] = ()
    next_counter: int = 1
    #: of the last hour
    sent: tuple[SentImpulse, ...] = ()
    #: of the estimate that the newest release was computed from
    released_epoch_us: int = 0


@dataclass(frozen=True, slots=True)
class Tick:
    """Time passes."""

    at: Instant


@dataclass(frozen=True, slots=True)
class RowSeen:
    """A row of the method that drives control."""

    at: Instant
    row: RowFacts


@dataclass(frozen=True, slots=True)
class InputsChanged:
    """Something beside the rows has changed."""

    at: Instant
    inputs: InterlockInputs


@dataclass(frozen=True, slots=True)
class ResponseJudged:
    """How much likelier the powers make "no effect" or "reversed" than a command's own response."""

    at: Instant
    log_ratio: float


@dataclass(frozen=True, slots=True)
class SignJudged:
    """What a sign check says of an axis; yaw: of powers and wheel telemetry together."""

    at: Instant
    #: yaw, roll or pitch
    axis: str
    verdict: SignState


class OrderKind(Enum):
    """What an operator orders."""

    ARM = "arm"
    DISENGAGE = "disengage"
    RESET = "reset"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class Order:
    """An operator's order."""

    at: Instant
    by: str
    kind: OrderKind


@dataclass(frozen=True, slots=True)
class Engage:
    """A person asks for standing authorisation; the second must be an approver and ask for the same."""

    at: Instant
    by: str
    until_us: int
    envelope: Envelope
    is_approver: bool


@dataclass(frozen=True, slots=True)
class Prepare:
    """An operator wants a command prepared."""

    at: Instant
    by: str
    proposal: Proposal


@dataclass(frozen=True, slots=True)
class Confirm:
    """Another person confirms a prepared command."""

    at: Instant
    by: str
    counter: int
    digest: str
    is_approver: bool


@dataclass(frozen=True, slots=True)
class Cancel:
    """An operator takes a prepared command back."""

    at: Instant
    by: str
    counter: int


@dataclass(frozen=True, slots=True)
class Automatic:
    """The control law wants a command sent under the standing authorisation."""

    at: Instant
    proposal: Proposal


@dataclass(frozen=True, slots=True)
class Applied:
    """A computed command counts as applied (release automatic): whoever applies torques has been told of it."""

    at: Instant
    effect: Effect


@dataclass(frozen=True, slots=True)
class Report:
    """The centre tells what became of a released command."""

    at: Instant
    counter: int
    #: SENT, EXECUTED or FAILED
    turn: CommandTransition
    #: executed part; None: all of it (EXECUTED), nothing (FAILED)
    executed_from_us: int | None = None
    executed_until_us: int | None = None


Event = (
    Tick
    | RowSeen
    | InputsChanged
    | ResponseJudged
    | SignJudged
    | Order
    | Engage
    | Prepare
    | Confirm
    | Cancel
    | Automatic
    | Applied
    | Report
)


class ActionKind(Enum):
    """What the world must do after a step."""

    #: give the command out, once
    RELEASE = "release"
    #: the executed part is known input of the filter from now on
    KNOWN_INPUT = "known_input"
    #: the whole effect of the command is uncertainty of the filter
    UNCERTAIN = "uncertain"
    #: that uncertainty is over
    CERTAIN = "certain"
    ALARM = "alarm"
    STATE = "state"


@dataclass(frozen=True, slots=True)
class Action:
    """One thing to be done."""

    kind: ActionKind
    #: condition, state or reason
    detail: str
    counter: int | None = None


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why an event was illegal."""

    code: str
    detail: str


@dataclass(frozen=True, slots=True)
class Step:
    """What an event leads to; with a refusal no more than a tick does."""

    state: ReleaseState
    actions: tuple[Action, ...] = ()
    refusal: Refusal | None = None


def digest_of(counter: int, proposal: Proposal) -> str:
    """Return what a person confirms: SHA-256 of counter, estimate, start and pulses to the last bit."""
    pulses = ";".join(
        f"{pulse.axis},{pulse.start_s.hex()},{pulse.duration_s.hex()},{pulse.torque_n_m.hex()}"
        for pulse in proposal.pulses
    )
    text = f"soo-command-1|{counter}|{proposal.attitude_epoch_us}|{proposal.start_us}|{pulses}"
    return hashlib.sha256(text.encode("ascii")).hexdigest()
