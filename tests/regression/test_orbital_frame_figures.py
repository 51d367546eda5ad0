"""Figures of Belenkii, Vasilev and Semenov (Meteor-M No. 2) that the orbital-frame model reproduces, and controls.

Reference values were made by an independent program; tolerances are those with which they were stated.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from service.core.dynamics.orbital_frame_analysis import (
    FlightRecord,
    Start,
    fly_spacecraft,
    harmonic_amplitude,
    largest_after,
    mean_over_orbits,
    time_within,
    trimmed_correction_rad_s,
)
from service.core.dynamics.orbital_frame_kernel import compiled_fly
from service.core.dynamics.orbital_frame_model import (
    AS_PRINTED,
    MAX_GAINS,
    MIN_GAINS,
    NOMINAL_INERTIA,
    ORBITAL_RATE_RAD_S,
    YAW_FIRST,
    Inertia,
    Law,
    OrbitalFrameGains,
    OrbitalFrameSpacecraft,
    RateSensor,
    rigid_spacecraft,
)
from service.study.orbital_frame import reproduce

ORBIT_S = 2.0 * math.pi / ORBITAL_RATE_RAD_S
Fly = Callable[..., FlightRecord]


@pytest.fixture(scope="module")
def fly():
    return partial(fly_spacecraft, kernel=compiled_fly())


def _at(flight, time_s):
    k = round(time_s / 0.125)
    return float(flight.roll_deg[k]), float(flight.pitch_deg[k]), float(flight.yaw_deg[k])


@pytest.mark.parametrize(
    ("gains", "start", "points"),
    [
        (
            MAX_GAINS,
            Start(yaw_deg=10.0),
            {
                50: (-0.3547, 0.0201, 9.6349),
                100: (-0.4395, -0.0003, 8.4130),
                200: (-0.3517, -0.0243, 5.5860),
                500: (-0.0842, -0.0030, 1.2699),
                1000: (-0.0032, 0.0, 0.0813),
            },
        ),
        (
            MIN_GAINS,
            Start(yaw_deg=10.0),
            {100: (-0.4538, 0.0031, 8.9820), 300: (-0.2478, -0.0200, 3.6571), 500: (-0.0698, -0.0033, 0.9152)},
        ),
        (
            MAX_GAINS,
            Start(roll_deg=2.0),
            {
                50: (0.8459, -0.2839, 2.7002),
                100: (0.0808, -0.1451, 5.1044),
                200: (-0.2356, -0.0157, 4.7013),
                500: (-0.0811, -0.0023, 1.2054),
            },
        ),
    ],
    ids=["yaw 10, max", "yaw 10, min", "roll 2, max"],
)
def test_trajectories(fly, gains, start, points):
    flight = fly(rigid_spacecraft(gains), start, 1000.0)
    for time_s, wanted in points.items():
        assert _at(flight, time_s) == pytest.approx(wanted, abs=0.002), time_s


def test_pitch_tells_which_product_is_coded(fly):
    extreme = {}
    for product in (0, AS_PRINTED, YAW_FIRST):
        spacecraft = rigid_spacecraft()._replace(law=Law(product=product))
        pitch = fly(spacecraft, Start(roll_deg=2.0), 1000.0).pitch_deg
        extreme[product] = float(pitch[np.abs(pitch).argmax()])
    assert extreme[0] == pytest.approx(-0.284, abs=0.002)
    assert extreme[AS_PRINTED] == pytest.approx(0.191, abs=0.002)
    assert extreme[YAW_FIRST] == pytest.approx(0.195, abs=0.002)


@pytest.mark.parametrize(
    ("gains", "wanted_s", "roll_deg", "at_s"), [(MAX_GAINS, 966.0, 0.440, 106.0), (MIN_GAINS, 700.0, 0.458, 115.0)]
)
def test_yaw_of_ten_degrees(fly, gains, wanted_s, roll_deg, at_s):
    flight = fly(rigid_spacecraft(gains), Start(yaw_deg=10.0), 3000.0)
    first_s = float(flight.time_s[np.flatnonzero(np.abs(flight.yaw_deg) <= 0.1)[0]])
    assert first_s == pytest.approx(wanted_s, rel=0.01)
    assert first_s <= 1000.0  # the paper
    assert np.abs(flight.roll_deg).max() == pytest.approx(roll_deg, rel=0.01)
    assert flight.time_s[np.abs(flight.roll_deg).argmax()] == pytest.approx(at_s, rel=0.03)


def test_roll_of_two_degrees(fly):
    for gains, coarse_s, fine_s, yaw_deg in ((MAX_GAINS, 456.0, 783.0, 5.38), (MIN_GAINS, 500.0, 742.0, 5.50)):
        flight = fly(rigid_spacecraft(gains), Start(roll_deg=2.0), 3000.0)
        assert time_within(flight.time_s, flight.roll_deg, 0.1) == pytest.approx(coarse_s, rel=0.01)
        assert time_within(flight.time_s, flight.roll_deg, 0.02) == pytest.approx(fine_s, rel=0.01)
        assert np.abs(flight.yaw_deg).max() == pytest.approx(yaw_deg, rel=0.01)


def test_slope_of_a_half_is_too_slow(fly):
    spacecraft = rigid_spacecraft()._replace(law=Law(slope=0.5))
    flight = fly(spacecraft, Start(yaw_deg=10.0), 3000.0)
    assert flight.time_s[np.flatnonzero(np.abs(flight.yaw_deg) <= 0.1)[0]] == pytest.approx(1509.0, abs=15.0)


def _closed_form_harmonic(gains):
    """Return amplitudes of yaw and roll, deg, from the torque of the products by hand."""
    torque = ORBITAL_RATE_RAD_S**2 * math.hypot(NOMINAL_INERTIA.xy, 4.0 * NOMINAL_INERTIA.yz)
    x = torque / complex(gains.yaw_stiffness / math.sqrt(2.0), gains.yaw_damping * ORBITAL_RATE_RAD_S)
    roll = (1j * torque - gains.roll_damping * ORBITAL_RATE_RAD_S * x) / (gains.roll_stiffness / 2.0)
    return math.degrees(abs(x - 1j * roll)), math.degrees(abs(roll))


@pytest.mark.parametrize(
    ("gains", "yaw_deg", "roll_deg"), [(MAX_GAINS, 0.0170, 0.00182), (MIN_GAINS, 0.0642, 0.00389)], ids=["max", "min"]
)
def test_products_of_inertia_move_the_craft_at_the_orbital_frequency(fly, gains, yaw_deg, roll_deg):
    flight = fly(rigid_spacecraft(gains, NOMINAL_INERTIA), Start(), 15_000.0)
    late = flight.time_s > 15_000.0 - ORBIT_S
    yaw, roll = (
        harmonic_amplitude(flight.time_s[late], each[late], ORBIT_S) for each in (flight.yaw_deg, flight.roll_deg)
    )
    print(f"yaw {yaw:.5f} roll {roll:.5f} ratio {yaw / roll:.2f}")
    assert yaw == pytest.approx(yaw_deg, rel=0.01)
    assert roll == pytest.approx(roll_deg, rel=0.01)
    assert (yaw, roll) == pytest.approx(_closed_form_harmonic(gains), rel=0.02)
    # the published ratio, .017 over .0018, is that of the largest gains only
    assert yaw / roll == pytest.approx(9.30 if gains is MAX_GAINS else 16.5, rel=0.02)


@pytest.mark.parametrize(
    ("gains", "yaw_deg", "yaw_by", "roll_deg", "roll_by"),
    [(MAX_GAINS, 0.0457, 0.0010, 0.0050, 0.0001), (MIN_GAINS, 0.140, 0.002, 0.0098, 0.0003)],
    ids=["max", "min"],
)
def test_quantum_of_torque(fly, gains, yaw_deg, yaw_by, roll_deg, roll_by):
    spacecraft = rigid_spacecraft(gains, NOMINAL_INERTIA, is_sampled=True)
    flight = fly(spacecraft, Start(), 15_000.0)
    roll, _, yaw = largest_after(flight, 1500.0)
    assert yaw == pytest.approx(yaw_deg, abs=yaw_by)
    assert roll == pytest.approx(roll_deg, abs=roll_by)
    codes = flight.torque_n_m / spacecraft.computer.torque_quantum_n_m
    assert np.abs(codes - codes.round()).max() < 1e-9
    assert np.abs(codes).max() <= 127.0


def test_noise_of_the_rates_lowers_the_peaks_of_the_quantum(fly):
    spacecraft = rigid_spacecraft(inertia=NOMINAL_INERTIA, is_sampled=True)._replace(
        rate_sensor=RateSensor(null_rad_s=(0.0, 0.0, 0.0), quantum_rad_s=1e-12, delay_periods=0)
    )
    for seed in range(1, 7):
        roll, _, yaw = largest_after(fly(spacecraft, Start(), 15_000.0, seed), 1500.0)
        print(f"seed {seed}: yaw {yaw:.4f} roll {roll:.4f}")
        assert 0.032 < yaw < 0.036
        assert 0.0034 < roll < 0.0039


def test_null_of_the_roll_rate_turns_the_craft_by_yaw(fly):
    means = []
    for sign in (1.0, -1.0):
        sensor = RateSensor(null_rad_s=(sign * 1.8e-7, 0.0, 0.0))
        flight = fly(
            rigid_spacecraft(inertia=NOMINAL_INERTIA, is_sampled=True)._replace(rate_sensor=sensor), Start(), 15_000.0
        )
        means.append(float(flight.yaw_deg[flight.time_s > 15_000.0 - 2.0 * ORBIT_S].mean()))
    assert means == pytest.approx([-0.0100, 0.0100], abs=0.0005)


def _corrected(spacecraft, correction_rad_s):
    return spacecraft._replace(computer=spacecraft.computer._replace(yaw_rate_correction_rad_s=correction_rad_s))


def test_everything_at_once_with_the_smallest_gains(fly):
    spacecraft = OrbitalFrameSpacecraft(law=Law(gains=MIN_GAINS))
    before = fly(spacecraft, Start(), 15_000.0)
    assert mean_over_orbits(before, ORBITAL_RATE_RAD_S) == pytest.approx(-0.31, abs=0.02)
    correction = trimmed_correction_rad_s(spacecraft, 15_000.0, compiled_fly())
    assert correction == pytest.approx(-1.92e-5, rel=0.03)  # -4.0 deg/h
    for seed in range(1, 6):
        roll, pitch, yaw = largest_after(fly(_corrected(spacecraft, correction), Start(), 15_000.0, seed), 1500.0)
        print(f"seed {seed}: yaw {yaw:.4f} roll {roll:.4f} pitch {pitch:.4f}, paper .14 .02 .01")
        assert yaw <= 0.145
        assert roll <= 0.021
        assert pitch <= 0.0105
    halved = fly(_corrected(spacecraft, correction)._replace(steps=2), Start(), 15_000.0)
    assert largest_after(halved, 1500.0)[2] == pytest.approx(
        largest_after(fly(_corrected(spacecraft, correction), Start(), 15_000.0), 1500.0)[2], rel=0.02
    )


@pytest.mark.slow
def test_everything_at_once_with_the_largest_gains(fly):
    spacecraft = OrbitalFrameSpacecraft()
    correction = trimmed_correction_rad_s(spacecraft, 15_000.0, compiled_fly())
    yaw = largest_after(fly(_corrected(spacecraft, correction), Start(), 15_000.0), 1500.0)[2]
    assert 0.05 < yaw < 0.09


def test_side_on_which_the_wheel_turns_is_that_of_the_product(fly):
    flipped = NOMINAL_INERTIA._replace(yz=-NOMINAL_INERTIA.yz)
    flight = fly(OrbitalFrameSpacecraft(law=Law(gains=MIN_GAINS), inertia=flipped), Start(), 15_000.0)
    assert mean_over_orbits(flight, ORBITAL_RATE_RAD_S) == pytest.approx(0.28, abs=0.04)


@pytest.mark.slow
def test_eight_statements_without_a_figure_of_their_own(fly):
    """Transients of the smallest gains, constant yaw and its correction, noise, friction, tones, resonance."""
    rows = reproduce(compiled_fly())
    found = {(row.what, row.parameters.rpartition(", ")[2]): row for row in rows}
    expected = [
        ("yaw of 10 deg: time to 0.1 deg", "smallest yaw gains", 700.9, "reproduced"),
        ("yaw of 10 deg: largest roll", "smallest yaw gains", 0.458, "reproduced"),
        ("roll of 2 deg: time to 1 % of it", "smallest yaw gains", 742.75, "reproduced"),
        ("roll of 2 deg: largest yaw, about", "smallest yaw gains", 5.50, "not reproduced"),
        ("mean of yaw over two orbits", "not corrected", -0.303, "reproduced"),
        ("mean of yaw over two orbits", "yaw rate corrected by a constant", 0.0, "fitted"),
        ("rms of yaw", "largest gains", 0.0041, "reproduced"),
        ("next part of the wheels' model over dry friction, mean of yaw", "smallest yaw gains", 0.175, "reproduced"),
        ("peak of yaw with tones over that without", "corrected", 1.0, "reproduced"),
        ("rms of the yaw torque", "16 times the largest yaw gains", 0.222, "reproduced"),
        ("rms of the yaw torque", "the largest yaw gains", 0.00164, "reproduced"),
    ]
    for what, parameters, value, verdict in expected:
        row = found[what, parameters]
        assert row.reproduced == pytest.approx(value, rel=0.02, abs=5e-4), row
        assert row.verdict == verdict
    assert [row.what for row in rows if row.is_surprising] == []
    assert sum(row.is_known_miss for row in rows if row.verdict == "not reproduced") == 3


def test_rates_are_as_old_as_their_sensor_says(fly):
    """Four periods differ from one; before, every delay above zero was one period."""
    high = MAX_GAINS._replace(yaw_stiffness=40.0, yaw_damping=8000.0)
    torques = [
        fly(
            OrbitalFrameSpacecraft(law=Law(gains=high), rate_sensor=RateSensor(delay_periods=delay)), Start(), 1500.0
        ).torque_n_m[:, 2]
        for delay in (1, 4)
    ]
    assert np.abs(torques[0]).max() < 0.05
    assert np.abs(torques[1]).max() >= 0.25
    with pytest.raises(ValueError, match="delay_periods is -1"):
        fly(OrbitalFrameSpacecraft(rate_sensor=RateSensor(delay_periods=-1)), Start(), 10.0)


def test_free_libration_has_the_period_of_the_gravity_gradient(fly):
    spacecraft = rigid_spacecraft(OrbitalFrameGains(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    rate = (0.0, ORBITAL_RATE_RAD_S, 0.0)
    flight = fly(spacecraft, Start(pitch_deg=1.0, rate_rad_s=rate), 16_000.0)
    pitch = flight.pitch_deg
    falls = np.flatnonzero((pitch[:-1] > 0.0) & (pitch[1:] <= 0.0))
    crossing_s = flight.time_s[falls] + 0.125 * pitch[falls] / (pitch[falls] - pitch[falls + 1])
    assert np.diff(crossing_s).mean() == pytest.approx(4965.0, abs=2.0)


def _equations(_time_s, y):
    """Return the derivative of the continuous model, written here from the equations alone."""
    j = np.array([[8000.0, 100.0, 60.0], [100.0, 6000.0, 114.0], [60.0, 114.0, 5000.0]])
    w0 = ORBITAL_RATE_RAD_S
    s, v, k, h = y[0], y[1:4], y[4:7], y[7:10]
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    a = (s * s - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) - 2.0 * s * cross
    w = np.linalg.solve(j, k - h)
    r = a[:, 2]
    roll, pitch = math.atan2(r[1], r[2]), math.atan2(-r[0], r[2])
    tilt = roll**2 + pitch**2
    mu = np.array([1.0 - tilt / 8.0, math.sqrt(16.0 - tilt) / 8.0 * roll, math.sqrt(16.0 - tilt) / 8.0 * pitch])
    c = w[0] / w0
    nu0, nu3 = math.sqrt(1.0 - c * c / 2.0), c / math.sqrt(2.0)
    half = np.array([mu[0] * nu0, mu[1] * nu0 + mu[2] * nu3, mu[2] * nu0 - mu[1] * nu3, mu[0] * nu3])
    wanted = -np.array([40.0, 80.0, 2.5]) * half[0] * half[1:] - np.array([1000.0, 2000.0, 500.0]) * (
        w - np.array([0.0, w0, 0.0])
    )
    u = np.clip(wanted, -0.25, 0.25)
    relative = w - a @ np.array([0.0, w0, 0.0])
    turning = 0.5 * np.concatenate([[-v @ relative], s * relative + np.cross(v, relative)])
    momentum = np.cross(k, w) + 3.0 * w0**2 * np.cross(r, j @ r)
    return np.concatenate([turning, momentum, -u])


@pytest.mark.slow
def test_continuous_model_against_an_adaptive_integrator(fly):
    flight = fly(rigid_spacecraft(inertia=NOMINAL_INERTIA, steps=4), Start(roll_deg=2.0), 1000.0)
    half = math.radians(1.0)
    k0 = ORBITAL_RATE_RAD_S * np.array([100.0, 6000.0, 114.0])
    y0 = np.concatenate([[math.cos(half), math.sin(half), 0.0, 0.0], k0, np.zeros(3)])
    # the limit of the torque is a corner: steps are kept short
    solved = solve_ivp(_equations, (0.0, 1000.0), y0, method="DOP853", rtol=1e-12, atol=1e-14, max_step=1.0).y[:, -1]
    turned = 2.0 * np.degrees(np.abs(np.array(flight.end[:4]) - solved[:4] / np.linalg.norm(solved[:4])).max())
    print(f"difference after 1000 s: {turned:.1e} deg")
    assert turned < 1e-7


def test_printed_sign_of_the_momentum_equation_breaks_conservation():
    j = np.diag([8000.0, 6000.0, 5000.0])

    def inertial_momentum_drift(sign):
        """Return how far the inertial momentum moves in 3000 s, relative; quaternion and momentum by hand."""

        def slope(y):
            s, v, k = y[0], y[1:4], y[4:7]
            w = np.linalg.solve(j, k)
            turning = 0.5 * np.concatenate([[-v @ w], s * w + np.cross(v, w)])
            return np.concatenate([turning, sign * np.cross(k, w)])

        def inertial(y):
            s, v, k = y[0], y[1:4], y[4:7]
            return (s * s - v @ v) * k + 2.0 * v * (v @ k) + 2.0 * s * np.cross(v, k)

        y0 = np.concatenate([[1.0, 0.0, 0.0, 0.0], j @ np.array([0.001, 0.002, -0.0015])])
        y = solve_ivp(lambda _t, y: slope(y), (0.0, 3000.0), y0, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        return float(np.linalg.norm(inertial(y) - inertial(y0)) / np.linalg.norm(y0[4:]))

    assert inertial_momentum_drift(1.0) < 1e-8
    assert inertial_momentum_drift(-1.0) > 0.3


def test_kernels_agree(fly):
    spacecraft = OrbitalFrameSpacecraft()
    one, other = fly(spacecraft, Start(yaw_deg=3.0), 200.0), fly_spacecraft(spacecraft, Start(yaw_deg=3.0), 200.0)
    assert np.abs(one.yaw_deg - other.yaw_deg).max() < 1e-9


@pytest.mark.slow
def test_yaw_from_anywhere(fly):
    for yaw_deg in (120.0, 170.0):
        flight = fly(rigid_spacecraft(), Start(yaw_deg=yaw_deg, is_literal=False), 8000.0)
        assert abs(flight.yaw_deg[-1]) < 0.1
    assert isinstance(rigid_spacecraft().inertia, Inertia)
