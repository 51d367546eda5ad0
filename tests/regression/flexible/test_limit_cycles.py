"""T1: limit cycles of the pulse law, their multipliers, and what closed forms say of them."""

import math

import numpy as np
import pytest
from flexible_oracles import staggered_forms

from service.core.flexible.closed_forms import cycle_period_s, single_pulse_forms
from service.core.flexible.limit_cycle import critical_viscous_loss_n_m, cycle_multiplier, find_limit_cycles
from service.core.flexible.motion import follow_motion
from service.core.flexible.propagation import BodyState
from service.core.flexible.return_kernels import one_return
from service.core.flexible.succession import one_sided_motion
from service.study.limit_cycles import reference
from service.study.limit_cycles.cycle_tables import cycle_of, motion_of

CASES = list(reference.CYCLES)


@pytest.mark.parametrize("name", CASES)
def test_a_cycle_of_the_reference_comes_back_to_its_printed_digits(name: str) -> None:
    case, cycle = reference.CYCLES[name], cycle_of(name)
    assert cycle.pulses == case.law.pulse_count
    assert cycle.speed_rad_s == pytest.approx(case.speed_rad_s, rel=1e-6)
    assert cycle.rate_rad_s == pytest.approx(case.rate_rad_s, rel=1e-6)
    assert cycle.period_s == pytest.approx(case.period_s, rel=1e-8)
    assert cycle.inner_rad == pytest.approx(case.inner_rad, rel=1e-6)
    assert cycle.outer_rad == pytest.approx(case.outer_rad, rel=1e-6)
    assert cycle.multiplier == pytest.approx(case.multiplier, abs=1e-4)


@pytest.mark.parametrize("name", CASES)
def test_the_period_is_that_of_the_balance_of_momentum(name: str) -> None:
    case, cycle = reference.CYCLES[name], cycle_of(name)
    assert cycle.period_s == pytest.approx(cycle_period_s(case.drive, case.law.pulse_s, cycle.pulses), rel=1e-10)


def test_the_single_pulse_cycle_of_the_paper_is_unstable_and_only_the_truncated_equation_makes_it_stable() -> None:
    cycle, forms = cycle_of("A0"), single_pulse_forms(reference.BASE, 1.0)
    assert not cycle.is_stable
    assert cycle.multiplier < -1.0
    assert forms.multiplier_truncated > -1.0
    found = (forms.multiplier, forms.multiplier_frictionless, forms.multiplier_truncated)
    assert found == pytest.approx(reference.CLOSED_MULTIPLIERS, abs=1e-6)
    assert forms.multiplier == pytest.approx(cycle.multiplier, abs=1e-5)


def test_stable_cycles_exist() -> None:
    assert {name for name in CASES if cycle_of(name).is_stable} == {"A1", "A2", "A3", "B2", "B3", "C2"}


@pytest.mark.parametrize("dry_friction_n_m", list(reference.CRITICAL_LOSSES))
def test_the_loss_that_makes_a_single_pulse_stable(dry_friction_n_m: float) -> None:
    exact, formula = reference.CRITICAL_LOSSES[dry_friction_n_m]
    drive = reference.BASE._replace(dry_friction_n_m=dry_friction_n_m, momentum_n_m_s=reference.CRITICAL_MOMENTUM_N_M_S)
    assert critical_viscous_loss_n_m(drive, reference.law_of()) == pytest.approx(exact, rel=1e-6)
    # printed with five digits
    assert single_pulse_forms(drive, 1.0).critical_viscous_loss_n_m == pytest.approx(formula, rel=5e-5)


def test_at_one_line_the_same_cycle_is_only_shifted() -> None:
    law = reference.law_of()._replace(beta_rad=reference.ALPHA_RAD)
    (cycle,) = find_limit_cycles(reference.BASE, law)
    shift, wide = reference.BETA_RAD - reference.ALPHA_RAD, cycle_of("A0")
    assert cycle.speed_rad_s == pytest.approx(wide.speed_rad_s, rel=1e-9)
    assert cycle.inner_rad == pytest.approx(wide.inner_rad - shift, abs=1e-14)
    assert cycle.outer_rad == pytest.approx(wide.outer_rad - shift, abs=1e-14)


def test_two_lines_have_no_cycle_of_two_pulses() -> None:
    for step_mrad in (0.5, 1.0, 2.0, 3.0):
        law = reference.law_of(2, 1e-3 * step_mrad)
        assert [cycle for cycle in find_limit_cycles(reference.BASE, law) if cycle.pulses == 2] == []
        assert staggered_forms(one_sided_motion(reference.BASE, law)) is None


