"""Torque schedules of a flexible spacecraft."""

import math

import pytest

from service.core.flexible.schedule import ScheduleLimits, TorquePulse, carry_phasor, check_schedule, ordered_schedule
from service.core.flexible.spacecraft import HubMode

OMEGA, XI, KN = 0.6, 0.003, 0.4
PERIOD_S = 2.0 * math.pi / OMEGA
PLAIN = {
    "inertia_kg_m2": 5000.0,
    "modes": ((OMEGA, XI, KN),),
    "peak_allowed_rad": 1e-4,
}


def checked(*, pulses, modes, carried_rad=None, **limits):
    """Return the check of a schedule in plain numbers."""
    tones = tuple(HubMode(*mode) for mode in modes)
    carried = (0j,) * len(modes) if carried_rad is None else carried_rad
    return check_schedule(tuple(TorquePulse(*one) for one in pulses), ScheduleLimits(modes=tones, **limits), carried)


def repeated(count, apart_s, duration_s=1.0, torque_n_m=0.2):
    return tuple((k * apart_s, duration_s, torque_n_m) for k in range(count))


def test_a_single_pulse_is_accepted():
    found = checked(pulses=repeated(1, 1.0), **PLAIN)
    assert (found.verdict, found.suggestions) == ("accept", ())
    assert found.metrics.peak_rad == pytest.approx(3.088803e-5, rel=1e-6)
    assert found.metrics.nominal[0].peak_rad[0] == pytest.approx(2.614520e-5, rel=1e-6)
    assert found.metrics.worst_omega_rad_s == pytest.approx(0.85 * OMEGA)


def test_pulses_in_the_rhythm_of_the_panel_are_rejected_with_remedies_that_hold():
    pulses = repeated(10, PERIOD_S)
    found = checked(pulses=pulses, **PLAIN)
    assert found.verdict == "reject"
    kinds = {one.kind: one for one in found.suggestions}
    assert set(kinds) == {"split", "interval"}
    split_s = kinds["split"].value_s
    assert split_s == pytest.approx(math.pi / (OMEGA * math.sqrt(1.0 - XI**2)), rel=1e-12)
    halves = [(start + k * split_s, length, 0.5 * torque) for start, length, torque in pulses for k in range(2)]
    again = checked(pulses=tuple(halves), **PLAIN)
    assert (again.verdict, again.metrics.peak_rad) == ("accept", pytest.approx(kinds["split"].peak_rad, rel=1e-12))
    spaced = checked(pulses=repeated(10, kinds["interval"].value_s), **PLAIN)
    assert spaced.metrics.peak_rad == pytest.approx(kinds["interval"].peak_rad, rel=1e-12)
    assert found.suggestions[0].peak_rad <= found.suggestions[-1].peak_rad


def test_a_pulse_as_long_as_a_period_is_suggested_where_it_fits():
    found = checked(pulses=((0.0, 4.0, 0.2), (60.0, 4.0, 0.2)), **PLAIN | {"peak_allowed_rad": 5e-5})
    width = next(one for one in found.suggestions if one.kind == "width")
    assert width.value_s == pytest.approx(PERIOD_S, rel=1e-12)
    wide = tuple((start, PERIOD_S, 0.8 / PERIOD_S) for start in (0.0, 60.0))
    again = checked(pulses=wide, **PLAIN | {"peak_allowed_rad": 5e-5})
    assert again.metrics.residual_rad == pytest.approx(width.residual_rad, rel=1e-9)
    assert again.metrics.residual_rad < 0.5 * found.metrics.residual_rad


def test_what_swings_from_earlier_counts_and_waiting_is_suggested():
    strict = PLAIN | {"peak_allowed_rad": 5e-3}
    carried = checked(pulses=repeated(1, 1.0), **strict, carried_rad=(6e-3 + 0j,))
    assert carried.verdict == "reject"
    (wait,) = [one for one in carried.suggestions if one.kind == "wait"]
    faded = carry_phasor(6e-3 + 0j, HubMode(OMEGA, XI, KN), wait.value_s)
    again = checked(pulses=repeated(1, 1.0), **strict, carried_rad=(faded,))
    assert (again.verdict, wait.verdict) == ("accept", "accept")
    sooner = carry_phasor(6e-3 + 0j, HubMode(OMEGA, XI, KN), 0.9 * wait.value_s)
    assert checked(pulses=repeated(1, 1.0), **strict, carried_rad=(sooner,)).verdict == "reject"


def test_a_swing_undone_at_the_end_still_counts():
    # two halves of a large pulse: nearly nothing is left, but between them the panel swings
    half_s = math.pi / (OMEGA * math.sqrt(1.0 - XI**2))
    large = PLAIN | {"peak_allowed_rad": 1.0}
    found = checked(pulses=((0.0, 1.0, 50.0), (half_s, 1.0, 50.0)), **large)
    assert found.metrics.swing_rad > 1.5 * found.metrics.residual_rad


def test_modes_are_added_and_the_worst_is_named():
    both = checked(pulses=repeated(3, 7.0), **PLAIN | {"modes": ((2.0, 0.01, 0.1), (OMEGA, XI, KN))})
    alone = [
        checked(pulses=repeated(3, 7.0), **PLAIN | {"modes": (mode,)}).metrics.peak_rad
        for mode in ((2.0, 0.01, 0.1), (OMEGA, XI, KN))
    ]
    assert both.metrics.peak_rad == pytest.approx(sum(alone), rel=1e-12)
    assert both.metrics.worst_mode == 1


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
        ({"carried_rad": ()}, "carried_rad must hold one finite number for each of 1 modes"),
        ({"carried_rad": (complex(math.nan, 0.0),)}, "carried_rad must hold one finite number"),
    ],
)
def test_what_is_not_physical_is_refused(changes, reported):
    with pytest.raises(ValueError, match=reported):
        checked(**{"pulses": repeated(1, 1.0)} | PLAIN | changes)


def test_pulses_may_touch_and_come_in_any_order():
    touching = (TorquePulse(0.3, 0.1, 0.2), TorquePulse(0.1, 0.2, -0.2))
    assert ordered_schedule(touching) == (touching[1], touching[0])
