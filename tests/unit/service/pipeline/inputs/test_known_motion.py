"""Inputs of the motion: operations, rates, angles and torque of the catalogue."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from geometry_flight import HOUR, INERTIA, LONGITUDE_DEG, MINUTE, SITE, FlightPayload, S, applied_command

from service.pipeline.config import OperationConfig
from service.pipeline.inputs.declared_operations import CarrierIndices, declared_between, with_chain_step
from service.pipeline.inputs.known_motion import (
    DEG_H2_N_M,
    CommandedMotion,
    angle_inertia_kg_m2,
    commanded_arrays,
    consume,
    heard,
    momentum_model,
)
from service.pipeline.inputs.sensor_angles import inertial_deg_h
from service.records.calibration import AxesCheck, GatheredTorque, MotionVerdict
from service.records.catalogue import AxisTorques, FedForwardTorque, Spacecraft, WheelMomentum
from service.records.inputs import Correction, Operation
from service.records.levels.attitude import Axes, Pulse, ReportedCommand

CRAFT = Spacecraft("yamal-test", "Test", LONGITUDE_DEG, SITE, INERTIA, 0.05)
NAN = float("nan")
#: figures are sums of a few shares of numbers near one
EXACT = 1e-12


def command(*pulses, epoch_us=0, number=7):
    return applied_command(epoch_us, pulses, number)


def gained_deg_h(torque_n_m, duration_s, inertia_kg_m2):
    """Return the rate that a torque leaves."""
    return float(np.degrees(torque_n_m * duration_s / inertia_kg_m2) * 3600.0)


def walked(commanded, epochs_us):
    """Return angle and rate (K, 3) after each row, as the filter without coupling integrates what it is told."""
    angle, rate = np.zeros(3), np.zeros(3)
    angles, rates = [], []
    for before_us, now_us in pairwise(epochs_us):
        known, commanded = consume(commanded, before_us, now_us)
        hours = (now_us - before_us) / HOUR
        angle = angle + known.correction_deg + known.late_correction_deg
        angle = angle + hours * rate + 0.5 * hours * known.rate_change_deg_h
        rate = rate + known.rate_change_deg_h
        angles.append(angle)
        rates.append(rate)
    return np.array(angles), np.array(rates)


def test_a_correction_is_spread_evenly_over_its_interval():
    reported = heard(CommandedMotion(0), Correction(2 * MINUTE, 6 * MINUTE, Axes(0.4, -0.2, NAN)), None, 0)
    angles, rates = walked(reported, [0, 1 * MINUTE, 3 * MINUTE, 5 * MINUTE, 7 * MINUTE, 9 * MINUTE])
    share = np.array([0.0, 0.25, 0.75, 1.0, 1.0])
    np.testing.assert_allclose(angles, share[:, None] * np.array([0.4, -0.2, 0.0]), atol=EXACT)
    np.testing.assert_array_equal(rates, 0.0)


def test_what_was_commanded_before_the_alignment_belongs_to_it():
    reported = heard(CommandedMotion(4 * MINUTE), Correction(0, 8 * MINUTE, Axes(0.0, 0.8, 0.0)), None, 4 * MINUTE)
    assert reported.late_deg == (0.0, 0.0, 0.0)
    # a step that begins before the alignment takes only what comes after it
    known, left = consume(reported, 2 * MINUTE, 6 * MINUTE)
    np.testing.assert_allclose(known.correction_deg, [0.0, 0.2, 0.0], atol=EXACT)
    known, left = consume(left, 6 * MINUTE, 20 * MINUTE)
    np.testing.assert_allclose(known.correction_deg, [0.0, 0.2, 0.0], atol=EXACT)
    assert left.motions == ()


@pytest.mark.parametrize("seed", range(5))
def test_corrections_may_come_in_any_order_and_a_row_is_given_none_that_lies_ahead(seed):
    rng = np.random.default_rng(seed)
    starts = np.sort(rng.integers(0, 500, 300))
    corrections = [Correction(s * MINUTE, (s + 1 + k % 40) * MINUTE, Axes(1.0, k, -k)) for k, s in enumerate(starts)]
    in_order, shuffled = CommandedMotion(0), CommandedMotion(0)
    for correction in corrections:
        in_order = heard(in_order, correction, None, 0)
    for k in rng.permutation(len(corrections)):
        shuffled = heard(shuffled, corrections[k], None, 0)
    epochs_us = [0, *(np.sort(rng.choice(520, 60, replace=False)) + 20) * MINUTE]
    for commanded in (in_order, shuffled):
        starts_us = commanded_arrays(commanded, 100 * MINUTE).motions["start_us"]
        np.testing.assert_array_equal(starts_us, starts[starts < 100] * MINUTE)
    np.testing.assert_allclose(walked(shuffled, epochs_us)[0], walked(in_order, epochs_us)[0], rtol=EXACT, atol=1e-9)
    total_deg = sum(np.array(each.change_deg) for each in corrections)
    np.testing.assert_allclose(walked(in_order, [*epochs_us, 600 * MINUTE])[0][-1], total_deg, rtol=EXACT, atol=1e-9)


@pytest.mark.parametrize("known_at_s", [95, 110, 200, 900])
def test_a_pulse_that_becomes_known_late_is_caught_up_with(known_at_s):
    pulse = Pulse(90 * S, 20.0, Axes(0.0, 0.01, 0.0))
    in_time = heard(CommandedMotion(0), command(pulse), CRAFT, 0)
    late = heard(CommandedMotion(0), command(pulse), CRAFT, known_at_s * S)
    epochs_us = [known_at_s * S, known_at_s * S + 60 * S, 1200 * S, 1260 * S]
    angles, rates = walked(late, epochs_us)
    wanted, wanted_rates = walked(in_time, [0, *epochs_us[1:]])
    np.testing.assert_allclose(angles, wanted, atol=EXACT)
    np.testing.assert_allclose(rates, wanted_rates, atol=EXACT)


def test_a_pulse_without_length_and_a_command_without_a_craft_do_nothing():
    still = heard(CommandedMotion(0), command(Pulse(60 * S, 0.0, Axes(0.1, 0.1, 0.1))), CRAFT, 0)
    angles, rates = walked(still, [0, 120 * S])
    np.testing.assert_array_equal(angles, 0.0)
    np.testing.assert_array_equal(rates, 0.0)
    unknown = heard(CommandedMotion(0), command(Pulse(60 * S, 9.0, Axes(0.1, 0.1, 0.1))), None, 0)
    assert unknown == CommandedMotion(0)


# ---- commands that end one another ----------------------------------------------------------------------------------


@pytest.mark.parametrize("newest_min", [0, 5, 11], ids=["before", "within the pulse", "after the next began"])
def test_a_command_that_counts_as_applied_ends_the_pulses_of_the_one_before(newest_min):
    """Ten minutes of 1e-4 N m of which the next command leaves six; whatever rows had already consumed."""
    first = command(Pulse(2 * MINUTE, 600.0, Axes(0.0, 1e-4, 0.0)), Pulse(30 * MINUTE, 9.0, Axes(0.0, 1e-4, 0.0)))
    second = command(Pulse(20 * MINUTE, 60.0, Axes(0.0, 0.0, 1e-4)), epoch_us=8 * MINUTE, number=8)
    commanded = heard(CommandedMotion(0), first, CRAFT, 0)
    angle, rate = np.zeros(3), np.zeros(3)
    for minute in range(1, 41):
        if minute == newest_min + 1:
            commanded = heard(commanded, second, CRAFT, newest_min * MINUTE)
        known, commanded = consume(commanded, (minute - 1) * MINUTE, minute * MINUTE)
        angle = angle + known.correction_deg + known.late_correction_deg + (rate + 0.5 * known.rate_change_deg_h) / 60.0
        rate = rate + known.rate_change_deg_h
    expected = [0.0, gained_deg_h(1e-4, 360.0, INERTIA[0][0]), gained_deg_h(1e-4, 60.0, INERTIA[1][1])]
    np.testing.assert_allclose(rate, expected, rtol=EXACT)
    # each acts from the middle of its pulse on, in hours
    np.testing.assert_allclose(angle, np.array(expected) * [0.0, 35.0 / 60.0, 19.5 / 60.0], rtol=1e-9)


def test_an_older_command_and_a_report_end_nothing():
    first = command(Pulse(10 * MINUTE, 60.0, Axes(0.0, 1e-4, 0.0)), number=9)
    older = command(epoch_us=5 * MINUTE, number=8)
    report = ReportedCommand(3, 5 * MINUTE, (Pulse(6 * MINUTE, 60.0, Axes(1e-4, 0.0, 0.0)),))
    commanded = CommandedMotion(0)
    for content in (first, older, report):
        commanded = heard(commanded, content, CRAFT, 0)
    known, _ = consume(commanded, 0, 20 * MINUTE)
    expected = [gained_deg_h(1e-4, 60.0, INERTIA[2][2]), gained_deg_h(1e-4, 60.0, INERTIA[0][0]), 0.0]
    np.testing.assert_allclose(known.rate_change_deg_h, expected, rtol=EXACT)


CONFIG = OperationConfig()
NAMES = CarrierIndices(("a", "b", "c", "d"), ("K1", "K2"), np.array([0, 0, 1, 1]))


def operation(kind, start_us=2 * HOUR, stop_us=3 * HOUR, **changes):
    return Operation(1, kind, start_us, stop_us, **changes)


def reported(kind, from_us, to_us, **changes):
    return declared_between((operation(kind, **changes),), NAMES, from_us, to_us, CONFIG)


@pytest.mark.parametrize(
    "kind",
    [
        "station_keeping",
        "momentum_unloading",
        "eclipse",
        "sun_outage",
        "carrier_work",
        "gain_change",
        "receive_chain_work",
        "calibration_turn",
        "other",
    ],
)
def test_before_and_after_an_operation_nothing_is_declared(kind):
    assert reported(kind, HOUR, 2 * HOUR - S) is None
    assert reported(kind, 5 * HOUR, 5 * HOUR + MINUTE) is None
    assert declared_between((), NAMES, 0, HOUR, CONFIG) is None


@pytest.mark.parametrize(
    ("kind", "usual_deg"),
    [("station_keeping", 0.1), ("momentum_unloading", 0.05), ("calibration_turn", 0.5), ("other", 0.0)],
)
def test_an_operation_that_turns_the_craft_lets_it_walk_to_its_uncertainty(kind, usual_deg):
    steps = np.arange(HOUR, 4 * HOUR + 1, 7 * MINUTE)
    variance = np.zeros(3)
    for from_us, to_us in zip(steps[:-1].tolist(), steps[1:].tolist(), strict=True):
        declared = reported(kind, from_us, to_us)
        if declared is not None:
            variance += declared.attitude_walk_deg**2 * (to_us - from_us) / HOUR
            assert not declared.is_masked.any()
            assert not declared.attitude_step_deg.any()
    np.testing.assert_allclose(np.sqrt(variance), usual_deg, atol=EXACT)


def test_a_stated_uncertainty_replaces_the_usual_one_axis_by_axis():
    stated = Axes(0.3, float("nan"), 0.2)
    declared = reported("station_keeping", 2 * HOUR, 3 * HOUR, attitude_uncertainty_deg=stated)
    np.testing.assert_allclose(declared.attitude_walk_deg, [0.3, 0.0, 0.2], atol=EXACT)


def test_an_operation_without_end_spreads_its_uncertainty_over_an_hour_and_goes_on():
    declared = reported("momentum_unloading", 20 * HOUR, 20 * HOUR + MINUTE, stop_us=None)
    np.testing.assert_allclose(declared.attitude_walk_deg, 0.05, atol=EXACT)


def test_a_short_burn_within_one_step_leaves_all_of_its_uncertainty():
    declared = reported("station_keeping", HOUR, 5 * HOUR, stop_us=2 * HOUR + MINUTE)
    np.testing.assert_allclose(declared.attitude_walk_deg * 2.0, 0.1, atol=EXACT)
    instant = reported("station_keeping", HOUR, 5 * HOUR, stop_us=2 * HOUR)
    np.testing.assert_array_equal(instant.attitude_walk_deg, 0.0)


def test_an_eclipse_moves_transponders_and_levels_until_an_hour_after():
    during = reported("eclipse", 2 * HOUR, 2 * HOUR + 30 * MINUTE)
    np.testing.assert_allclose(during.group_step_db, 0.3 * np.sqrt(0.5), atol=EXACT)
    np.testing.assert_allclose(during.reference_walk_db, 0.06, atol=EXACT)
    np.testing.assert_array_equal(during.attitude_walk_deg, 0.0)
    warming = reported("eclipse", 3 * HOUR + 30 * MINUTE, 5 * HOUR, transponders=("K2",))
    np.testing.assert_allclose(warming.group_step_db, [0.0, 0.3 * np.sqrt(0.5)], atol=EXACT)
    assert reported("eclipse", 4 * HOUR, 5 * HOUR) is None
    assert not during.is_masked.any()
    stated = reported("eclipse", 2 * HOUR, 3 * HOUR, attitude_uncertainty_deg=Axes(0.0, 0.06, 0.0))
    np.testing.assert_allclose(stated.attitude_walk_deg, [0.0, 0.06, 0.0], atol=EXACT)
    assert reported("eclipse", 9 * HOUR, 10 * HOUR, stop_us=None).group_step_db[0] == pytest.approx(0.3, abs=EXACT)


@pytest.mark.parametrize(
    ("named", "masked"),
    [
        pytest.param({}, [1, 1, 1, 1], id="all"),
        pytest.param({"carriers": ("b", "z")}, [0, 1, 0, 0], id="by id, unknown ones passed over"),
        pytest.param({"transponders": ("K2",)}, [0, 0, 1, 1], id="by transponder"),
        pytest.param({"carriers": ("a",), "transponders": ("K2",)}, [1, 0, 1, 1], id="both"),
        pytest.param({"carriers": ()}, [0, 0, 0, 0], id="none"),
    ],
)
@pytest.mark.parametrize("kind", ["sun_outage", "carrier_work"])
def test_carriers_are_masked_while_an_operation_lasts(kind, named, masked):
    inside = reported(kind, 2 * HOUR + MINUTE, 2 * HOUR + 2 * MINUTE, **named)
    np.testing.assert_array_equal(inside.is_masked, np.array(masked, dtype=bool))
    # start inclusive, stop exclusive
    assert reported(kind, HOUR, 2 * HOUR, **named).is_masked.tolist() == [bool(one) for one in masked]
    assert not reported(kind, 2 * HOUR + MINUTE, 3 * HOUR, **named).is_masked.any()


def test_work_on_carriers_frees_their_references_at_both_ends():
    for from_us, to_us, steps in (
        (HOUR, 2 * HOUR, 1),
        (2 * HOUR, 3 * HOUR - S, 0),
        (2 * HOUR, 3 * HOUR, 1),
        (HOUR, 4 * HOUR, 2),
    ):
        declared = reported("carrier_work", from_us, to_us, carriers=("c",))
        np.testing.assert_allclose(declared.reference_step_db, [0, 0, 3.0 * np.sqrt(steps), 0], atol=EXACT)


def test_a_change_of_gain_moves_the_carriers_of_a_transponder_together_at_both_ends():
    begun = reported("gain_change", HOUR, 2 * HOUR, transponders=("K1",))
    np.testing.assert_allclose(begun.group_step_db, [2.0, 0.0], atol=EXACT)
    np.testing.assert_array_equal(begun.reference_step_db, 0.0)
    np.testing.assert_array_equal(reported("gain_change", 2 * HOUR, 2 * HOUR + MINUTE).group_step_db, 0.0)
    np.testing.assert_allclose(reported("gain_change", 2 * HOUR, 3 * HOUR).group_step_db, 2.0, atol=EXACT)


def test_work_on_the_receiving_chain_lets_the_common_level_walk_and_step():
    begun = reported("receive_chain_work", HOUR, 2 * HOUR)
    assert begun.chain_step_db == pytest.approx(2.0, abs=EXACT)
    assert begun.chain_walk_db == 0.0
    during = reported("receive_chain_work", 2 * HOUR, 2 * HOUR + 30 * MINUTE)
    assert during.chain_walk_db == pytest.approx(2.0, abs=EXACT)
    assert during.chain_step_db == 0.0
    assert not during.is_masked.any()


def test_operations_add():
    both = (operation("gain_change"), operation("receive_chain_work"), operation("carrier_work", carriers=("a",)))
    declared = declared_between((*both, *both), NAMES, HOUR, 2 * HOUR, CONFIG)
    np.testing.assert_allclose(declared.group_step_db, 2.0 * np.sqrt(2.0), atol=EXACT)
    assert declared.chain_step_db == pytest.approx(2.0 * np.sqrt(2.0), abs=EXACT)
    assert declared.reference_step_db[0] == pytest.approx(3.0 * np.sqrt(2.0), abs=EXACT)
    assert declared.is_masked.tolist() == [True, False, False, False]


def test_another_source_is_a_step_of_the_chain():
    alone = with_chain_step(None, NAMES, 2.0)
    assert alone.chain_step_db == 2.0
    assert not any(np.any(value) for name, value in alone._asdict().items() if name != "chain_step_db")
    worked = reported("receive_chain_work", HOUR, 2 * HOUR)
    assert with_chain_step(worked, NAMES, 1.5).chain_step_db == pytest.approx(2.5, abs=EXACT)


def test_a_body_that_points_at_the_earth_has_no_rate():
    still = Axes(0.0, 0.0, -np.rad2deg(7.2921159e-5))
    np.testing.assert_allclose(
        inertial_deg_h([still, Axes(1.0, 2.0, still.pitch)]), [[0, 0, 0], [3600, 7200, 0]], atol=1e-4
    )
    assert inertial_deg_h([]).shape == (0, 3)


TORQUE_N_M = (1e-6, 2e-6, 3e-6, 0.0, 1e-5, 0.0, 1e-5, 0.0, -1e-5)
GATHERED = GatheredTorque(
    (*TORQUE_N_M, 0.01, -0.02, 1e-3, 2e-3), tuple(map(tuple, (1e-16 * np.eye(13)).tolist())), 800, 0
)
DAY_US = 86_400_000_000


@pytest.fixture
def spacecraft():
    record = FlightPayload.make(8, 1).spacecraft()
    return replace(record, onboard=replace(record.onboard, momentum=WheelMomentum()))


@pytest.fixture
def calibration():
    made = FlightPayload.make(8, 1).calibration()
    assert made.result is not None
    return replace(made, result=replace(made.result, gathered=GATHERED))


def test_what_quiet_days_told_takes_the_place_of_the_catalogue(spacecraft, calibration):
    stated = WheelMomentum(torque=FedForwardTorque(epoch_us=0, constant_n_m=AxisTorques(yaw=1.0)))
    for momentum in (WheelMomentum(), stated):
        record = replace(spacecraft, onboard=replace(spacecraft.onboard, momentum=momentum))
        model = momentum_model(record, calibration)
        assert model.profile is None
        expected = np.array(TORQUE_N_M) / DEG_H2_N_M / np.tile(angle_inertia_kg_m2(record), 3)
        np.testing.assert_allclose(model.learned.mean[:9], expected, rtol=1e-12)
        assert model.learned.mean[9:] == GATHERED.mean[9:]
        # a sigma of 1e-8 N m is nothing beside what may have changed: a tenth of all, a hundredth of an axis
        sigma = np.sqrt(np.diag(np.array(model.learned.covariance)))[:9]
        np.testing.assert_allclose(sigma, np.hypot(0.1, 0.01) * np.abs(expected), atol=1e-8 / DEG_H2_N_M / 300.0)


def test_it_is_known_less_well_by_the_time(spacecraft, calibration):
    fresh, old = (momentum_model(spacecraft, calibration, days * DAY_US) for days in (0, 30))
    assert fresh.learned.mean == old.learned.mean
    grown = np.diag(np.array(old.learned.covariance) - np.array(fresh.learned.covariance))
    parts = np.array(fresh.learned.mean[:9]).reshape(3, 3)
    # 1 % a day: in a month 30 % of the whole torque about the axis
    np.testing.assert_allclose(grown[:9], np.tile(0.09 * np.square(parts).sum(axis=0), 3), rtol=1e-2)
    assert (grown[9:] == 0.0).all()


def test_a_profile_that_is_fed_forward_keeps_its_own_error(spacecraft, calibration):
    onboard = replace(spacecraft.onboard, fed_forward_torque=FedForwardTorque(epoch_us=0))
    record = replace(spacecraft, onboard=onboard)
    assert momentum_model(record, calibration) == momentum_model(record)


def test_telemetry_that_is_contradicted_or_not_used_has_no_model(spacecraft, calibration):
    assert calibration.result is not None
    check = AxesCheck(MotionVerdict.CONTRADICTED, "wrong")
    wrong = replace(calibration, result=replace(calibration.result, momentum=check))
    assert momentum_model(spacecraft, wrong) is None
    unused = replace(spacecraft, onboard=replace(spacecraft.onboard, momentum=WheelMomentum(used=False)))
    assert momentum_model(unused, calibration) is None
    assert momentum_model(None) is None
