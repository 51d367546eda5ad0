"""Settings of the release interlock; the defaults are those of its table in the reference."""

from dataclasses import asdict, dataclass

from service.core.control.envelope import Envelope
from service.records.epoch import US_PER_S
from service.records.setting import CHOSEN, PUBLISHED, TUNED, setting


@dataclass(frozen=True, slots=True)
class ReleaseSettings:
    """Limits and times of the release."""

    angle_change_deg: float = setting(0.1, "a command may change an angle by this much, deg", CHOSEN)
    rate_change_deg_s: float = setting(3e-4, "and a rate by this much, deg/s", CHOSEN)
    impulse_n_m_s: float = setting(0.02, "sum of the sizes of a command's pulses about an axis, N m s", CHOSEN)
    impulse_an_hour_n_m_s: float = setting(0.1, "the same over what was sent within an hour, N m s", CHOSEN)
    stale_periods: float = setting(3.0, "an estimate is too old after this many row periods", CHOSEN)
    stale_margin_s: float = setting(30.0, "and so many seconds", CHOSEN)
    roll_sigma_limit_deg: float = setting(0.06, "a greater sigma of roll inhibits, deg", TUNED)
    pitch_sigma_limit_deg: float = setting(0.10, "a greater sigma of pitch inhibits, deg", TUNED)
    yaw_sigma_limit_deg: float = setting(0.20, "a greater sigma of yaw withholds the yaw torque, deg", TUNED)
    min_redundancy: int = setting(2, "fewer carriers beyond the unknowns inhibit", CHOSEN)
    ephemeris_ahead_s: float = setting(6 * 3600.0, "the ephemeris must reach this far ahead, s", CHOSEN)
    innovation_s: float = setting(1800.0, "innovations outside their band for this long inhibit, s", TUNED)
    good_s: float = setting(600.0, "an inhibition clears after this long without a reason, s", CHOSEN)
    momentum_share_limit: float = setting(
        0.8, "a wheel with more than this share of its greatest momentum trips", CHOSEN
    )
    clock_jump_s: float = setting(2.0, "the clock may differ from the steady one by this much, s", CHOSEN)
    missed_log_ratio: float = setting(9.0, "log-likelihood ratio with which a command's response is missed", TUNED)
    recovery_deg: float = setting(0.4, "roll or pitch beyond it: single commands by an approver, deg", PUBLISHED)
    hand_over_deg: float = setting(0.6, "roll or pitch beyond it: over to the sensor mode, deg", TUNED)
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
