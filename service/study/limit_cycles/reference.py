"""Parameters of the paper and figures of an independent study of it, as printed there: what is to be reproduced.

Source of the parameters: L. V. Severova, S. P. Severov, "On the analysis of the orientation of deformable spacecraft".
Its figures are lost to us and it prints no table; the numbers here come from an independent implementation.
"""

import math
from typing import NamedTuple

from service.core.flexible.spacecraft import SwitchingLaw, WheelDrive

ALPHA_RAD, BETA_RAD = 0.0175, 0.0349
#: of the base drive, rad/s^2
PASSIVE_RAD_S2, PULSE_RAD_S2 = 1.05e-6, 1.9895e-4
BASE = WheelDrive(
    inertia_kg_m2=1000.0,
    motor_torque_n_m=0.2,
    dry_friction_n_m=1e-3,
    viscous_loss_n_m=1e-4,
    momentum_limit_n_m_s=20.0,
    momentum_n_m_s=10.0,
)


class CycleCase(NamedTuple):
    """One limit cycle: what makes it and what was printed."""

    drive: WheelDrive
    law: SwitchingLaw
    speed_rad_s: float
    rate_rad_s: float
    period_s: float
    inner_rad: float
    outer_rad: float
    multiplier: float


def law_of(pulse_count: int = 1, line_step_rad: float = 0.0, pulse_s: float = 1.0) -> SwitchingLaw:
    """Return the law of the paper's lines."""
    return SwitchingLaw(ALPHA_RAD, BETA_RAD, pulse_s, pulse_count, line_step_rad)


def _drive(**changes: float) -> WheelDrive:
    """Return the base drive with some numbers changed."""
    return BASE._replace(**changes)


#: drive, law
_AXES = {
    "A0": (BASE, law_of()),
    "A1": (_drive(dry_friction_n_m=2e-4), law_of()),
    "A2": (_drive(viscous_loss_n_m=2e-3, momentum_n_m_s=0.05), law_of()),
    "A3": (_drive(viscous_loss_n_m=4e-3, momentum_n_m_s=0.05), law_of()),
    "A4": (BASE, law_of(pulse_s=2.0)),
    "B1": (BASE, law_of(3, 1.5e-3)),
    "B2": (BASE, law_of(3, 2e-3)),
    "B3": (BASE, law_of(3, 3e-3)),
    "C1": (BASE, law_of(5, 1e-3)),
    "C2": (BASE, law_of(5, 1.5e-3)),
}
#: T1: speed, rate, period, inner, outer, multiplier
_PRINTED = {
    "A0": (9.945937607e-5, 9.949062385e-5, 190.4761905, 0.03018795619, 0.03492486090, -1.009914),
    "A1": (9.980858298e-5, 9.994141669e-5, 800.0, 0.01494993994, 0.03492493551, -0.999833),
    "A2": (9.917079406e-5, 9.982417310e-5, 199.0049751, 0.02997461318, 0.03492471047, -0.996788),
    "A3": (9.884485224e-5, 1.001450171e-4, 198.0198020, 0.02999915982, 0.03492454811, -0.983830),
    "A4": (1.988875041e-4, 1.990124952e-4, 380.9523810, 0.01605179408, 0.03499941218, -1.009273),
    "B1": (7.937124638e-5, 1.322063054e-4, 571.4285714, 0.02807340647, 0.03791893183, -1.013634),
    "B2": (6.971189511e-5, 1.447358696e-4, 571.4285714, 0.02691995128, 0.03891769730, -0.984387),
    "B3": (3.794292902e-5, 1.797795713e-4, 571.4285714, 0.02250040359, 0.04091632869, -0.709550),
    "C1": (7.169840881e-5, 1.354135810e-4, 952.3809524, 0.02716441693, 0.03891719279, -1.026547),
    "C2": (4.673072932e-5, 1.625009777e-4, 952.3809524, 0.02381895325, 0.04091510512, -0.928057),
}
CYCLES = {name: CycleCase(*_AXES[name], *printed) for name, printed in _PRINTED.items()}

#: closed forms of A0: with viscous loss, without, of the truncated (23)
CLOSED_MULTIPLIERS = (-1.009917, -1.010555, -0.989500)
#: dry friction: M_v,crit exact and by formula, N m
CRITICAL_LOSSES = {1e-3: (1.511378e-3, 1.5151e-3), 5e-4: (3.764142e-4, 3.7688e-4)}
#: momentum at rest with which they were printed, N m s
CRITICAL_MOMENTUM_N_M_S = 0.05

