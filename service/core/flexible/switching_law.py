"""Switching laws that use the angle alone, as tables.

Pulse law: lines L_n = beta + (n - 1) step, n = 1 to n_max. An outward arrival at the next line fires one pulse of tau
against the angle; still beyond the following line at its end, it fires again. The counter n goes back to zero where
the angle has fallen to alpha, or already at beta once n_max lines were used. Once they were, falling below L_n_max
arms that line again, and a body that goes on outward meets further lines at the same step (one line without a step has
none further: it lets go of a body that it could not turn). Relay: on at beta outward, off at alpha, no timer.

The text of the paper does not define its pulse law (the figure is lost); this one gives the objects that it names. That
lines go on beyond the last was found from basins of attraction: without it some starts never come back.
"""

import math
from enum import StrEnum
from typing import NamedTuple

from service.core.flexible.spacecraft import require_not_negative, require_positive


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
