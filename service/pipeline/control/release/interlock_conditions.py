"""Conditions of the interlock, and the settings of the release."""

import math
from dataclasses import asdict, dataclass
from enum import Enum
from typing import NamedTuple

from service.core.control.slew_schedule import Envelope
from service.records.epoch import US_PER_S
from service.records.levels.attitude import NO_AXES, AttitudeRow, Axes, Status, TorqueCommand
from service.records.setting import CHOSEN, PUBLISHED, TUNED, setting


@dataclass(frozen=True, slots=True)
class ReleaseSettings:
    """Limits and times of the release."""

    angle_change_deg: float = setting(0.2, "a command may change an angle by this much, deg", CHOSEN)
    rate_change_deg_s: float = setting(3e-4, "and a rate by this much, deg/s", CHOSEN)
    impulse_n_m_s: float = setting(0.02, "sum of the sizes of a command's pulses about an axis, N m s", CHOSEN)
    impulse_an_hour_n_m_s: float = setting(0.1, "the same over what was sent within an hour, N m s", CHOSEN)
    stale_periods: float = setting(3.0, "an estimate is too old after this many row periods", CHOSEN)
    stale_margin_s: float = setting(30.0, "and so many seconds", CHOSEN)
    min_redundancy: int = setting(2, "fewer carriers beyond the unknowns inhibit", CHOSEN)
    ephemeris_ahead_s: float = setting(6 * 3600.0, "the ephemeris must reach this far ahead, s", CHOSEN)
    innovation_s: float = setting(1800.0, "innovations outside their band for this long inhibit, s", TUNED)
    good_s: float = setting(600.0, "an inhibition clears after this long without a reason, s", CHOSEN)
    momentum_share_limit: float = setting(
        0.8, "a wheel with more than this share of its greatest momentum trips", CHOSEN
    )
    clock_jump_s: float = setting(2.0, "the clock may differ from the steady one by this much, s", CHOSEN)
    missed_log_ratio: float = setting(9.0, "log-likelihood ratio with which a command's response is missed", TUNED)
    missed_beyond_log_ratio: float = setting(
        4.5, "the same where roll or pitch is beyond the range of automatic control; the filter acts on 5", TUNED
    )
    recovery_deg: float = setting(0.4, "roll or pitch beyond it: single commands by an approver, deg", PUBLISHED)
    hand_over_deg: float = setting(
        2.0, "roll or pitch beyond it, its sign in doubt: over to the sensor mode, deg", TUNED
    )
    entry_modes: str = setting(
        "any", "on-board modes from which control is entered, by commas; `any`: not looked at", CHOSEN
    )
    longest_authorisation_s: float = setting(12 * 3600.0, "a standing authorisation lasts this long at most, s", CHOSEN)
    request_s: float = setting(600.0, "the second person must follow the first within this, s", CHOSEN)
    prepared_s: float = setting(600.0, "a prepared command waits this long for its confirmation, s", CHOSEN)
    uplink_lead_s: float = setting(150.0, "no schedule begins sooner after its release, s", CHOSEN)
    confirm_s: float = setting(180.0, "time for a confirmation where nobody says when the schedule begins, s", CHOSEN)
    sign_confirm_s: float = setting(90.0, "the same for each slew of a sign check, s", CHOSEN)
    sign_check_s: float = setting(2700.0, "a sign check of roll or pitch ends undecided after this, s", TUNED)
    yaw_sign_check_s: float = setting(18_000.0, "and one of yaw after this, s", TUNED)
    yaw_sign_least_s: float = setting(10_800.0, "a sign check of yaw takes this long at least, s", TUNED)
    wheel_sigma_n_m_s: float = setting(0.002, "error of a change of a wheel's momentum in telemetry, N m s", CHOSEN)
    latest_stop_s: float = setting(7200.0, "a schedule must be over this long after its release, s", CHOSEN)
    max_unreported: int = setting(1, "released commands without a report at a time", CHOSEN)
    report_s: float = setting(600.0, "a report may come this long after the end of the schedule, s", CHOSEN)
    tick_s: float = setting(10.0, "time passes for the interlock at least this often, s", CHOSEN)

    @property
    def figures(self) -> dict[str, float | str]:
        """Return every setting by name, with long times in minutes and hours too, for texts."""
        reported = asdict(self)
        times = {name[:-1]: value for name, value in reported.items() if name.endswith("_s")}
        minutes = {f"{name}min": value / 60.0 for name, value in times.items()}
        hours = {f"{name}h": value / 3600.0 for name, value in times.items()}
        return {**reported, **minutes, **hours, "momentum_percent": 100.0 * self.momentum_share_limit}

    @property
    def allowed_modes(self) -> tuple[str, ...]:
        """Return the on-board modes from which control may be entered; none: they are not looked at."""
        modes = tuple(part.strip() for part in self.entry_modes.split(",") if part.strip())
        return () if modes == ("any",) else modes

    def stale_us(self, period_s: float, waiting_s: float = 0.0) -> int:
        """Return the age at which an estimate is too old; a person may look at it for some more seconds."""
        return microseconds(self.stale_periods * period_s + self.stale_margin_s + waiting_s)

    @property
    def envelope(self) -> Envelope:
        """Return the envelope beyond which no command goes."""
        return Envelope(self.angle_change_deg, self.rate_change_deg_s, self.impulse_n_m_s, self.impulse_an_hour_n_m_s)