#: T2: set, speed, speed of the next arrival
SUCCESSIONS = (
    ("A0", 2e-5, 1.793135859e-4),
    ("A0", 5e-5, 1.492276306e-4),
    ("A0", 8e-5, 1.190767562e-4),
    ("A0", 1.2e-4, 7.865690913e-5),
    ("A0", 1.6e-4, 3.727830490e-5),
    ("B3", 2e-5, 4.513404679e-5),
    ("B3", 5e-5, 2.552417102e-5),
    ("B3", 1.2e-4, 3.699214340e-5),
    ("C2", 2e-5, 6.193063103e-5),
    ("C2", 5e-5, 4.350275444e-5),
    ("C2", 5e-4, 2.764227487e-5),
)
TRUNCATED_SUCCESSIONS = ((5e-5, 1.496495907e-4), (1.2e-4, 8.026207074e-5))
#: arrivals one and two of C2 after one at 5e-4
FOLLOWED_ARRIVALS = (5e-4, (2.764227487e-5, 5.930757230e-5))
#: set, start, returns, speed then
APPROACHES = (
    ("B2", 2e-5, 200, 6.873341e-5),
    ("B2", 1.2e-4, 200, 6.957866e-5),
    ("B2", 5e-4, 200, 6.910828e-5),
    ("C2", 2e-5, 200, CYCLES["C2"].speed_rad_s),
    ("C2", 1.2e-4, 200, CYCLES["C2"].speed_rad_s),
    ("C2", 5e-4, 200, CYCLES["C2"].speed_rad_s),
    ("B3", 1.2e-4, 100, CYCLES["B3"].speed_rad_s),
)
#: of 60 starts from 5e-6 to 6e-4, those within 1 % of the cycle after 600 returns
BASINS = {"B2": 60, "B3": 21, "C2": 28}
BASIN_RETURNS = 600
#: A0 with lines 1 mrad apart from 1e-4: least and greatest speed of 3000 arrivals
WANDERING = (1e-3, 1e-4, 3000, (1.9e-6, 1.974e-4))


class CaptureCase(NamedTuple):
    """One boundary of capture: what makes it and what was printed."""

    omega_rad_s: float
    coupling: float
    damping_ratio: float
    rate_rad_s: float
    alpha_rad: float
    beta_rad: float
    pulse_s: float
    formula_rad: float
    least_rad: float


def _two_lines(
    omega: float, coupling: float, xi: float, rate: float, formula: float, least: float | None = None
) -> CaptureCase:
    found = formula if least is None else least
    return CaptureCase(omega, coupling, xi, rate, ALPHA_RAD, BETA_RAD, math.inf, formula, found)


def _one_line(omega: float, coupling: float, formula: float, least: float | None = None) -> CaptureCase:
    """Return a relay with one line, at the rate of cycle A."""
    case = _two_lines(omega, coupling, 0.0, 9.9475e-5, formula, least)
    return case._replace(beta_rad=ALPHA_RAD)


#: T3
CAPTURES = (
    _two_lines(0.2, 0.5, 0.0, 1e-3, 1.781745411e-3),
    _two_lines(0.25, 0.5, 0.0, 1e-4, -1.259126517e-4, 0.0),
    _two_lines(0.5, 0.2, 0.0, 1e-4, 6.890601470e-3),
    _two_lines(0.5, 0.5, 0.0, 1e-4, 6.650601470e-3),
    _two_lines(0.5, 0.5, 0.005, 1e-4, 6.650601470e-3, 6.705930800e-3),
    _two_lines(0.5, 1.0, 0.0, 1e-4, 6.250601470e-3),
    _two_lines(1.0, 0.5, 0.0, 1e-4, 8.266190184e-3),
    _two_lines(1.0, 0.5, 0.01, 1e-4, 8.266190184e-3, 8.397559867e-3),
    _two_lines(1.0, 0.5, 0.0, 5e-4, 8.894508714e-3),
    _two_lines(1.0, 2.0, 0.0, 1e-4, 7.966190184e-3),
    _two_lines(2.0, 0.5, 0.0, 1e-4, 8.630817454e-3),
    _two_lines(2.0, 1.0, 0.005, 1e-4, 8.605817454e-3, 8.673797435e-3),
    _one_line(4.0, 0.5, 2.133150596e-6),
    _one_line(5.0, 0.5, 7.615414966e-6),
    _one_line(8.0, 0.5, 1.029922294e-5, 1.008841954e-5),
    _one_line(8.0, 1.0, 8.736722937e-6, 8.525919538e-6),
    _one_line(12.0, 0.5, 8.917848100e-6, 8.397704886e-6),
    _two_lines(0.5, 0.5, 0.0, 1e-4, 8.421720332e-3)._replace(pulse_s=1.0),
    _two_lines(1.0, 0.5, 0.0, 1e-4, 8.572526254e-3)._replace(pulse_s=1.0),
    _two_lines(2.0, 0.5, 0.0, 1e-4, 8.654406041e-3)._replace(pulse_s=1.0),
)

