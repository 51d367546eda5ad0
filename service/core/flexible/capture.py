"""Elastic capture: motion that a flexible mode keeps from its limit cycle."""

import math
from typing import NamedTuple

import numpy as np

from service.core.flexible.propagation import (
    BodyState,
    MotionLeg,
    angle_and_rate_at,
    brent_root,
    start_leg,
    state_at,
    states_at,
)
from service.core.flexible.spacecraft import (
    HubMode,
)

#: points of half a period in the search for the lowest angle
_HALF_PERIOD_POINTS = 97


class SwitchOn(NamedTuple):
    """A switching on of the motor."""

    #: eps_a, net, against the motion
    pulse_rad_s2: float
    #: eps_c toward the line; negative where friction turns the body away from it (worse for a given motor, better for
    #: a given eps_a)
    passive_rad_s2: float
    #: theta', outward
    rate_rad_s: float
    alpha_rad: float
    beta_rad: float
    #: tau; infinite: relay
    pulse_s: float = math.inf


def critical_amplitude_rad(switch: SwitchOn, mode: HubMode, *, is_refined: bool = False) -> float:
    """Return p_cr, the amplitude of the swing before the switching above which it turns the motor off.

    Parameters
    ----------
    switch : SwitchOn
        A pulse shorter than half a period takes the form for a timed pulse.
    mode : HubMode
        Its damping is left out, which is safe: it raises p_cr by about 1.6 % at xi = 0.01.
    is_refined : bool
        Take off what the body still moves outward at half a period (relay).

    Returns
    -------
    float, rad
        Zero or below: any switching is captured.
    """
    omega = mode.omega_rad_s
    half_s = math.pi / omega
    if switch.pulse_s < half_s:
        return _timed_critical_rad(switch, mode, half_s)
    hysteresis_rad = switch.beta_rad - switch.alpha_rad
    lead_rad = switch.rate_rad_s / omega
    active = switch.pulse_rad_s2 / omega**2
    shifts_rad = active * (0.5 * math.pi**2 + 2.0 * mode.coupling)
    shifts_rad += 2.0 * mode.coupling * switch.passive_rad_s2 / omega**2
    critical_rad = 0.5 * (hysteresis_rad + math.pi * lead_rad - shifts_rad)
    if not is_refined or lead_rad <= math.pi * active:
        return critical_rad
    # the lowest angle comes before half a period is over
    swing_rad = critical_rad + (switch.pulse_rad_s2 + switch.passive_rad_s2) * mode.coupling / omega**2
    return critical_rad - (lead_rad - math.pi * active) ** 2 / (4.0 * (swing_rad - active))


def _timed_critical_rad(switch: SwitchOn, mode: HubMode, half_s: float) -> float:
    """Return p_cr of a pulse that ends before half a period is over."""
    rest_s = half_s - switch.pulse_s
    moved = switch.rate_rad_s * half_s + 0.5 * switch.passive_rad_s2 * rest_s**2
    moved -= switch.pulse_rad_s2 * switch.pulse_s * (half_s - 0.5 * switch.pulse_s)
    jump = mode.coupling * (switch.pulse_rad_s2 + switch.passive_rad_s2) / mode.omega_rad_s**2
    swung = jump * (1.0 + math.cos(mode.omega_rad_s * rest_s))
    return 0.5 * (switch.beta_rad - switch.alpha_rad + moved - swung)


def least_capturing_amplitude_rad(switch: SwitchOn, mode: HubMode) -> float:
    """Return the least p0 that turns the motor off within half a period, found by following the motion; 0: any does."""

    def clearance_rad(amplitude_rad: float) -> float:
        return lowest_angle_rad(switch, mode, amplitude_rad) - switch.alpha_rad

    if clearance_rad(0.0) <= 0.0:
        return 0.0
    high_rad = max(switch.beta_rad - switch.alpha_rad, abs(critical_amplitude_rad(switch, mode)))
    while clearance_rad(high_rad) > 0.0:
        high_rad *= 2.0
    return brent_root(clearance_rad, 0.0, high_rad)


