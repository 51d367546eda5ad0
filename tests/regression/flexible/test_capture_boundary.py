"""T3: boundary of capture by formula, by following the motion, and by the whole event simulator."""

import math

import pytest

from service.core.flexible.capture.capture import (
    SwitchOn,
    critical_amplitude_rad,
    least_capturing_amplitude_rad,
    lowest_angle_rad,
)
from service.core.flexible.spacecraft import HubMode
from service.study.limit_cycles import reference
from service.study.limit_cycles.capture_tables import is_captured, mode_of, switch_of
from service.study.limit_cycles.reference import CaptureCase


def name_of(case: CaptureCase) -> str:
    return f"w{case.omega_rad_s:g}-kn{case.coupling:g}-xi{case.damping_ratio:g}-tau{case.pulse_s:g}"


every_case = pytest.mark.parametrize("case", reference.CAPTURES, ids=name_of)


@every_case
def test_the_formula_gives_the_printed_boundary(case: CaptureCase) -> None:
    assert critical_amplitude_rad(switch_of(case), mode_of(case)) == pytest.approx(case.formula_rad, rel=1e-6)


@every_case
def test_following_the_motion_gives_the_printed_least_swing(case: CaptureCase) -> None:
    found = least_capturing_amplitude_rad(switch_of(case), mode_of(case))
    assert found == pytest.approx(case.least_rad, rel=1e-4)


@pytest.mark.parametrize(
    "case", [one for one in reference.CAPTURES if one.least_rad > 0.0 and math.isinf(one.pulse_s)], ids=name_of
)
def test_the_event_simulator_is_free_just_below_and_captured_just_above(case: CaptureCase) -> None:
    least = least_capturing_amplitude_rad(switch_of(case), mode_of(case))
    assert not is_captured(case, 0.99 * least)
    assert is_captured(case, 1.01 * least)


def test_where_no_swing_is_needed_the_simulator_is_captured_without_one() -> None:
    case = reference.CAPTURES[1]
    assert critical_amplitude_rad(switch_of(case), mode_of(case)) < 0.0
    assert is_captured(case, 0.0)


@every_case
def test_the_formula_is_exact_without_damping_or_says_by_how_much_it_is_not(case: CaptureCase) -> None:
    switch, mode = switch_of(case), mode_of(case)._replace(damping_ratio=0.0)
    least = least_capturing_amplitude_rad(switch, mode)
    refined = critical_amplitude_rad(switch, mode, is_refined=True)
    if least == 0.0:
        assert refined <= 0.0
    elif switch.rate_rad_s <= math.pi * switch.pulse_rad_s2 / mode.omega_rad_s:
        # the timed form looks at half a period, and the lowest angle of one case comes 1e-7 earlier
        assert refined == pytest.approx(least, rel=1e-9 if math.isinf(switch.pulse_s) else 1e-7)
    else:
        plain = critical_amplitude_rad(switch, mode)
        assert least < plain <= 1.065 * least
        assert refined == pytest.approx(least, rel=6e-3)


def test_damping_raises_the_boundary_so_that_leaving_it_out_is_safe() -> None:
    for case in reference.CAPTURES:
        if case.damping_ratio > 0.0:
            critical = critical_amplitude_rad(switch_of(case), mode_of(case))
            assert critical < case.least_rad <= 1.017 * critical


def test_special_forms_of_the_boundary() -> None:
    omega, kn, rate, eps_a, eps_c = 2.0, 0.7, 3e-4, 1.9e-4, 1.1e-6
    mode, pi = HubMode(omega, 0.01, kn), math.pi
    one_line = SwitchOn(eps_a, eps_c, rate, 0.0175, 0.0175)
    by_19 = pi * rate / omega - eps_a / omega**2 * (pi**2 / 2 + 2 * kn) - 2 * kn * eps_c / omega**2
    assert 2.0 * critical_amplitude_rad(one_line, mode) == pytest.approx(by_19, rel=1e-12)
    free_rotor = SwitchOn(eps_a, 0.0, rate, 0.0175, 0.0349)
    by_20 = 0.0174 + pi * rate / omega - eps_a / omega**2 * (2 * kn + pi**2 / 2)
    assert 2.0 * critical_amplitude_rad(free_rotor, mode) == pytest.approx(by_20, rel=1e-12)


def test_at_a_given_net_pulse_friction_away_from_the_line_moves_the_boundary_up() -> None:
    case = reference.CAPTURES[8]
    toward = critical_amplitude_rad(switch_of(case), mode_of(case))
    away = switch_of(case)._replace(passive_rad_s2=-reference.PASSIVE_RAD_S2)
    assert critical_amplitude_rad(away, mode_of(case)) > toward
    found = least_capturing_amplitude_rad(away, mode_of(case))
    assert found == pytest.approx(critical_amplitude_rad(away, mode_of(case), is_refined=True), rel=6e-3)


def test_at_the_least_swing_the_lowest_angle_is_the_line_of_release() -> None:
    for case in reference.CAPTURES:
        if case.least_rad > 0.0:
            least = least_capturing_amplitude_rad(switch_of(case), mode_of(case))
            assert lowest_angle_rad(switch_of(case), mode_of(case), least) == pytest.approx(case.alpha_rad, abs=1e-15)
