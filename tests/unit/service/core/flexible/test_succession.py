"""One-sided motion: what it is refused for, its returns, and the ladder."""

import math

import numpy as np
import pytest

from service.core.flexible.return_kernels import advance, arrival_time, follow, one_return, turning_time
from service.core.flexible.spacecraft import WheelDrive
from service.core.flexible.succession import koenigs_lamerey, one_sided_motion, succession
from service.core.flexible.switching_law import SwitchingLaw

DRIVE = WheelDrive(1000.0, 0.2, 1e-3, 1e-4, momentum_n_m_s=10.0)
LAW = SwitchingLaw(0.0175, 0.0349, 1.0, 3, 3e-3)


@pytest.mark.parametrize(
    ("drive", "law", "reported"),
    [
        (DRIVE._replace(external_torque_n_m=1e-5), LAW, "external_torque_n_m is 1e-05: momentum drifts"),
        (DRIVE._replace(dry_friction_n_m=0.0, viscous_loss_n_m=0.0), LAW, "neither dry nor viscous friction"),
        (DRIVE, LAW._replace(pulse_s=math.inf), "pulse_s is infinite: a relay has no cycle of pulses"),
        (DRIVE, LAW._replace(alpha_rad=0.05), "alpha_rad 0.05 is not at or below"),
    ],
)
def test_what_has_no_one_sided_cycle_is_refused(drive, law, reported):
    with pytest.raises(ValueError, match=reported):
        one_sided_motion(drive, law)


@pytest.mark.parametrize("c", [0.0, 5e-6, 0.01])
def test_turns_and_arrivals_are_where_the_motion_is(c):
    turn_s = turning_time(-1e-4, 1e-6, c)
    assert advance(0.03, -1e-4, 1e-6, c, turn_s)[1] == pytest.approx(0.0, abs=1e-18)
    arrival_s = arrival_time(0.03, 1e-4, 1e-6, c, 0.0349, 40.0)
    assert advance(0.03, 1e-4, 1e-6, c, arrival_s)[0] == pytest.approx(0.0349, rel=1e-15)


def test_a_visit_tells_its_extremes():
    motion = one_sided_motion(DRIVE, LAW)
    visit = one_return(4e-5, motion)
    assert visit.pulses == 3
    assert LAW.alpha_rad < visit.inner_rad < 0.025
    assert LAW.last_line_rad < visit.outer_rad < LAW.last_line_rad + 1e-4
    assert visit.rate_min_rad_s < -1e-4 < 4e-5 <= visit.rate_max_rad_s


def test_a_visit_may_bounce_at_its_last_line_for_hours():
    visit = one_return(8e-5, one_sided_motion(DRIVE, LAW))
    assert visit.pulses > 50
    assert visit.elapsed_s > 3600.0
    assert 0.0 < visit.rate_rad_s < 2e-4


def test_a_body_that_reaches_the_other_side_does_not_return():
    weak = one_sided_motion(DRIVE._replace(dry_friction_n_m=1e-5, viscous_loss_n_m=0.0), LAW)
    assert math.isnan(one_return(1e-6, weak).rate_rad_s)


def test_a_body_that_the_pulses_cannot_turn_does_not_return():
    motion = one_sided_motion(DRIVE, SwitchingLaw(0.0175, 0.0349, 1.0))
    assert math.isnan(one_return(5e-4, motion).rate_rad_s)
    assert np.isnan(follow(np.array([5e-4]), 4, motion)[0, 1:]).all()


def test_a_body_too_high_to_fall_back_is_given_up_soon():
    # each pulse takes less than friction gives from line to line
    motion = one_sided_motion(DRIVE, SwitchingLaw(0.0175, 0.0349, 0.1, 1, 1e-3))
    lost = one_return(6e-5, motion)
    assert math.isnan(lost.rate_rad_s)
    assert lost.pulses < 20


def test_a_visit_of_too_many_pulses_is_none():
    motion = one_sided_motion(DRIVE, LAW)
    assert math.isnan(one_return(8e-5, motion._replace(most_pulses=20)).rate_rad_s)


def test_the_ladder_steps_between_diagonal_and_function():
    motion = one_sided_motion(DRIVE, LAW)
    ladder = koenigs_lamerey(1.2e-4, 6, motion)
    speeds = follow(np.array([1.2e-4]), 6, motion)[0]
    assert ladder.shape == (13, 2)
    np.testing.assert_array_equal(ladder[::2, 0], ladder[::2, 1])
    np.testing.assert_array_equal(ladder[::2, 0], speeds)
    np.testing.assert_allclose(succession(ladder[1::2, 0], motion), ladder[1::2, 1], rtol=1e-14)


def test_a_ladder_ends_where_the_body_does_not_return():
    single = one_sided_motion(DRIVE, SwitchingLaw(0.0175, 0.0349, 1.0))
    assert koenigs_lamerey(5e-4, 6, single).tolist() == [[5e-4, 5e-4]]