def microseconds(seconds: float) -> int:
    """Return a duration in microseconds."""
    return round(seconds * US_PER_S)


class Consequence(Enum):
    """Consequence of a condition."""

    #: no torque; clears itself
    INHIBIT = "INHIBITED until 10 good minutes have passed"
    #: no torque until a person resets it
    TRIP = "TRIPPED until reset"
    #: the yaw torque is withheld, roll and pitch go on
    YAW = "no yaw torque; roll and pitch go on"
    ALARM = "alarm only"


class Condition(Enum):
    """Reasons of the interlock; the name in small letters is the word that programs see."""

    ESTIMATE_OLD = (Consequence.INHIBIT, "no estimate, or older than {stale_periods:g} periods + {stale_margin_s:g} s")
    ESTIMATOR = (Consequence.INHIBIT, "the estimator itself forbids control on the newest row")
    NOT_ALIGNED = (Consequence.INHIBIT, "no alignment holds")
    FADE = (Consequence.INHIBIT, "downlink fade")
    REDUNDANCY = (Consequence.INHIBIT, "fewer than {min_redundancy} carriers beyond the unknowns")
    GAP = (Consequence.INHIBIT, "the newest row came after a gap")
    OPERATION = (Consequence.INHIBIT, "a declared operation inhibits control")
    EPHEMERIS = (Consequence.INHIBIT, "a burn without a new ephemeris, or it ends within {ephemeris_ahead_h:g} h")
    INNOVATION = (Consequence.INHIBIT, "innovations outside their 99 % band for {innovation_min:g} min")
    ONBOARD_MODE = (Consequence.INHIBIT, "the on-board mode is not on the operator's list")
    REPORT_LATE = (Consequence.INHIBIT, "a released command ended {report_min:g} min ago without a report (alarm)")
    HAND_OVER = (
        Consequence.INHIBIT,
        "roll or pitch beyond {hand_over_deg:g} deg, its sign in doubt: over to the sensor mode (alarm)",
    )
    CLOCK_JUMP = (Consequence.TRIP, "the clock jumped by more than {clock_jump_s:g} s against the steady one")
    MOMENTUM = (
        Consequence.TRIP,
        "a wheel holds more than {momentum_percent:g} % of its greatest momentum, by two records",
    )
    RESPONSE_MISSED = (
        Consequence.TRIP,
        "a command did nothing or the reverse by the powers: ratio above {missed_log_ratio:g}, beyond "
        "{recovery_deg:g} deg {missed_beyond_log_ratio:g}",
    )
    ENVELOPE = (Consequence.TRIP, "the control law asked for more than the envelope")
    CONFIGURATION = (Consequence.TRIP, "calibration, carrier plan or spacecraft changed since control was armed")
    UNREPORTED = (Consequence.TRIP, "released commands without a report: more than {max_unreported}")
    LEASE = (Consequence.TRIP, "the estimator's lease is held twice")
    DOCUMENT_CORRUPT = (Consequence.TRIP, "a document that the estimate rests on differs from its digest")
    STOP = (Consequence.TRIP, "an operator stopped control")
    YAW_UNCERTAIN = (
        Consequence.YAW,
        "the estimator withholds yaw: it is too uncertain, and waiting costs nothing",
    )
    YAW_SIGN = (Consequence.YAW, "the sign of yaw is not proven")
    DISAGREEMENT = (Consequence.ALARM, "the methods disagree in roll or pitch, by the rule of the estimator")

    # that of Enum is a function of Python, and every row asks some hundred times
    __hash__ = object.__hash__

    def __init__(self, consequence: Consequence, meaning: str) -> None:
        self.consequence = consequence
        self.meaning = meaning
        #: name as programs see it
        self.word = self._name_.lower()

    def text(self, settings: ReleaseSettings) -> str:
        """Return when it stands, with the figures of some settings."""
        return self.meaning.format(**settings.figures)


