"""Settings of the release interlock; the defaults are those of its table in the reference."""

from dataclasses import asdict, dataclass

from service.core.control.envelope import Envelope
from service.records.epoch import US_PER_S


@dataclass(frozen=True, slots=True)
class ReleaseSettings:
    """Limits and times of the release."""

    #: envelope about each axis: beyond it no command goes, also a confirmed one
    angle_change_deg: float = 0.1
    rate_change_deg_s: float = 3e-4
    impulse_n_m_s: float = 0.02
    impulse_an_hour_n_m_s: float = 0.1
    #: an estimate is too old after this many row periods and so many seconds
    stale_periods: float = 3.0
    stale_margin_s: float = 30.0
    roll_sigma_limit_deg: float = 0.06
    pitch_sigma_limit_deg: float = 0.10
    yaw_sigma_limit_deg: float = 0.20
    min_redundancy: int = 2
    #: the ephemeris must reach this far ahead
    ephemeris_ahead_s: float = 6 * 3600.0
    #: innovations outside their band for this long inhibit
    innovation_s: float = 1800.0
    #: an inhibition clears after this long without a reason
    good_s: float = 600.0
    #: share of a wheel's greatest momentum
    momentum_share_limit: float = 0.8
    clock_jump_s: float = 2.0
    #: log-likelihood ratio with which a command's response is missed
    missed_log_ratio: float = 9.0
    #: roll or pitch beyond it: automatic release off; beyond the second: over to the sensor mode
    recovery_deg: float = 0.4
    hand_over_deg: float = 0.6
    #: on-board modes from which control may be entered, by commas; any: not looked at
    entry_modes: str = "any"
    longest_authorisation_s: float = 12 * 3600.0
    #: the second person must follow the first within this
    request_s: float = 600.0
    #: a prepared command waits this long for its confirmation
    prepared_s: float = 600.0
    #: the uplink needs this long: no schedule begins sooner after its release
    uplink_lead_s: float = 150.0
    #: persons are given this long before a schedule has to be released, where they do not say when it begins
    confirm_s: float = 180.0
    #: the same for each slew of a sign check: persons are at it
    sign_confirm_s: float = 90.0
    #: a sign check of roll or pitch ends undecided after this long; one of yaw after the second, and it takes the third
    sign_check_s: float = 2700.0
    yaw_sign_check_s: float = 18_000.0
    yaw_sign_least_s: float = 10_800.0
    #: error of a change of a wheel's momentum in telemetry, one standard deviation
    wheel_sigma_n_m_s: float = 0.002
    #: a schedule must be over this long after its release: what has gone out no trip can stop
    latest_stop_s: float = 7200.0
    #: commands that may be without a report at a time, and how long after their end
    max_unreported: int = 1
    report_s: float = 600.0
    #: time passes for the interlock at least this often
    tick_s: float = 10.0

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

    @property
    def envelope(self) -> Envelope:
        """Return the envelope beyond which no command goes."""
        return Envelope(self.angle_change_deg, self.rate_change_deg_s, self.impulse_n_m_s, self.impulse_an_hour_n_m_s)


def microseconds(seconds: float) -> int:
    """Return a duration in microseconds."""
    return round(seconds * US_PER_S)