@pytest.mark.parametrize(
    ("pulses", "first_mrad", "gone_mrad"),
    [(3, 1.7836, (3.25, 3.30)), pytest.param(5, 1.2217, (1.75, 1.80), marks=pytest.mark.slow)],
)
def test_windows_of_stable_steps(pulses: int, first_mrad: float, gone_mrad: tuple[float, float]) -> None:
    def multiplier(step_mrad: float) -> float:
        law = reference.law_of(pulses, 1e-3 * step_mrad)
        found = [one.multiplier for one in find_limit_cycles(reference.BASE, law) if one.pulses == pulses]
        return found[0] if found else math.nan

    # the printed step has five digits: half of the last one either way changes the sign
    assert multiplier(first_mrad - 1e-4) < -1.0 < multiplier(first_mrad + 1e-4)
    assert math.isfinite(multiplier(gone_mrad[0]))
    assert math.isnan(multiplier(gone_mrad[1]))


def test_instantaneous_pulses_are_near() -> None:
    for name in ("B3", "C2"):
        forms = staggered_forms(motion_of(name))
        assert forms is not None
        assert forms.speeds_rad_s[0] == pytest.approx(cycle_of(name).speed_rad_s, rel=0.08)
        assert forms.multiplier == pytest.approx(cycle_of(name).multiplier, abs=0.08)


def test_the_motion_itself_closes_after_a_period() -> None:
    for name in ("A0", "B3", "C2"):
        case, cycle = reference.CYCLES[name], cycle_of(name)
        momentum = case.drive.momentum_n_m_s - case.drive.inertia_kg_m2 * cycle.speed_rad_s
        start = BodyState(-case.law.beta_rad, -cycle.speed_rad_s, momentum_n_m_s=momentum)
        motion = follow_motion(start, case.drive, None, case.law, cycle.period_s)
        assert motion.end.angle_rad == pytest.approx(start.angle_rad, abs=1e-12)
        assert motion.end.rate_rad_s == pytest.approx(start.rate_rad_s, abs=1e-13)
        assert 2 * len(motion.firing_times_s) in {2 * cycle.pulses, 2 * cycle.pulses + 2}


@pytest.mark.parametrize("name", ["A2", "A3"])
def test_two_cycles_of_the_reference_do_not_belong_to_their_drive(name: str) -> None:
    # 0.05 N m s of rotor against 1000 kg m^2 at 1e-4 rad/s: the rotor comes to rest, dry friction holds it there
    case, cycle = reference.CYCLES[name], cycle_of(name)
    assert cycle.momentum_n_m_s[0] < 0.0 < cycle.momentum_n_m_s[1]
    assert not cycle.is_momentum_consistent
    momentum = case.drive.momentum_n_m_s - case.drive.inertia_kg_m2 * cycle.speed_rad_s
    start = BodyState(-case.law.beta_rad, -cycle.speed_rad_s, momentum_n_m_s=momentum)
    motion = follow_motion(start, case.drive, None, case.law, 3.0 * cycle.period_s)
    assert motion.end.momentum_n_m_s == 0.0
    assert motion.end.rate_rad_s == pytest.approx(-0.05 / 1000.0, rel=1e-12)
    assert len(motion.firing_times_s) < 3
    assert all(cycle_of(other).is_momentum_consistent for other in CASES if other not in {"A2", "A3"})


def test_the_same_stable_cycle_exists_with_a_rotor_that_keeps_its_sense() -> None:
    # same c and same eps_c as A2: less dry friction, more momentum
    drive = reference.CYCLES["A2"].drive._replace(momentum_n_m_s=0.25, dry_friction_n_m=0.98e-3)
    (cycle,) = find_limit_cycles(drive, reference.law_of())
    assert cycle.is_momentum_consistent
    assert cycle.is_stable
    assert cycle.multiplier == pytest.approx(reference.CYCLES["A2"].multiplier, abs=1e-6)
    start = BodyState(-reference.BETA_RAD, -cycle.speed_rad_s, momentum_n_m_s=0.25 - 1000.0 * cycle.speed_rad_s)
    motion = follow_motion(start, drive, None, reference.law_of(), 3.0 * cycle.period_s)
    assert motion.end.angle_rad == pytest.approx(start.angle_rad, abs=1e-11)


def test_no_slope_is_taken_across_a_jump() -> None:
    motion = motion_of("B3")
    speeds = np.linspace(1e-6, 2e-5, 400)
    pulses = [one_return(float(speed), motion).pulses for speed in speeds]
    (jump,) = np.flatnonzero(np.diff(pulses))
    near = float(speeds[jump]) + 1e-9
    slope = cycle_multiplier(near, motion)
    # a difference across the jump of 1.5e-4 rad/s within steps of 2e-8 would be thousands
    assert math.isnan(slope) or abs(slope) < 5.0