class Measure(NamedTuple):
    """Quantity that a condition holds against a limit."""

    name: str
    unit: str
    #: the limit is the smallest good value; else the greatest
    is_least: bool = False


#: conditions that are judged by a number
MEASURES: dict[Condition, Measure] = {
    Condition.ESTIMATE_OLD: Measure("age of the newest estimate", "s"),
    Condition.FADE: Measure("downlink fade", "dB"),
    Condition.REDUNDANCY: Measure("carriers beyond the unknowns", "", is_least=True),
    Condition.EPHEMERIS: Measure("how far ahead the ephemeris reaches", "s", is_least=True),
    Condition.INNOVATION: Measure("time outside of the band", "s"),
    Condition.REPORT_LATE: Measure("time since the end of the oldest command without a report", "s"),
    Condition.HAND_OVER: Measure("greater of roll and pitch", "deg"),
    Condition.CLOCK_JUMP: Measure("jump of the clock", "s"),
    Condition.MOMENTUM: Measure("momentum of the fullest wheel", "%"),
    Condition.RESPONSE_MISSED: Measure("log-likelihood ratio", ""),
    Condition.UNREPORTED: Measure("released commands without a report", ""),
    Condition.LEASE: Measure("holders of the lease", ""),
}
#: conditions that lie in the newest row: without one they are not judged
OF_ROW = frozenset(
    {
        Condition.ESTIMATOR,
        Condition.FADE,
        Condition.REDUNDANCY,
        Condition.GAP,
        Condition.HAND_OVER,
        Condition.YAW_UNCERTAIN,
    }
)
#: reasons of the estimator that the interlock judges itself, by wider limits
OWN_AFFAIR = frozenset({"beyond_validity"})
#: and those that leave the sign of a large angle certain
_SIZE_ALONE = frozenset({*OWN_AFFAIR, "protection_level"})
#: conditions of the row under which it says itself whether the known torque may be balanced
BALANCED_CONDITIONS = frozenset({Condition.ESTIMATOR, Condition.FADE, Condition.REDUNDANCY})
#: an attitude has three unknowns
_UNKNOWNS = 3
#: conditions that raise an alarm as well
ALARMED = frozenset({Condition.REPORT_LATE, Condition.HAND_OVER, Condition.DISAGREEMENT})


@dataclass(frozen=True, slots=True)
class InterlockRow:
    """Newest attitude row of the method that drives control, as the interlock judges it."""

    epoch_us: int
    #: expected time to the next row
    period_s: float
    attitude_deg: Axes
    #: carriers beyond the unknowns
    redundancy: int
    is_fading: bool = False
    is_innovation_in_band: bool = True
    #: why the estimator forbids control
    inhibitions: tuple[str, ...] = ()
    #: whether the estimator lets yaw be controlled
    is_yaw_allowed: bool = False
    #: (yaw, roll, pitch) whose known torque may be balanced while control is inhibited
    balance_axes: tuple[bool, bool, bool] = NO_AXES
    #: (yaw, roll, pitch) whose sign is certain
    certain_axes: tuple[bool, bool, bool] = NO_AXES
    #: set by the interlock
    is_after_gap: bool = False


def interlock_row(
    row: AttitudeRow, command: TorqueCommand | None, period_s: float, *, is_innovation_in_band: bool
) -> InterlockRow:
    """Return the facts of a row of the method that drives control, and of the command that was computed from it.

    The next one is expected after `period_s`; a method without the statistic of innovations says that it is in band.
    """
    balance = NO_AXES if command is None else command.balance_allowed_axes
    not_acquired = () if row.status is Status.ACQUIRED else (row.status.value.lower(),)
    return InterlockRow(
        epoch_us=row.epoch_us,
        period_s=period_s,
        attitude_deg=row.attitude_deg,
        redundancy=row.carriers_used - _UNKNOWNS,
        is_fading=row.downlink_fade,
        is_innovation_in_band=is_innovation_in_band,
        inhibitions=(*row.inhibitions, *not_acquired),
        is_yaw_allowed=row.control_allowed_axes[0],
        # a row that control could use, again, in the minutes before control goes on
        balance_axes=row.control_allowed_axes if row.control_allowed else balance,
        certain_axes=certain_axes(row),
    )


