"""Schedules and captures of a flexible spacecraft."""

import math

import pytest

from service.core.flexible.capture import analyse_capture, perpetual_level
from service.core.flexible.schedule import TorquePulse, analyse_schedule, carry_phasor, ordered_schedule
from service.core.flexible.spacecraft import HubMode

OMEGA, XI, KN = 0.6, 0.003, 0.4
PERIOD_S = 2.0 * math.pi / OMEGA
PLAIN = {
    "inertia_kg_m2": 5000.0,
    "modes": ((OMEGA, XI, KN),),
    "peak_allowed_rad": 1e-4,
    "alpha_rad": 0.0175,
    "beta_rad": 0.0349,
    "pulse_s": 1.0,
    "motor_torque_n_m": 0.2,
}


def repeated(count, apart_s, duration_s=1.0, torque_n_m=0.2):
    return tuple((k * apart_s, duration_s, torque_n_m) for k in range(count))


def test_a_single_pulse_is_accepted():
    found = analyse_schedule(pulses=repeated(1, 1.0), **PLAIN)
    assert (found.verdict, found.reasons, found.suggestions) == ("accept", (), ())
    assert found.peak_rad == pytest.approx(3.088803e-5, rel=1e-6)
    assert found.nominal_peak_rad[0] == pytest.approx(2.614520e-5, rel=1e-6)
    assert found.worst_omega_rad_s == pytest.approx(0.85 * OMEGA)


def test_pulses_in_the_rhythm_of_the_panel_are_rejected_with_remedies_that_hold():
    pulses = repeated(10, PERIOD_S)
    found = analyse_schedule(pulses=pulses, **PLAIN)
    assert (found.verdict, found.reasons) == ("reject", ("peak",))
    kinds = {one.kind: one for one in found.suggestions}
    assert set(kinds) == {"split", "interval"}
    split_s = kinds["split"].value_s
    assert split_s == pytest.approx(math.pi / (OMEGA * math.sqrt(1.0 - XI**2)), rel=1e-12)
    halves = [(start + k * split_s, length, 0.5 * torque) for start, length, torque in pulses for k in range(2)]
    again = analyse_schedule(pulses=tuple(halves), **PLAIN)
    assert (again.verdict, again.peak_rad) == ("accept", pytest.approx(kinds["split"].peak_rad, rel=1e-12))
    spaced = analyse_schedule(pulses=repeated(10, kinds["interval"].value_s), **PLAIN)
    assert spaced.peak_rad == pytest.approx(kinds["interval"].peak_rad, rel=1e-12)
    assert found.suggestions[0].peak_rad <= found.suggestions[-1].peak_rad


def test_a_pulse_as_long_as_a_period_is_suggested_where_it_fits():
    found = analyse_schedule(pulses=((0.0, 4.0, 0.2), (60.0, 4.0, 0.2)), **PLAIN | {"peak_allowed_rad": 5e-5})
    width = next(one for one in found.suggestions if one.kind == "width")
    assert width.value_s == pytest.approx(PERIOD_S, rel=1e-12)
    wide = tuple((start, PERIOD_S, 0.8 / PERIOD_S) for start in (0.0, 60.0))
    again = analyse_schedule(pulses=wide, **PLAIN | {"peak_allowed_rad": 5e-5})
    assert again.residual_rad == pytest.approx(width.residual_rad, rel=1e-9)
    assert again.residual_rad < 0.5 * found.residual_rad
    assert again.momentum_n_m_s == pytest.approx(found.momentum_n_m_s, rel=1e-12)


def test_what_swings_from_earlier_counts_and_waiting_is_suggested():
    relay = PLAIN | {"pulse_s": math.inf, "peak_allowed_rad": 1e-2}
    carried = analyse_schedule(pulses=repeated(1, 1.0), **relay, carried_rad=(6e-3 + 0j,))
    assert carried.reasons == ("near_capture",)
    (wait,) = [one for one in carried.suggestions if one.kind == "wait"]
    faded = carry_phasor(6e-3 + 0j, HubMode(OMEGA, XI, KN), wait.value_s)
    again = analyse_schedule(pulses=repeated(1, 1.0), **relay, carried_rad=(faded,))
    assert (again.verdict, wait.verdict) == ("accept", "accept")
    sooner = carry_phasor(6e-3 + 0j, HubMode(OMEGA, XI, KN), 0.9 * wait.value_s)
    assert analyse_schedule(pulses=repeated(1, 1.0), **relay, carried_rad=(sooner,)).verdict == "warn"


