"""Release of torques as stored and answered: interlock, commands, uplink products. Triples by yaw, roll, pitch."""

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from service.records.levels.attitude import Axes
from service.records.levels.command import Pulse, ReleasedCommand, ReportedCommand, TorqueCommand


@dataclass(frozen=True, slots=True)
class EnvelopeLimits:
    """Limits of a command about each axis."""

    angle_change_deg: float = 0.1
    rate_change_deg_s: float = 3e-4
    #: sum of the sizes of a command's pulses
    impulse_n_m_s: float = 0.02
    #: the same over everything that was sent within an hour
    impulse_an_hour_n_m_s: float = 0.1


@dataclass(frozen=True, slots=True)
class InterlockHold:
    """The interlock withholds torques from an instant on, or does not any more; an entry of the journal."""

    at_us: int
    #: of the interlock
    state: str
    reasons: tuple[str, ...]
    is_withheld: bool
    #: of the release's state that it came with
    version: int

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.version)


class SignRatios(NamedTuple):
    """Log-likelihood of each answer of a spacecraft against the best of them."""

    plus: float
    nothing: float
    minus: float


@dataclass(frozen=True, slots=True)
class SignCheck:
    """The newest sign check, or the one that is under way."""

    #: yaw, roll or pitch
    axis: str
    #: running, plus (proven), minus, nothing, open, contradicted, interrupted
    state: str
    started_us: int
    started_by: str
    #: when it ends undecided
    until_us: int
    legs: int
    #: reported executed
    legs_done: int
    #: by the powers
    log_ratio: SignRatios | None = None
    #: yaw: the same word by wheel telemetry
    wheels: str | None = None
    #: why a leg could not be prepared, or why the check ended
    detail: str = ""
    #: counter of the leg that is prepared or out, and when the newest leg begins
    leg: int | None = None
    leg_start_us: int = 0
    #: pulses that were carried out of each leg
    flown: tuple[tuple[Pulse, ...], ...] = ()


@dataclass(frozen=True, slots=True)
class ControlReason:
    """A reason why no torque may go, or why yaw is withheld."""

    code: str
    text: str
    #: since when it has stood without a break; None: not known
    since_us: int | None
    next_step: str


@dataclass(frozen=True, slots=True)
class ControlVerdict:
    """The one answer to the question whether a torque may go now."""

    is_allowed: bool
    #: INHIBITED, ARMED, ENGAGED, RECOVERY or TRIPPED
    state: str
    reasons: tuple[ControlReason, ...]


@dataclass(frozen=True, slots=True)
class ControlView:
    """View of the interlock of one spacecraft."""

    #: INHIBITED, ARMED, ENGAGED, RECOVERY or TRIPPED
    state: str
    since_us: int
    reasons: tuple[ControlReason, ...]
    #: latched until reset, a part of the reasons
    trips: tuple[str, ...]
    is_armed: bool
    #: whether computed commands are zeroed: from a trip until ten good minutes after its reset
    is_withheld: bool
    #: two_step or automatic
    release: str
    #: ground, onboard or off
    mode: str
    #: that of the authorisation, else that of the settings
    envelope: EnvelopeLimits
    authorised_by: tuple[str, ...]
    authorised_until_us: int | None
    #: who waits for a second person, and for what end of the authorisation
    requested_by: str | None
    requested_until_us: int | None
    proven_axes: tuple[str, ...]
    #: counters of commands that wait for a confirmation, and of those that wait for a report
    open_commands: tuple[int, ...]
    unreported_commands: tuple[int, ...]
    #: sum of the sizes of what was sent within the hour, N m s
    sent_impulse_n_m_s: Axes
    sign_check: SignCheck | None = None


@dataclass(frozen=True, slots=True)
class CommandRequest:
    """Command that a person requests; None: the default."""

    reason: str
    #: estimate that the person has looked at; None: the newest
    attitude_epoch_us: int | None = None
    #: when the schedule begins; None: as soon as the uplink allows
    start_us: int | None = None
    #: from the first pulse to the end of the last; None: the forecast horizon of the spacecraft's control
    duration_s: float | None = None
    max_torque_n_m: float | None = None


@dataclass(frozen=True, slots=True)
class CommandCheck:
    """One check of a command."""

    name: str
    is_ok: bool
    #: why it fails
    detail: str = ""
    #: by which it refuses
    code: str = ""