def certain_axes(row: AttitudeRow) -> tuple[bool, bool, bool]:
    """Return the axes (yaw, roll, pitch) whose sign is certain: the angle exceeds its protection level."""
    yaw, roll, pitch = (level < abs(angle) for level, angle in zip(row.protection_deg, row.attitude_deg, strict=True))
    return yaw, roll, pitch


@dataclass(frozen=True, slots=True)
class InterlockInputs:
    """Inputs of the interlock other than the row."""

    is_aligned: bool = False
    onboard_mode: str | None = None
    has_inhibiting_operation: bool = False
    #: when the newest burn ended
    burn_stop_us: int | None = None
    ephemeris_received_us: int | None = None
    ephemeris_stop_us: int | None = None
    calibration_id: int | None = None
    plan_id: int | None = None
    #: version of the catalogue's inertia and wheels; signs are proven for one version
    spacecraft_version: int | None = None
    #: version of its control settings
    control_version: int | None = None
    #: of the fullest wheel; None: no telemetry
    momentum_share: float | None = None
    lease_holders: int = 1
    #: names of those in force that differ from their digests
    damaged_documents: tuple[str, ...] = ()
    #: whether the methods disagree, as the chain has found
    is_disagreeing: bool = False
    #: whether computed commands count as applied: then nobody arms
    is_automatic: bool = False


def own_affair(row: InterlockRow, settings: ReleaseSettings) -> frozenset[str]:
    """Return the estimator's reasons that do not inhibit the release after a row.

    Beyond the range of automatic release an angle is led back by single commands as long as its sign is certain.
    """
    return _SIZE_ALONE if _is_sign_certain(row, settings.recovery_deg) else OWN_AFFAIR


def _is_sign_certain(row: InterlockRow, beyond_deg: float) -> bool:
    """Return whether roll or pitch is beyond an angle, and its sign is certain wherever it is."""
    roll_deg, pitch_deg = abs(row.attitude_deg.roll), abs(row.attitude_deg.pitch)
    sizes = zip((roll_deg, pitch_deg), row.certain_axes[1:], strict=True)
    certain = [is_certain for size_deg, is_certain in sizes if size_deg > beyond_deg]
    return bool(certain) and all(certain)


def row_conditions(row: InterlockRow | None, now_us: int, settings: ReleaseSettings) -> dict[Condition, bool]:
    """Return which of the conditions that lie in the newest row stand."""
    if row is None:
        return {Condition.ESTIMATE_OLD: True}
    stale_us = settings.stale_us(row.period_s)
    # negated, so that what is not a number is bad
    return {
        # an estimate from the future is as little to be believed as an old one
        Condition.ESTIMATE_OLD: not -stale_us <= now_us - row.epoch_us <= stale_us,
        Condition.ESTIMATOR: not own_affair(row, settings).issuperset(row.inhibitions),
        Condition.FADE: row.is_fading,
        Condition.REDUNDANCY: row.redundancy < settings.min_redundancy,
        Condition.GAP: row.is_after_gap,
        Condition.HAND_OVER: not (
            greater_angle_deg(row.attitude_deg) <= settings.hand_over_deg
            or _is_sign_certain(row, settings.hand_over_deg)
        ),
        Condition.YAW_UNCERTAIN: not (row.is_yaw_allowed or row.inhibitions),
    }


def row_values(row: InterlockRow | None, now_us: int) -> dict[Condition, float]:
    """Return the values of `MEASURES` that lie in the newest row; NaN: not known."""
    if row is None:
        return {}
    return {
        Condition.ESTIMATE_OLD: abs(now_us - row.epoch_us) / US_PER_S,
        Condition.REDUNDANCY: row.redundancy,
        Condition.HAND_OVER: greater_angle_deg(row.attitude_deg),
    }


