"""The analysis of capture from plain numbers."""

import math

import pytest

from service.core.flexible.capture.capture_analysis import analyse_capture, perpetual_level

PLAIN = {
    "omega_rad_s": 1.0,
    "damping_ratio": 0.01,
    "coupling": 0.5,
    "inertia_kg_m2": 1000.0,
    "motor_torque_n_m": 0.2,
    "friction_torque_n_m": 1.05e-3,
    "alpha_rad": 0.0175,
    "beta_rad": 0.0349,
    "pulse_s": math.inf,
    "rate_rad_s": 1e-4,
}


def test_everything_that_is_shown():
    found = analyse_capture(**PLAIN, amplitude_rad=8e-3)
    assert found.p_cr_rad == pytest.approx(8.266190184e-3, rel=1e-9)
    assert found.p_min_rad == pytest.approx(8.397559867e-3, rel=1e-8)
    assert found.margin_rad == pytest.approx(found.p_cr_rad - 8e-3, rel=1e-12)
    assert found.swing == pytest.approx(2.0 * 8e-3 / 0.0349)
    assert (found.verdict, found.perpetual_capture) == ("free", "none")
    assert 0.0 < found.rigid_frequency_rad_s < 0.01


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({"amplitude_rad": 8.2e-3}, "free"),
        ({"amplitude_rad": 8.3e-3}, "captured"),
        ({"omega_rad_s": 0.25}, "always"),
    ],
)
def test_verdicts(changes, verdict):
    assert analyse_capture(**PLAIN | changes).verdict == verdict


def test_a_timed_pulse_is_harder_to_capture_and_holds_no_oscillation():
    relay, timed = (
        analyse_capture(**PLAIN | {"omega_rad_s": 0.5}),
        analyse_capture(**PLAIN | {"omega_rad_s": 0.5, "pulse_s": 1.0}),
    )
    assert timed.p_cr_rad > relay.p_cr_rad
    assert relay.p_inf_rad > 0.0
    assert timed.p_inf_rad == 0.0


@pytest.mark.parametrize(("share", "level"), [(0.9, "none"), (1.0, "none"), (1.5, "irregular"), (1.9, "possible")])
def test_levels_of_perpetual_capture(share, level):
    assert perpetual_level(share * 0.0349, 0.0349) == level


def test_friction_away_from_the_line_has_no_cycle_on_the_surface():
    assert math.isnan(analyse_capture(**PLAIN, is_friction_outward=False).rigid_frequency_rad_s)


def test_friction_inward_is_the_worse_case_of_a_motor():
    away, toward = analyse_capture(**PLAIN, is_friction_outward=False), analyse_capture(**PLAIN)
    none = analyse_capture(**PLAIN | {"friction_torque_n_m": 0.0})
    assert away.p_cr_rad < none.p_cr_rad < toward.p_cr_rad
    assert away.p_min_rad < none.p_min_rad < toward.p_min_rad
    # each by pi^2 / 4 of the friction's acceleration over w^2
    assert none.p_cr_rad - away.p_cr_rad == pytest.approx(0.25 * math.pi**2 * 1.05e-6, rel=1e-9)


def test_without_damping_formula_and_motion_agree_and_a_relay_keeps_no_amplitude():
    """The paper derives (12) to (20) at xi = 0."""
    found = analyse_capture(**PLAIN | {"damping_ratio": 0.0})
    assert found.p_min_rad == pytest.approx(found.p_cr_refined_rad, rel=1e-9)
    assert (found.p_inf_rad, found.perpetual_capture) == (math.inf, "possible")
    one_line = analyse_capture(**PLAIN | {"damping_ratio": 0.0, "alpha_rad": PLAIN["beta_rad"]})
    assert (one_line.p_inf_rad, one_line.perpetual_capture) == (0.0, "none")
    timed = analyse_capture(**PLAIN | {"damping_ratio": 0.0, "pulse_s": 1.0})
    assert (timed.p_inf_rad, timed.perpetual_capture) == (0.0, "none")


def test_a_body_at_rest_has_no_band():
    found = analyse_capture(**PLAIN | {"rate_rad_s": 0.0})
    assert math.isnan(found.band.low_rad_s)


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        ({"damping_ratio": -0.001}, "damping_ratio is -0.001"),
        ({"omega_rad_s": -1.0}, "omega_rad_s is -1"),
        ({"inertia_kg_m2": 0.0}, "inertia_kg_m2 is 0"),
        ({"motor_torque_n_m": 1e-3}, "friction_torque_n_m 0.00105 is not below motor_torque_n_m 0.001"),
        ({"friction_torque_n_m": -1.0}, "friction_torque_n_m is -1"),
        ({"alpha_rad": 1.0}, "alpha_rad 1 is not at or below"),
        ({"amplitude_rad": -1e-3}, "amplitude_rad is -0.001"),
        ({"rate_rad_s": math.nan}, "rate_rad_s is nan"),
        ({"pulse_s": 0.0}, "pulse_s is 0"),
    ],
)
def test_what_is_not_physical_is_refused(changes, reported):
    with pytest.raises(ValueError, match=reported):
        analyse_capture(**PLAIN | changes)
