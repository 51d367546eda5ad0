"""Release of torques as stored and answered: interlock, commands, uplink products. Triples by yaw, roll, pitch."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, NamedTuple

from service.records.levels.attitude import Axes, Pulse, ReleasedCommand, ReportedCommand, TorqueCommand


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
    state: Annotated[str, "running, plus (proven), minus, nothing, open, contradicted or interrupted."]
    started_us: int
    started_by: str
    until_us: Annotated[int, "It ends undecided then."]
    legs: int
    legs_done: Annotated[int, "Reported executed."]
    #: by the powers
    log_ratio: SignRatios | None = None
    wheels: Annotated[str | None, "Yaw: the same word by wheel telemetry."] = None
    #: why a leg could not be prepared, or why the check ended
    detail: str = ""
    #: counter of the leg that is prepared or out, and when the newest leg begins
    leg: int | None = None
    leg_start_us: int = 0
    #: pulses that were carried out of each leg
    flown: tuple[tuple[Pulse, ...], ...] = ()


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
    detail: Annotated[str, "Fault of the command; empty where there is none."] = ""
    #: by which it refuses
    code: str = ""


class Purpose(StrEnum):
    """Purpose of a command."""

    CONTROL = "control"
    #: the known torque alone, while control is inhibited
    BALANCE = "balance"
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

    state: CommandState = CommandState.PREPARED
    digest: Annotated[
        str, "Content that a second person confirms: SHA-256 of counter, estimate, start and pulses to the last bit."
    ] = ""
    #: rises by one with each command of a spacecraft: its id in paths and in the uplink product
    counter: int = 0
    expires_us: Annotated[int, "It cannot be confirmed from then on."] = 0
    purpose: Purpose = Purpose.CONTROL
    reason: str = ""
    #: only looked at: nothing is stored, the counter is the one that it would get
    is_dry_run: bool = False
    is_simulated: bool = False
    is_automatic: Annotated[bool, "Released by standing authorisation."] = False
    #: of the estimate that it was computed from
    attitude_epoch_us: int
    start_us: int
    stop_us: int
    #: in order of time, each about one axis
    schedule: tuple[Pulse, ...]
    #: of the flexible-response check: accept, warn or reject
    schedule_verdict: str = "accept"
    #: net
    impulse_n_m_s: Axes
    gross_impulse_n_m_s: Annotated[Axes, "Sum of the sizes of the pulses: what the envelope counts."]
    #: when the last pulse has ended
    angle_change_deg: Axes
    rate_change_deg_s: Axes
    peak_angle_deg: Annotated[Axes, "Greatest on the way, with sign."]
    peak_rate_deg_s: Axes
    wheel_momentum_n_m_s: Annotated[tuple[float, ...], "Change of the stored momentum of each wheel."]
    checks: Annotated[
        tuple[CommandCheck, ...], "As they were when it was prepared; all are made again when it is confirmed."
    ] = ()
    #: the computed command that it is, with its schedule check
    computed: TorqueCommand | None = None
    prepared_by: str = ""
    prepared_us: int = 0
    confirmed_by: str | None = None
    comment: str = ""
    released_us: int | None = None
    sent_us: int | None = None
    reported_us: int | None = None
    reported_by: str | None = None
    #: from when until when the report says it was carried out, as it says it
    told_executed_us: tuple[int | None, int | None] = (None, None)
    executed: Annotated[tuple[Pulse, ...], "Part of the schedule that was carried out, by report."] = ()

    @property
    def is_sign_check(self) -> bool:
        """Return whether its torque is kept from the filter, because it proves a sign."""
        return self.purpose is Purpose.SIGN_CHECK


class ProductForm(StrEnum):
    """Content of an uplink product: torques or angles."""

    #: mode ground: a released schedule
    TORQUES = "torques"
    #: mode onboard: angles
    ATTITUDE = "attitude"


@dataclass(frozen=True, slots=True)
class UplinkProduct:
    """Product for uplink through the centre's own channels; never changed once it is stored."""

    form: ProductForm
    counter: Annotated[
        int, "Torques: that of the command; angles: rises by one with each product. A receiver takes none twice."
    ]
    created_us: int
    valid_from_us: int
    valid_until_us: Annotated[int, "Not to be used from then on."]
    attitude_epoch_us: int
    is_simulated: Annotated[bool, "Of a simulated spacecraft: never to be sent to a real one."]
    #: of the command
    digest: str = ""
    schedule: Annotated[tuple[Pulse, ...], "Torque on the body; every element ends by itself."] = ()
    attitude_deg: Annotated[Axes | None, "Null about an axis that must not be controlled by it."] = None
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
