"""Closed loops as a whole: figures against those computed apart, refusals, thinning."""

import math

import numpy as np
import pytest

from service.core.dynamics.orbital_frame_analysis import (
    MOST_STEPS,
    BeyondOrbitalRate,
    SettlingRequest,
    check_closed_loop,
    fly_closed_loop,
)
from service.core.dynamics.orbital_frame_flight import Start, fly_spacecraft
from service.core.dynamics.orbital_frame_model import Computer, Inertia, OrbitalFrameSpacecraft, rigid_spacecraft


def test_figures_are_those_of_the_flight():
    request = SettlingRequest(
        OrbitalFrameSpacecraft(), Start(yaw_deg=1.0), 60.0, seed=3, settled_after_s=30.0, bound_deg=0.98
    )
    found, flown = fly_closed_loop(request), fly_spacecraft(OrbitalFrameSpacecraft(), Start(yaw_deg=1.0), 60.0, 3)
    assert np.array_equal(found.flight.yaw_deg, flown.yaw_deg)
    late = flown.time_s > 30.0
    assert found.merit.settled_rms_deg[2] == pytest.approx(math.sqrt(np.mean(flown.yaw_deg[late] ** 2)))
    assert found.merit.settled_peak_deg[0] == pytest.approx(np.abs(flown.roll_deg[late]).max())
    assert found.merit.largest_momentum_n_m_s[1] == pytest.approx(np.abs(flown.momentum_n_m_s[:, 1]).max())
    within = found.merit.time_within_bound_s[2]
    assert np.abs(flown.yaw_deg[flown.time_s >= within]).max() <= 0.98
    assert math.isnan(found.merit.mean_yaw_deg)
    assert all(math.isnan(each) for each in found.merit.harmonic_deg)


def test_harmonics_over_an_orbit_are_those_of_the_specification():
    # the spacecraft turns in a fifth of the periods here, which changes nothing of a slow motion
    spacecraft = rigid_spacecraft(inertia=Inertia(xy=100.0, xz=60.0, yz=114.0))._replace(
        computer=Computer(False, period_s=1.0)
    )
    merit = fly_closed_loop(SettlingRequest(spacecraft, Start(), 15_000.0)).merit
    assert merit.harmonic_deg[2] == pytest.approx(0.0170, abs=0.0002)
    assert merit.harmonic_deg[0] == pytest.approx(0.00182, abs=0.00002)
    assert merit.mean_yaw_deg == pytest.approx(0.0, abs=0.001)


def test_a_thinned_record_keeps_the_start_and_the_figures():
    found = fly_closed_loop(SettlingRequest(rigid_spacecraft(), Start(yaw_deg=1.0), 10.0))
    thin = found.thinned(10)
    assert (len(found.flight.time_s), len(thin.flight.time_s)) == (81, 9)
    assert thin.flight.time_s[0] == 0.0
    assert np.array_equal(thin.flight.torque_n_m, found.flight.torque_n_m[::9])
    assert thin.merit is found.merit
    assert found.thinned(81).flight.time_s.tolist() == found.flight.time_s.tolist()


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (SettlingRequest(spacecraft=OrbitalFrameSpacecraft(inertia=Inertia(zz=20_000.0))), "triangle"),
        (SettlingRequest(duration_s=math.nan), "duration_s"),
        (SettlingRequest(duration_s=60_001.0), "60000 s"),
        (SettlingRequest(spacecraft=OrbitalFrameSpacecraft(steps=16)), f"{MOST_STEPS} steps"),
        (SettlingRequest(start=Start(rate_rad_s=(-1.04e-3, 0.0, 0.0))), "1.01 orbital rates"),
        (SettlingRequest(start=Start(rate_rad_s=(2.1e-3, 0.0, 0.0)), beyond=BeyondOrbitalRate.AS_PRINTED), "imaginary"),
    ],
)
def test_what_cannot_fly_is_refused(asked, says):
    with pytest.raises(ValueError, match=says):
        check_closed_loop(asked)


@pytest.mark.parametrize(
    ("ratio", "beyond"),
    [
        (0.99, BeyondOrbitalRate.REFUSE),
        (1.4, BeyondOrbitalRate.AS_PRINTED),
        (30.0, BeyondOrbitalRate.SECOND_BRANCH),
    ],
)
def test_what_may_fly_is_not_refused(ratio, beyond):
    start = Start(rate_rad_s=(ratio * OrbitalFrameSpacecraft().law.orbital_rate_rad_s, 0.0, 0.0))
    check_closed_loop(SettlingRequest(start=start, beyond=beyond))


def test_a_flight_whose_numbers_leave_all_bounds_is_an_error():
    # a spin that a step of ten seconds cannot follow
    spacecraft = rigid_spacecraft(inertia=Inertia(1.0, 1.0, 1.5))._replace(computer=Computer(False, 10.0, 100.0))
    start = Start(rate_rad_s=(1.0, 0.8, -0.7))
    with pytest.raises(ValueError, match=r"leaves all bounds|imaginary"):
        fly_closed_loop(SettlingRequest(spacecraft, start, 2000.0, beyond=BeyondOrbitalRate.SECOND_BRANCH))
