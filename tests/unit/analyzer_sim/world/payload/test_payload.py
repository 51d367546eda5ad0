"""Beams, dishes and the common downlink term."""

import itertools

import numpy as np
import pytest
from simulated_gain import attitude_gain_db

from analyzer_sim.world.orbit.orbit import Orbit
from analyzer_sim.world.payload.beams import Beam, Ripple
from analyzer_sim.world.payload.carriers import PLANS
from analyzer_sim.world.payload.dish import dish_loss_db, mispointing_deg
from analyzer_sim.world.payload.payload import dishes_loss_db, nominal_gain_db, sensitivity_db_per_deg

PLAN = PLANS["ku16"]
ORBIT = Orbit.drawn(1, 90.0, 1_793_491_200_000_000)
WEEK_US = ORBIT.start_us + np.arange(3 * 144, dtype=np.int64) * 600_000_000


def test_a_beam_falls_by_its_curvature() -> None:
    beam = Beam("b", 1.0, 2.0, 1.5, 2.7)
    # -1.5 / 2 at one degree of azimuth, -2.7 / 2 at one of elevation
    np.testing.assert_allclose(beam.gain_db(np.array([2.0, 1.0]), np.array([2.0, 3.0])), [-0.75, -1.35], atol=1e-12)


def test_a_ripple_adds_its_wave() -> None:
    plain, waved = Beam("b", 0.0, 0.0), Beam("b", 0.0, 0.0, ripples=(Ripple(0.1, 2.0, 0.0, 0.0),))
    point = np.array([np.pi / 2.0]), np.array([0.0])
    np.testing.assert_allclose(waved.gain_db(*point) - plain.gain_db(*point), [-0.1], atol=1e-12)


def test_curvature_is_near_the_stated_figures() -> None:
    step = 0.25
    for axis, expected in ((1, -2.7), (2, -1.5)):
        attitude = np.zeros((3, 3))
        attitude[0, axis], attitude[2, axis] = step, -step
        gain = nominal_gain_db(PLAN, ORBIT, attitude)
        curvature = (gain[0] - 2.0 * gain[1] + gain[2]) / step**2
        assert float(np.mean(curvature)) == pytest.approx(expected, abs=0.2)  # dB/deg^2, mean of the carriers
        assert float(np.std(curvature)) < 0.35  # nearly common


def test_the_downlink_is_common_to_all_carriers() -> None:
    attitude = np.array([[0.0, 0.3, 0.0], [0.0, 0.0, 0.3]])
    flat = Beam("flat", 0.0, 0.0, 0.0, 0.0)
    whole = nominal_gain_db(PLAN, ORBIT, attitude)
    alone = nominal_gain_db(
        type(PLAN)(PLAN.name, PLAN.beams, PLAN.carriers, PLAN.receiving_site, flat), ORBIT, attitude
    )
    assert float(np.max(np.ptp(whole - alone, axis=1))) < 1e-9  # rounding: one number for all


def test_body_held_to_nadir_makes_almost_no_harmonic() -> None:
    gain = attitude_gain_db(PLAN, ORBIT, WEEK_US, np.zeros((len(WEEK_US), 3)))
    # the spec computes 0.0006-0.007 dB for pointing to nadir; the frame also turns with the inclined orbit by up to
    # 0.05 deg of yaw, worth up to 0.017 dB at 0.34 dB/deg
    assert 0.0005 < float(np.abs(gain).max()) < 0.04


def test_sensitivities_have_the_stated_sizes() -> None:
    rms = np.sqrt(np.mean(sensitivity_db_per_deg(PLAN, ORBIT) ** 2, axis=0))
    np.testing.assert_allclose(rms, [0.16, 1.4, 1.2], rtol=0.1)  # dB/deg, figures of the method to 10 %


@pytest.mark.parametrize("seed", range(5))
def test_the_dishes_make_the_harmonics(seed: int) -> None:
    orbit = Orbit.drawn(seed, 90.0, ORBIT.start_us)
    loss = dishes_loss_db(PLAN, orbit, WEEK_US, seed)
    angle = 2.0 * np.pi * np.arange(len(WEEK_US)) / 144.0
    first, second = (2.0 * np.abs(np.exp(1j * k * angle) @ loss) / len(angle) for k in (1, 2))
    print(f"seed {seed}: first {first.round(2)} second {second.round(2)}")
    assert 0.2 < first.max() < 0.6  # the paper's carrier has 0.35 dB
    assert first.min() < 0.12  # wide dishes hardly notice
    assert 0.05 < second.max() <= 0.2  # inevitable at a width of 0.31 deg


def test_loss_is_counted_from_the_nominal_place() -> None:
    assert dish_loss_db(np.zeros((1, 2)), np.array([0.1, 0.2]), 0.5).tolist() == [0.0]


def test_mispointing_is_drawn_once_a_carrier() -> None:
    one = mispointing_deg(1, "c00", 0.5)
    assert one.tolist() == mispointing_deg(1, "c00", 0.5).tolist()
    assert 0.03 <= float(np.hypot(*one)) <= 0.06  # 0.06 to 0.12 of the width
    assert one.tolist() != mispointing_deg(1, "c01", 0.5).tolist()


def test_signals_keep_apart_from_one_another_and_from_the_noise_windows() -> None:
    edges = sorted((c.center_hz - c.bandwidth_hz / 2, c.center_hz + c.bandwidth_hz / 2) for c in PLAN.carriers)
    edges = sorted(edges + list(PLAN.noise_windows_hz))
    guards = [right[0] - left[1] for left, right in itertools.pairwise(edges)]
    assert min(guards) >= 0.2e6  # several times the resolution of 30 kHz
    assert edges[0][0] >= PLAN.span_hz[0]
    assert edges[-1][1] <= PLAN.span_hz[1]


def test_every_carrier_stands_twelve_db_above_the_noise() -> None:
    for carrier in PLAN.carriers:
        assert carrier.level_dbm - 10.0 * np.log10(carrier.symbol_rate_hz) - PLAN.noise_dbm_hz >= 12.0
        assert 0.6e6 <= carrier.bandwidth_hz <= 1.5e6


def test_no_transponder_holds_more_than_a_third_of_the_carriers() -> None:
    members = [carrier.transponder for carrier in PLAN.carriers]
    assert max(members.count(name) for name in PLAN.beams) <= 0.35 * len(members)
