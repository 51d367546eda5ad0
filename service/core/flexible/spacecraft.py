"""One axis of a spacecraft with a wheel and one flexible mode, and the laws that switch its wheel."""

import math
from enum import StrEnum
from typing import NamedTuple


class WheelDrive(NamedTuple):
    """Inertia of the axis and what turns it."""

    inertia_kg_m2: float
    #: M_n, motor torque while switched on
    motor_torque_n_m: float
    #: M_T, dry friction of the rotor
    dry_friction_n_m: float = 0.0
    #: M_v, viscous and ventilation loss at the momentum limit
    viscous_loss_n_m: float = 0.0
    #: H_max
    momentum_limit_n_m_s: float = 20.0
    #: H0, momentum of the rotor where the body's rate is zero
    momentum_n_m_s: float = 0.0
    #: M_B, external torque on the body
    external_torque_n_m: float = 0.0


class HubMode(NamedTuple):
    """One tone of the panels as the hub feels it; without a mode the body is rigid."""

    omega_rad_s: float
    #: xi
    damping_ratio: float
    #: kn, share of the hub's acceleration that drives the tone
    coupling: float


class Accelerations(NamedTuple):
    """Net accelerations of one-sided motion, magnitudes."""

    #: eps_c, rad/s^2: friction of the rotor, turns the body against the sign of the momentum
    passive_rad_s2: float
    #: eps_a, rad/s^2: a pulse against it
    pulse_rad_s2: float
    #: c, 1/s: viscous loss over momentum limit
    viscous_rate_1_s: float


def accelerations(drive: WheelDrive) -> Accelerations:
    """Return eps_c, eps_a and c; dry friction keeps the sign of the momentum at rest.

    Raises
    ------
    ValueError
        The motor is not stronger than the friction.

    Examples
    --------
    >>> drive = WheelDrive(1000.0, 0.2, 1e-3, 1e-4, momentum_n_m_s=10.0)
    >>> [f"{value:.5g}" for value in accelerations(drive)]
    ['1.05e-06', '0.00019895', '5e-06']
    """
    require_drive(drive)
    viscous_rate_1_s = drive.viscous_loss_n_m / drive.momentum_limit_n_m_s
    friction_n_m = drive.dry_friction_n_m + viscous_rate_1_s * abs(drive.momentum_n_m_s)
    passive_rad_s2 = friction_n_m / drive.inertia_kg_m2
    pulse_rad_s2 = drive.motor_torque_n_m / drive.inertia_kg_m2 - passive_rad_s2
    if pulse_rad_s2 <= 0.0:
        raise ValueError(
            f"friction of {friction_n_m:g} N m is not below the motor torque of {drive.motor_torque_n_m:g} N m: "
            "no pulse can turn the body; raise motor_torque_n_m or lower the friction"
        )
    return Accelerations(passive_rad_s2, pulse_rad_s2, viscous_rate_1_s)


def require_drive(drive: WheelDrive) -> None:
    """Refuse a drive that cannot exist; ValueError says which number and what to do."""
    for name in ("inertia_kg_m2", "motor_torque_n_m", "momentum_limit_n_m_s"):
        require_positive(name, getattr(drive, name))
    for name in ("dry_friction_n_m", "viscous_loss_n_m"):
        require_not_negative(name, getattr(drive, name))
    require_finite("external_torque_n_m", drive.external_torque_n_m)
    require_finite("momentum_n_m_s", drive.momentum_n_m_s)
    if abs(drive.momentum_n_m_s) > drive.momentum_limit_n_m_s:
        raise ValueError(
            f"momentum_n_m_s is {drive.momentum_n_m_s:g}, beyond momentum_limit_n_m_s {drive.momentum_limit_n_m_s:g}; "
            "unload the wheel or correct the limit"
        )


def require_mode(mode: HubMode, *, may_be_undamped: bool = False) -> None:
    """Refuse a mode that cannot exist, one without damping among them unless the question allows it."""
    require_positive("omega_rad_s", mode.omega_rad_s)
    require_not_negative("coupling", mode.coupling)
    if not 0.0 < mode.damping_ratio < 1.0 and not (may_be_undamped and mode.damping_ratio == 0.0):
        raise ValueError(
            f"damping_ratio is {mode.damping_ratio:g}, it must lie between 0 and 1, "
            f"{'1' if may_be_undamped else 'both'} excluded; "
            "every panel damps (0.001 to 0.02 is usual), and an overdamped one does not oscillate"
        )