def lowest_angle_rad(switch: SwitchOn, mode: HubMode, amplitude_rad: float) -> float:
    """Return the lowest angle that the sensor sees within half a period after switching on with a swing of p0."""
    static_rad = mode.coupling * switch.passive_rad_s2 / mode.omega_rad_s**2
    deflection_rad = static_rad + amplitude_rad
    start = BodyState(switch.beta_rad - deflection_rad, switch.rate_rad_s, deflection_rad)
    active = start_leg(start, mode, inertia_kg_m2=1.0, wheel_torque_n_m=-switch.pulse_rad_s2)
    half_s = math.pi / active.frequency_rad_s
    if switch.pulse_s >= half_s:
        return _lowest_rad(active, half_s)
    end = state_at(active, switch.pulse_s)
    passive = start_leg(end, mode, inertia_kg_m2=1.0, wheel_torque_n_m=switch.passive_rad_s2)
    return min(_lowest_rad(active, switch.pulse_s), _lowest_rad(passive, half_s - switch.pulse_s))


def _lowest_rad(leg: MotionLeg, duration_s: float) -> float:
    """Return the lowest angle of a leg: its end and every turn on the way."""
    times = np.linspace(0.0, duration_s, _HALF_PERIOD_POINTS)
    states = states_at(leg, times)
    rate = states[:, 1] + states[:, 3]

    def rate_at(t: float) -> float:
        return angle_and_rate_at(leg, t)[1]

    turns = np.flatnonzero((rate[:-1] < 0.0) & (rate[1:] > 0.0))
    low = [brent_root(rate_at, float(times[k]), float(times[k + 1])) for k in turns]
    # the start does not count: where alpha = beta it stands on the line of release and moves away from it
    reached = states_at(leg, np.array([*low, duration_s]))
    return float((reached[:, 0] + reached[:, 2]).min())


class StableBand(NamedTuple):
    """Frequencies of the mode at which a switching is not captured, between the two; no band: both NaN."""

    low_rad_s: float
    high_rad_s: float


def stable_band(switch: SwitchOn, coupling: float, swing: float) -> StableBand:
    """Return the band of frequencies without capture for one line (alpha = beta), figure 5.

    Parameters
    ----------
    switch : SwitchOn
        Its rate is that of the cycle, half the gain of a pulse.
    coupling : float
        kn.
    swing : float
        C: the swing from peak to peak in units of alpha, ``C alpha = 2 p``.

    Notes
    -----
    Not captured where ``C alpha w^2 - pi theta' w + B < 0``, ``B = 2 eps_a (kn + pi^2 / 4) + 2 kn eps_c``.
    """
    constant = 2.0 * switch.pulse_rad_s2 * (coupling + 0.25 * math.pi**2) + 2.0 * coupling * switch.passive_rad_s2
    slope = math.pi * switch.rate_rad_s
    square = swing * switch.alpha_rad
    if slope <= 0.0:
        return StableBand(math.nan, math.nan)
    if square == 0.0:
        return StableBand(constant / slope, math.inf)
    discriminant = slope * slope - 4.0 * square * constant
    if discriminant < 0.0:
        return StableBand(math.nan, math.nan)
    # without the difference of nearly equal numbers
    larger = 0.5 * (slope + math.sqrt(discriminant))
    return StableBand(constant / larger, larger / square)


def rigid_frequency_rad_s(switch: SwitchOn, mode: HubMode, swing: float) -> float:
    """Return w_T of equation (26), the frequency of the rigid cycle on the boundary of capture at one line.

    A cycle whose own frequency lies below it is not captured. With net torques ``M_a = I eps_a``, ``M_c = I eps_c`` the
    inertia cancels; ``C alpha = 2 p``. NaN where friction does not turn the body to the line: there is no such cycle.
    """
    if switch.passive_rad_s2 <= 0.0:
        return math.nan
    active, passive, omega = switch.pulse_rad_s2, switch.passive_rad_s2, mode.omega_rad_s
    boundary = swing * switch.alpha_rad * omega**2
    boundary += 2.0 * active * (mode.coupling + 0.25 * math.pi**2) + 2.0 * mode.coupling * passive
    return math.pi**2 * omega * active * passive / ((active + passive) * boundary)


def perpetual_amplitude_rad(switch: SwitchOn, mode: HubMode) -> float:
    """Return p_inf, at which a captured relay holds its own oscillation: what it pumps in, damping takes out.

    ``p_inf^2 = kn eps_a (beta - alpha) / (pi xi w^2)``. Locks were seen only where p_inf is 1.9 beta or more, and then
    from some starts only; none below beta. One line (alpha = beta) pumps nothing. Without damping nothing is taken out:
    infinite.
    """
    pumped = mode.coupling * switch.pulse_rad_s2 * (switch.beta_rad - switch.alpha_rad)
    if mode.damping_ratio == 0.0:
        return math.inf if pumped > 0.0 else 0.0
    return math.sqrt(pumped / (math.pi * mode.damping_ratio * mode.omega_rad_s**2))
