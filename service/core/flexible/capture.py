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
    SwitchingLaw,
    require_law,
    require_mode,
    require_not_negative,
    require_positive,
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


#: locks were seen from here on, in units of beta; between 1 and this the relay switched irregularly
LOCK_RATIO = 1.9


class CaptureAnalysis(NamedTuple):
    """Limit of capture and the verdict on one oscillation."""

    #: "captured": the swing is above p_cr; "free": below; "always": any switching is captured
    verdict: str
    #: p_cr of equation (18), or of the timed pulse
    p_cr_rad: float
    #: less what the body still moves outward at half a period
    p_cr_refined_rad: float
    #: least amplitude found by following the motion, damping included
    p_min_rad: float
    #: p_cr less the swing; negative: captured
    margin_rad: float
    #: p_inf of a relay; 0 where nothing is pumped, as for timed pulses; infinite without damping
    p_inf_rad: float
    #: "none"; "irregular": between 1 and 1.9 beta; "possible": from 1.9 beta on, from some starts
    perpetual_capture: str
    #: frequencies without capture at one line at beta, for this swing and rate
    band: StableBand
    #: w_T of equation (26) at one line at beta; a rigid cycle slower than that is not captured
    rigid_frequency_rad_s: float
    #: C, the swing from peak to peak in units of beta
    swing: float


def analyse_capture(
    *,
    omega_rad_s: float,
    damping_ratio: float,
    coupling: float,
    inertia_kg_m2: float,
    motor_torque_n_m: float,
    friction_torque_n_m: float,
    alpha_rad: float,
    beta_rad: float,
    pulse_s: float,
    rate_rad_s: float = 0.0,
    amplitude_rad: float = 0.0,
    is_friction_outward: bool = True,
) -> CaptureAnalysis:
    """Return the boundary of capture and what it says of one swing.

    Parameters
    ----------
    omega_rad_s, damping_ratio, coupling : float
        w (rad/s), xi and kn of the mode; xi = 0, for which (12) to (20) are derived, is allowed.
    inertia_kg_m2, motor_torque_n_m, friction_torque_n_m : float
        Inertia of the axis; M_n; friction of the rotor at its momentum, ``M_T + M_v |H| / H_max``.
    alpha_rad, beta_rad : float
        Lines of release and of switching on.
    pulse_s : float, s
        Length of a pulse, infinite for a relay.
    rate_rad_s : float, rad/s
        Outward rate of the body at the switching; 0 is the safe assumption.
    amplitude_rad : float
        p0, swing of the mode at the hub before the switching.
    is_friction_outward : bool
        Friction turns the body toward the line. With a given motor torque the other way is the worse one: friction
        then adds to the pulse.

    Raises
    ------
    ValueError
        Something is not physical; the message says what and what to do.

    Examples
    --------
    >>> found = analyse_capture(
    ...     omega_rad_s=1.0, damping_ratio=0.01, coupling=0.5, inertia_kg_m2=1000.0, motor_torque_n_m=0.2,
    ...     friction_torque_n_m=0.00105, alpha_rad=0.0175, beta_rad=0.0349, pulse_s=float("inf"), rate_rad_s=1e-4,
    ... )
    >>> round(found.p_cr_rad, 9), found.verdict
    (0.00826619, 'free')
    """
    mode = HubMode(omega_rad_s, damping_ratio, coupling)
    require_mode(mode, may_be_undamped=True)
    law = SwitchingLaw(alpha_rad, beta_rad, pulse_s)
    require_law(law)
    for name, value in (("inertia_kg_m2", inertia_kg_m2), ("motor_torque_n_m", motor_torque_n_m)):
        require_positive(name, value)
    for name, value in (
        ("friction_torque_n_m", friction_torque_n_m),
        ("rate_rad_s", rate_rad_s),
        ("amplitude_rad", amplitude_rad),
    ):
        require_not_negative(name, value)
    passive_rad_s2 = (friction_torque_n_m if is_friction_outward else -friction_torque_n_m) / inertia_kg_m2
    pulse_rad_s2 = motor_torque_n_m / inertia_kg_m2 - passive_rad_s2
    if pulse_rad_s2 <= 0.0:
        raise ValueError(
            f"friction_torque_n_m {friction_torque_n_m:g} is not below motor_torque_n_m {motor_torque_n_m:g}: the "
            "motor cannot turn the body back; raise the motor's torque or lower the friction"
        )
    switch = SwitchOn(pulse_rad_s2, passive_rad_s2, rate_rad_s, alpha_rad, beta_rad, pulse_s)
    return _analyse(switch, mode, law, amplitude_rad)


def _analyse(switch: SwitchOn, mode: HubMode, law: SwitchingLaw, amplitude_rad: float) -> CaptureAnalysis:
    """Return the analysis of a switching that was found physical."""
    critical_rad = critical_amplitude_rad(switch, mode)
    perpetual_rad = perpetual_amplitude_rad(switch, mode) if law.is_relay else 0.0
    one_line = switch._replace(alpha_rad=switch.beta_rad)
    swing = 2.0 * amplitude_rad / switch.beta_rad
    return CaptureAnalysis(
        verdict="always" if critical_rad <= 0.0 else "captured" if amplitude_rad > critical_rad else "free",
        p_cr_rad=critical_rad,
        p_cr_refined_rad=critical_amplitude_rad(switch, mode, is_refined=True),
        p_min_rad=least_capturing_amplitude_rad(switch, mode),
        margin_rad=critical_rad - amplitude_rad,
        p_inf_rad=perpetual_rad,
        perpetual_capture=perpetual_level(perpetual_rad, switch.beta_rad),
        band=stable_band(one_line, mode.coupling, swing),
        rigid_frequency_rad_s=rigid_frequency_rad_s(one_line, mode, swing),
        swing=swing,
    )


def perpetual_level(perpetual_rad: float, beta_rad: float) -> str:
    """Return how near a relay is to holding its own oscillation."""
    if perpetual_rad >= LOCK_RATIO * beta_rad:
        return "possible"
    return "irregular" if perpetual_rad > beta_rad else "none"