def test_a_swing_above_the_boundary_is_rejected():
    found = analyse_schedule(pulses=(), **PLAIN | {"peak_allowed_rad": 1.0}, carried_rad=(9e-3 + 0j,))
    assert found.reasons == ("captured",)
    assert found.margin_rad < 0.0


def test_a_regulator_that_every_switching_captures_is_rejected():
    slow = PLAIN | {"modes": ((0.1, XI, KN),), "pulse_s": math.inf, "peak_allowed_rad": 1.0}
    found = analyse_schedule(pulses=repeated(1, 1.0, torque_n_m=1e-4), **slow)
    assert "always_captured" in found.reasons
    assert found.p_cr_rad <= 0.0


def test_a_relay_that_may_hold_its_oscillation_is_warned_of():
    strong = PLAIN | {"modes": ((0.6, 0.0005, 5.0),), "pulse_s": math.inf, "inertia_kg_m2": 1000.0}
    found = analyse_schedule(pulses=repeated(1, 1.0, torque_n_m=1e-4), **strong)
    assert (found.verdict, found.reasons) == ("warn", ("perpetual_capture",))
    assert found.p_inf_rad > 0.0349


def test_a_swing_undone_at_the_end_still_counts():
    # two halves of a large pulse: nearly nothing is left, but between them the panel swings
    half_s = math.pi / (OMEGA * math.sqrt(1.0 - XI**2))
    large = PLAIN | {"peak_allowed_rad": 1.0}
    found = analyse_schedule(pulses=((0.0, 1.0, 50.0), (half_s, 1.0, 50.0)), **large)
    assert found.swing_rad > 1.5 * found.residual_rad
    assert found.margin_rad == pytest.approx(found.p_cr_rad - found.swing_rad, rel=1e-12)
    assert found.verdict != "accept"


def test_momentum_is_followed_pulse_by_pulse():
    pulses = ((0.0, 10.0, 0.2), (20.0, 10.0, -0.2))
    wheel = {"momentum_n_m_s": 9.0, "momentum_limit_n_m_s": 10.0}
    found = analyse_schedule(pulses=pulses, **PLAIN | {"peak_allowed_rad": 1.0}, **wheel)
    assert found.momentum_n_m_s == pytest.approx((9.0, 11.0))
    assert found.reasons == ("momentum",)


def test_modes_are_added_and_the_worst_is_named():
    both = analyse_schedule(pulses=repeated(3, 7.0), **PLAIN | {"modes": ((2.0, 0.01, 0.1), (OMEGA, XI, KN))})
    alone = [
        analyse_schedule(pulses=repeated(3, 7.0), **PLAIN | {"modes": (mode,)}).peak_rad
        for mode in ((2.0, 0.01, 0.1), (OMEGA, XI, KN))
    ]
    assert both.peak_rad == pytest.approx(sum(alone), rel=1e-12)
    assert both.worst_mode == 1


def test_without_a_regulator_only_peak_and_momentum_count():
    bare = {key: PLAIN[key] for key in ("inertia_kg_m2", "modes", "peak_allowed_rad")}
    found = analyse_schedule(pulses=repeated(1, 1.0), **bare)
    assert (found.verdict, found.p_cr_rad, found.p_inf_rad) == ("accept", math.inf, 0.0)


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        ({"pulses": ((0.0, 2.0, 0.1), (1.5, 1.0, 0.1))}, r"the pulse at 1.5 s begins before the one at 0 s has ended"),
        ({"pulses": ((0.0, 0.0, 0.1),)}, r"pulses\[0\].duration_s is 0"),
        ({"pulses": ((-1.0, 1.0, 0.1),)}, r"pulses\[0\].start_s is -1"),
        ({"pulses": ((0.0, 1.0, math.nan),)}, r"pulses\[0\].torque_n_m is nan"),
        ({"modes": ()}, "no flexible mode is given"),
        ({"modes": ((0.6, 0.0, 0.4),)}, "damping_ratio is 0"),
        ({"modes": ((0.6, 1.0, 0.4),)}, "damping_ratio is 1"),
        ({"inertia_kg_m2": -1.0}, "inertia_kg_m2 is -1"),
        ({"peak_allowed_rad": 0.0}, "peak_allowed_rad is 0"),
        ({"alpha_rad": 0.04}, "alpha_rad 0.04 is not at or below"),
        ({"pulse_s": -1.0}, "pulse_s is -1"),
        ({"motor_torque_n_m": None}, "a regulator needs all of"),
        ({"friction_torque_n_m": 0.3}, "friction_torque_n_m 0.3 is not below motor_torque_n_m 0.2"),
        ({"momentum_limit_n_m_s": 0.0}, "momentum_limit_n_m_s is 0"),
        ({"momentum_n_m_s": 30.0, "momentum_limit_n_m_s": 20.0}, "momentum_n_m_s is 30, beyond"),
        ({"carried_rad": ()}, "carried_rad must hold one finite number for each of 1 modes"),
        ({"carried_rad": (complex(math.nan, 0.0),)}, "carried_rad must hold one finite number"),
    ],
)
def test_what_is_not_physical_is_refused(changes, reported):
    with pytest.raises(ValueError, match=reported):
        analyse_schedule(**{"pulses": repeated(1, 1.0)} | PLAIN | changes)