def greater_angle_deg(attitude_deg: Axes) -> float:
    """Return the greater size of roll and pitch; NaN where one is not known.

    Examples
    --------
    >>> greater_angle_deg(Axes(yaw=2.0, roll=-0.3, pitch=0.1))
    0.3
    """
    # NaN hides behind the greater of two numbers, depending on their order
    is_known = not (math.isnan(attitude_deg.roll) or math.isnan(attitude_deg.pitch))
    return max(abs(attitude_deg.roll), abs(attitude_deg.pitch)) if is_known else math.nan


def missed_limit(row: InterlockRow | None, settings: ReleaseSettings) -> float:
    """Return the log-likelihood ratio beyond which the response of commands is missed.

    Beyond the range of automatic control the filter's own belief is enough: single commands that it takes for reversed
    would lead a flipped axis out of the model before the ratio for all commands is reached.
    """
    return settings.missed_beyond_log_ratio if is_beyond(row, settings) else settings.missed_log_ratio


def is_beyond(row: InterlockRow | None, settings: ReleaseSettings) -> bool:
    """Return whether roll or pitch is known to be beyond the range of automatic release; what is not known inhibits."""
    if row is None:
        return False
    return any(abs(angle) > settings.recovery_deg for angle in (row.attitude_deg.roll, row.attitude_deg.pitch))


def condition_limits(row: InterlockRow | None, settings: ReleaseSettings) -> dict[Condition, float]:
    """Return the limits of `MEASURES`; that of an age needs the period of rows, a fade has none."""
    by_row = {} if row is None else {Condition.ESTIMATE_OLD: settings.stale_us(row.period_s) / US_PER_S}
    return {
        **by_row,
        Condition.REDUNDANCY: settings.min_redundancy,
        Condition.EPHEMERIS: settings.ephemeris_ahead_s,
        Condition.INNOVATION: settings.innovation_s,
        Condition.REPORT_LATE: settings.report_s,
        Condition.HAND_OVER: settings.hand_over_deg,
        Condition.CLOCK_JUMP: settings.clock_jump_s,
        Condition.MOMENTUM: 100.0 * settings.momentum_share_limit,
        Condition.RESPONSE_MISSED: missed_limit(row, settings),
        Condition.UNREPORTED: settings.max_unreported,
        Condition.LEASE: 1,
    }


def input_conditions(inputs: InterlockInputs, now_us: int, settings: ReleaseSettings) -> dict[Condition, bool]:
    """Return which of the conditions that lie in the other inputs stand."""
    modes, share = settings.allowed_modes, inputs.momentum_share
    return {
        Condition.NOT_ALIGNED: not inputs.is_aligned,
        Condition.OPERATION: inputs.has_inhibiting_operation,
        Condition.EPHEMERIS: _is_ephemeris_stale(inputs, now_us, settings),
        Condition.ONBOARD_MODE: bool(modes) and inputs.onboard_mode not in modes,
        # a momentum without telemetry trips nothing; one that is not a number does
        Condition.MOMENTUM: share is not None and not share <= settings.momentum_share_limit,
        Condition.LEASE: inputs.lease_holders > 1,
        Condition.DOCUMENT_CORRUPT: bool(inputs.damaged_documents),
        Condition.DISAGREEMENT: inputs.is_disagreeing,
    }


def input_values(inputs: InterlockInputs, now_us: int) -> dict[Condition, float]:
    """Return the values of `MEASURES` that lie in the other inputs."""
    values: dict[Condition, float] = {Condition.LEASE: inputs.lease_holders}
    # the clock of the data stands at zero before the first row
    if inputs.ephemeris_stop_us is not None and now_us > 0:
        values[Condition.EPHEMERIS] = (inputs.ephemeris_stop_us - now_us) / US_PER_S
    if inputs.momentum_share is not None:
        values[Condition.MOMENTUM] = 100.0 * inputs.momentum_share
    return values


def _is_ephemeris_stale(inputs: InterlockInputs, now_us: int, settings: ReleaseSettings) -> bool:
    """Return whether the orbit is not known well enough."""
    if inputs.ephemeris_stop_us is None or inputs.ephemeris_received_us is None:
        return True
    if inputs.ephemeris_stop_us - now_us < microseconds(settings.ephemeris_ahead_s):
        return True
    burn_us = inputs.burn_stop_us
    return burn_us is not None and burn_us <= now_us and inputs.ephemeris_received_us <= burn_us