#: T4: C, and by coupling (w-, w+) at each, None = no band
_SWINGS = (0.0, 1e-4, 3e-4, 1e-3, 2e-3)
_EDGES: dict[float, tuple[tuple[float, float] | None, ...]] = {
    0.2: ((3.397585, math.inf), (3.464810, 175.1123), (3.617417, 55.90828), (4.564067, 13.29364), None),
    0.5: ((3.781572, math.inf), (3.865234, 174.7119), (4.058249, 55.46745), (5.436831, 12.42088), None),
    1.0: ((4.421552, math.inf), (4.536811, 174.0403), (4.810270, 54.71543), (8.053835, 9.803875), None),
}
BANDS = {coupling: dict(zip(_SWINGS, edges, strict=True)) for coupling, edges in _EDGES.items()}
#: (26): C, w, w_T at coupling 0.5; and w_T of cycle A0
SURFACE = (
    (0.0, 1.0, 8.723018e-3),
    (0.0, 4.0, 3.489207e-2),
    (0.02, 1.0, 6.729874e-3),
    (0.02, 2.0, 7.985717e-3),
    (0.08, 1.0, 3.992859e-3),
)
RIGID_FREQUENCY_RAD_S = 3.298672e-2


class PerpetualCase(NamedTuple):
    """One run of the relay on a body without friction: what makes it and what was printed."""

    omega_rad_s: float
    coupling: float
    damping_ratio: float
    amplitude_rad: float
    lock_ratio: float
    firings_per_period: float
    final_amplitude_rad: float
    is_captured: bool


#: T5: 150 periods, counted over the last 50
PERPETUAL = (
    PerpetualCase(0.2, 5.0, 0.002, 0.0, 7.54, 2.12, 0.253, is_captured=True),
    PerpetualCase(0.3, 2.0, 0.002, 0.02, 3.18, 2.04, 0.1112, is_captured=True),
    PerpetualCase(0.5, 5.0, 0.002, 0.02, 3.02, 2.06, 0.1037, is_captured=True),
    PerpetualCase(0.5, 2.0, 0.002, 0.06, 1.91, 2.04, 0.0657, is_captured=True),
    PerpetualCase(0.5, 2.0, 0.002, 0.0, 1.91, 0.10, 0.0027, is_captured=False),
    PerpetualCase(1.0, 10.0, 0.002, 0.06, 2.13, 2.04, 0.0743, is_captured=True),
    PerpetualCase(0.5, 5.0, 0.01, 0.06, 1.35, 0.12, 0.0045, is_captured=False),
    PerpetualCase(0.5, 0.5, 0.002, 0.02, 0.95, 0.14, 0.0042, is_captured=False),
    PerpetualCase(0.3, 0.2, 0.002, 0.02, 1.01, 0.16, 0.0035, is_captured=False),
)

#: T6: inertia, (w, xi, kn), torque, length of a pulse
SCHEDULE_AXIS = (5000.0, (0.6, 0.003, 0.4), 0.2, 1.0)
#: schedule: figure: printed
SCHEDULES = {
    "single": {"peak": 2.614520e-5, "scanned peak": 3.088803e-5},
    "ten a period": {"peak": 2.405415e-4, "scanned peak": 2.408034e-4},
    "ten a half period": {"residual": 1.185835e-6, "scanned peak": 3.088803e-5},
    "ten every 10 s": {"peak": 1.685333e-4, "scanned peak": 2.296985e-4},
    "two halves": {"peak": 1.307260e-5, "residual": 1.2310e-7, "scanned residual": 7.2113e-6},
}