class Purpose(StrEnum):
    """What a command is for."""

    CONTROL = "control"
    #: a turn whose torque the filter does not get
    SIGN_CHECK = "sign_check"


class CommandState(StrEnum):
    """State of a command; `service.pipeline.control.release.command_states` says what moves it."""

    PREPARED = "PREPARED"
    CONFIRMED = "CONFIRMED"
    RELEASED = "RELEASED"
    SENT = "SENT"
    EXECUTED = "EXECUTED"
    FAILED = "FAILED"
    EXPIRED = "EXPIRED"
    CANCELLED = "CANCELLED"
    REJECTED = "REJECTED"


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """One command: pulses, effect, checks, persons and reports; before it is prepared without counter and digest."""

    #: rises by one with each command of a spacecraft: its id in paths and in the uplink product
    counter: int = 0
    state: CommandState = CommandState.PREPARED
    #: what a person confirms
    digest: str = ""
    purpose: Purpose = Purpose.CONTROL
    #: released by standing authorisation
    is_automatic: bool = False
    is_simulated: bool = False
    reason: str = ""
    prepared_by: str = ""
    prepared_us: int = 0
    #: it cannot be confirmed from then on
    expires_us: int = 0
    #: of the estimate that it was computed from
    attitude_epoch_us: int
    start_us: int
    stop_us: int
    #: in order of time, each about one axis
    schedule: tuple[Pulse, ...]
    #: of the flexible-response check: accept, warn or reject
    schedule_verdict: str = "accept"
    #: net, N m s
    impulse_n_m_s: Axes
    #: sum of the sizes of the pulses, N m s: what the envelope counts
    gross_impulse_n_m_s: Axes
    #: when the last pulse has ended
    angle_change_deg: Axes
    rate_change_deg_s: Axes
    #: greatest on the way, with sign
    peak_angle_deg: Axes
    peak_rate_deg_s: Axes
    #: (W,) N m s, change of stored momentum of each wheel
    wheel_momentum_n_m_s: tuple[float, ...]
    #: as they were when it was prepared
    checks: tuple[CommandCheck, ...] = ()
    #: the computed command that it is, with its schedule check
    computed: TorqueCommand | None = None
    confirmed_by: str | None = None
    comment: str = ""
    released_us: int | None = None
    sent_us: int | None = None
    reported_us: int | None = None
    reported_by: str | None = None
    #: from when until when the report says it was carried out, as it says it
    told_executed_us: tuple[int | None, int | None] = (None, None)
    #: what of the schedule was carried out
    executed: tuple[Pulse, ...] = ()
    #: only looked at: nothing is stored, the counter is the one that it would get
    is_dry_run: bool = False

    @property
    def is_sign_check(self) -> bool:
        """Return whether its torque is kept from the filter, because it proves a sign."""
        return self.purpose is Purpose.SIGN_CHECK


class ProductForm(StrEnum):
    """What an uplink product carries."""

    #: mode ground: a released schedule
    TORQUES = "torques"
    #: mode onboard: angles
    ATTITUDE = "attitude"


@dataclass(frozen=True, slots=True)
class UplinkProduct:
    """Product for uplink through the centre's own channels; never changed once it is stored."""

    form: ProductForm
    #: torques: that of the command; attitude: rises by one with each product
    counter: int
    created_us: int
    valid_from_us: int
    #: not to be used from then on
    valid_until_us: int
    attitude_epoch_us: int
    is_simulated: bool
    #: of the command
    digest: str = ""
    schedule: tuple[Pulse, ...] = ()
    attitude_deg: Axes | None = None
    sigma_deg: Axes | None = None


@dataclass(frozen=True, slots=True)
class StoredRelease:
    """Interlock and commands of one spacecraft as one document."""

    #: rises by one with each change; 0 before the first
    version: int = 0
    #: empty before the first
    document: str = ""
    #: process that stored it
    holder: str = ""


@dataclass(frozen=True, slots=True)
class ReleaseChange:
    """Records that are stored in one transaction."""

    document: str
    holder: str
    #: commands that are new or have changed
    commands: tuple[Command, ...] = ()
    products: tuple[UplinkProduct, ...] = ()
    #: of the journal
    entries: tuple[ReleasedCommand | ReportedCommand | InterlockHold, ...] = ()
