"""Capture of one axis by one mode: complete analysis from plain numbers."""

from typing import NamedTuple

from service.core.flexible.capture.capture import (
    StableBand,
    SwitchOn,
    critical_amplitude_rad,
    least_capturing_amplitude_rad,
    perpetual_amplitude_rad,
    rigid_frequency_rad_s,
    stable_band,
)
from service.core.flexible.spacecraft import (
    HubMode,
    require_mode,
    require_not_negative,
    require_positive,
)
from service.core.flexible.switching_law import SwitchingLaw, require_law

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