def test_pulses_may_touch_and_come_in_any_order():
    touching = (TorquePulse(0.3, 0.1, 0.2), TorquePulse(0.1, 0.2, -0.2))
    assert ordered_schedule(touching) == (touching[1], touching[0])


CAPTURE = {
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
    found = analyse_capture(**CAPTURE, amplitude_rad=8e-3)
    assert found.p_cr_rad == pytest.approx(8.266190184e-3, rel=1e-9)
    assert found.p_min_rad == pytest.approx(8.397559867e-3, rel=1e-8)
    assert found.margin_rad == pytest.approx(found.p_cr_rad - 8e-3, rel=1e-12)
    assert found.swing == pytest.approx(2.0 * 8e-3 / 0.0349)
    assert (found.verdict, found.perpetual_capture) == ("free", "none")
    assert 0.0 < found.rigid_frequency_rad_s < 0.01


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [({"amplitude_rad": 8.2e-3}, "free"), ({"amplitude_rad": 8.3e-3}, "captured"), ({"omega_rad_s": 0.25}, "always")],
)
def test_verdicts(changes, verdict):
    assert analyse_capture(**CAPTURE | changes).verdict == verdict


def test_a_timed_pulse_is_harder_to_capture_and_holds_no_oscillation():
    relay, timed = (
        analyse_capture(**CAPTURE | {"omega_rad_s": 0.5}),
        analyse_capture(**CAPTURE | {"omega_rad_s": 0.5, "pulse_s": 1.0}),
    )
    assert timed.p_cr_rad > relay.p_cr_rad
    assert relay.p_inf_rad > 0.0
    assert timed.p_inf_rad == 0.0


@pytest.mark.parametrize(("share", "level"), [(0.9, "none"), (1.0, "none"), (1.5, "irregular"), (1.9, "possible")])
def test_levels_of_perpetual_capture(share, level):
    assert perpetual_level(share * 0.0349, 0.0349) == level


def test_friction_away_from_the_line_has_no_cycle_on_the_surface():
    assert math.isnan(analyse_capture(**CAPTURE, is_friction_outward=False).rigid_frequency_rad_s)


def test_friction_inward_is_the_worse_case_of_a_motor():
    away, toward = (analyse_capture(**CAPTURE, is_friction_outward=False), analyse_capture(**CAPTURE))
    none = analyse_capture(**CAPTURE | {"friction_torque_n_m": 0.0})
    assert away.p_cr_rad < none.p_cr_rad < toward.p_cr_rad
    assert away.p_min_rad < none.p_min_rad < toward.p_min_rad
    # each by pi^2 / 4 of the friction's acceleration over w^2
    assert none.p_cr_rad - away.p_cr_rad == pytest.approx(0.25 * math.pi**2 * 1.05e-6, rel=1e-9)


def test_without_damping_formula_and_motion_agree_and_a_relay_keeps_no_amplitude():
    """The paper derives (12) to (20) at xi = 0."""
    found = analyse_capture(**CAPTURE | {"damping_ratio": 0.0})
    assert found.p_min_rad == pytest.approx(found.p_cr_refined_rad, rel=1e-9)
    assert (found.p_inf_rad, found.perpetual_capture) == (math.inf, "possible")
    one_line = analyse_capture(**CAPTURE | {"damping_ratio": 0.0, "alpha_rad": CAPTURE["beta_rad"]})
    assert (one_line.p_inf_rad, one_line.perpetual_capture) == (0.0, "none")
    timed = analyse_capture(**CAPTURE | {"damping_ratio": 0.0, "pulse_s": 1.0})
    assert (timed.p_inf_rad, timed.perpetual_capture) == (0.0, "none")


def test_a_body_at_rest_has_no_band():
    found = analyse_capture(**CAPTURE | {"rate_rad_s": 0.0})
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
def test_a_capture_that_is_not_physical_is_refused(changes, reported):
    with pytest.raises(ValueError, match=reported):
        analyse_capture(**CAPTURE | changes)