def require_positive(name: str, value: float) -> None:
    """Refuse what is not a finite number above zero."""
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} is {value:g}, it must be a finite number above 0")


def require_not_negative(name: str, value: float) -> None:
    """Refuse what is not a finite number, zero or above."""
    if not (math.isfinite(value) and value >= 0.0):
        raise ValueError(f"{name} is {value:g}, it must be a finite number, 0 or above")


def require_finite(name: str, value: float) -> None:
    """Refuse NaN and infinity."""
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value:g}, it must be a finite number")


class Arm(StrEnum):
    """Arming state of the regulator."""

    #: no pulse counted, both sides watched
    NEUTRAL = "neutral"
    #: some lines used
    COUNTING = "counting"
    #: n_max lines used or more, not yet fallen below the last
    FULL = "full"
    #: fallen below the last line after all were used: it is armed again
    CAPPED = "capped"
    #: motor on until the timer ends
    FIRING = "firing"
    #: relay on until the angle has fallen to alpha
    RELAY_ON = "relay_on"


class SwitchingLaw(NamedTuple):
    """Lines and pulses of a law."""

    #: control is released here
    alpha_rad: float
    #: control begins here, L_1
    beta_rad: float
    #: tau; infinite: relay
    pulse_s: float
    #: n_max
    pulse_count: int = 1
    #: Delta_n
    line_step_rad: float = 0.0

    @property
    def is_relay(self) -> bool:
        """Return whether the motor runs until the angle has fallen to alpha."""
        return math.isinf(self.pulse_s)

    @property
    def last_line_rad(self) -> float:
        """Return L_n_max."""
        return self.beta_rad + (self.pulse_count - 1) * self.line_step_rad

    def next_line_rad(self, counter: int) -> float:
        """Return the line that fires next; infinite where there is none."""
        if counter >= self.pulse_count and self.line_step_rad == 0.0:
            return math.inf
        return self.beta_rad + counter * self.line_step_rad


class CrossingWatch(NamedTuple):
    """A line to be watched while the regulator waits, and what follows its crossing."""

    #: "line" fires on an outward arrival; "alpha", "beta", "last" on falling below
    line: str
    to: Arm


#: what is watched in each state; the first crossing in time counts
WATCHES: dict[Arm, tuple[CrossingWatch, ...]] = {
    Arm.NEUTRAL: (CrossingWatch("line", Arm.FIRING),),
    Arm.COUNTING: (CrossingWatch("line", Arm.FIRING), CrossingWatch("alpha", Arm.NEUTRAL)),
    Arm.FULL: (CrossingWatch("line", Arm.FIRING), CrossingWatch("last", Arm.CAPPED)),
    Arm.CAPPED: (CrossingWatch("line", Arm.FIRING), CrossingWatch("beta", Arm.NEUTRAL)),
    Arm.FIRING: (),
    Arm.RELAY_ON: (CrossingWatch("alpha", Arm.NEUTRAL),),
}


def counter_after(arm: Arm, counter: int, law: SwitchingLaw) -> int:
    """Return how many lines count as used on entering a state."""
    if arm is Arm.NEUTRAL:
        return 0
    if arm is Arm.CAPPED:
        return law.pulse_count - 1
    return counter + 1 if arm in {Arm.FIRING, Arm.RELAY_ON} else counter


def arm_after_pulse(counter: int, law: SwitchingLaw) -> Arm:
    """Return the state at the end of a pulse."""
    return Arm.FULL if counter >= law.pulse_count else Arm.COUNTING


def require_law(law: SwitchingLaw) -> None:
    """Refuse a law that cannot switch; ValueError says which number and what to do."""
    require_positive("alpha_rad", law.alpha_rad)
    if not (math.isfinite(law.beta_rad) and law.alpha_rad <= law.beta_rad):
        raise ValueError(
            f"alpha_rad {law.alpha_rad:g} is not at or below beta_rad {law.beta_rad:g}: control would be released "
            "before it begins; beta is where it switches on, alpha where it is released"
        )
    if not law.pulse_s > 0.0:
        raise ValueError(f"pulse_s is {law.pulse_s:g}, it must be above 0 (infinite for a relay)")
    if law.pulse_count < 1:
        raise ValueError(f"pulse_count is {law.pulse_count}, it must be 1 or more")
    require_not_negative("line_step_rad", law.line_step_rad)
    if law.pulse_count > 1:
        require_positive("line_step_rad", law.line_step_rad)
