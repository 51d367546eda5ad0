"""Parts of both methods: results of carriers, inhibitions and disagreement."""

import math
from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import START_US, Flight, FlightPayload

from service.pipeline.config import InterlockConfig, RobustConfig
from service.pipeline.estimation.method import CalibratedColumns
from service.pipeline.estimation.row_inhibitions import INHIBITIONS, Disagreement, compare, judge
from service.records.catalogue import LIVE_METHODS, CarrierPlan, Method, Station
from service.records.levels.attitude import (
    CARRIER_HYPOTHESES,
    CARRIER_STATES,
    Axes,
    Status,
    row_without_attitude,
)
from service.records.levels.measurement import Measurement

PAYLOAD = FlightPayload.make(5)
PLAN = PAYLOAD.plan()


def row(power, flags=None):
    return Measurement(START_US, START_US, 1, "sa-1", 1, np.array(power, dtype=np.float64), flags)


def test_the_own_plan_passes_as_it_is():
    columns = CalibratedColumns(PAYLOAD.ids, PLAN)
    np.testing.assert_array_equal(columns.power_dbm(row([1, 2, np.nan, 4, 5]), PLAN), [1, 2, np.nan, 4, 5])
    np.testing.assert_array_equal(columns.fit_power_dbm(row([1, 2, 3, 4, 5]), PLAN, 16), [1, 2, 3, 4, 5])
    flagged = row([1, 2, 3, 4, 5], np.array([1, 0, 16, 0, 4]))
    np.testing.assert_array_equal(columns.fit_power_dbm(flagged, PLAN, 16 | 4), [1, 2, np.nan, 4, np.nan])


def test_carriers_are_found_by_id_whatever_their_place():
    carriers = PAYLOAD.carriers()
    newcomer = replace(carriers[0], id="new")
    plan = CarrierPlan(2, "sha-2", (carriers[3], newcomer, carriers[1], carriers[0]))
    columns = CalibratedColumns(PAYLOAD.ids, PLAN)
    np.testing.assert_array_equal(columns.power_dbm(row([30, 99, 10, 0]), plan), [0, 10, np.nan, 30, np.nan])
    flagged = row([30, 99, 10, 0], np.array([8, 64, 2, 1]))
    np.testing.assert_array_equal(columns.fit_power_dbm(flagged, plan, 8 | 2), [0, np.nan, np.nan, np.nan, np.nan])
    # what was found for one plan is not taken for another
    np.testing.assert_array_equal(columns.power_dbm(row([1, 2, 3, 4, 5]), PLAN), [1, 2, 3, 4, 5])


@pytest.mark.parametrize(
    "change",
    [
        {"station": Station(60.0, 40.0)},
        {"transponder": "Ku9"},
        {"band": "X"},
        {"uplink_hz": 14.0e9},
        {"downlink_hz": 11.0e9},
    ],
    ids=lambda change: next(iter(change)),
)
def test_an_id_that_was_given_to_another_signal_is_not_the_calibrated_carrier(change):
    carriers = list(PAYLOAD.carriers())
    carriers[2] = replace(carriers[2], **change)
    columns = CalibratedColumns(PAYLOAD.ids, PLAN)
    reported = columns.power_dbm(row([1, 2, 3, 4, 5]), CarrierPlan(2, "sha-2", tuple(carriers)))
    np.testing.assert_array_equal(reported, [1, 2, np.nan, 4, 5])


def test_a_new_name_or_bandwidth_leaves_a_carrier_itself():
    carriers = tuple(replace(one, name="other", bandwidth_hz=2e6, enabled=False) for one in PAYLOAD.carriers())
    reported = CalibratedColumns(PAYLOAD.ids, PLAN).power_dbm(row([1, 2, 3, 4, 5]), CarrierPlan(2, "sha-2", carriers))
    np.testing.assert_array_equal(reported, [1, 2, 3, 4, 5])


CONFIG = RobustConfig(disagreement_deg=0.15, disagreement_s=900.0)
MINUTE = 60_000_000


def pair(minute, one, other, status=Status.ACQUIRED):
    blank = row_without_attitude(minute * MINUTE, minute * MINUTE, minute, Method.ROBUST, ())
    first = replace(blank, attitude_deg=Axes(*one), status=Status.ACQUIRED)
    return first, replace(blank, method=Method.PAPER, attitude_deg=Axes(*other), status=status)


def test_apart_for_long_enough_it_stands_and_together_again_it_ends():
    watch = Disagreement()
    for minute in range(10, 40):
        watch = compare(watch, pair(minute, (0, 0.1, 0), (0, -0.06, 0)), CONFIG)
        assert watch.is_standing == (minute >= 25)
        assert watch.apart_deg == pytest.approx(0.16 if minute >= 25 else 0.0)
    assert watch.since_us == 10 * MINUTE
    watch = compare(watch, pair(40, (0, 0.1, 0), (0, -0.04, 0)), CONFIG)
    assert watch == Disagreement(apart_deg=0.0)


@pytest.mark.parametrize(
    ("other", "is_apart"),
    [
        pytest.param((9.0, 0.0, 0.0), False, id="yaw is not compared"),
        pytest.param((0.0, 0.0, -0.2), True, id="pitch is"),
        pytest.param((0.0, 0.149, 0.149), False, id="each axis alone"),
    ],
)
def test_roll_and_pitch_are_compared(other, is_apart):
    watch = compare(Disagreement(), pair(1, (0, 0, 0), other), CONFIG)
    assert (watch.since_us is not None) == is_apart


def test_a_row_without_angles_says_nothing():
    apart = Disagreement(5, True, 0.2)
    for rows in (pair(1, (0, 0, 0), (0, 0, 0), Status.INVALID), pair(1, (0, 0, 0), (0, 0, 0))[:1], ()):
        reported = compare(apart, rows, CONFIG)
        assert (reported.since_us, reported.is_standing, math.isnan(reported.apart_deg)) == (5, True, True)


def test_time_without_angles_does_not_make_it_stand():
    watch = compare(Disagreement(), pair(1, (0, 0.2, 0), (0, 0, 0)), CONFIG)
    for minute in range(2, 40):
        watch = compare(watch, pair(minute, (0, 0.2, 0), (0, 0, 0), Status.INVALID), CONFIG)
    assert not watch.is_standing


LIMITS = InterlockConfig()
BESIDE = ("late", "catch_up", "settling", "downlink_fade", "common_change", "operation", "undeclared_operation")
CALM = dict.fromkeys(BESIDE, False)
NAN = float("nan")


def fix(angles=(0.1, 0.1, -0.1), carriers_used=12):
    return angles, carriers_used


CAUSES = [
    *((reason, fix(), CALM | {reason: True}) for reason in BESIDE),
    ("no_fix", fix(angles=(NAN, NAN, NAN)), CALM),
    ("redundancy", fix(carriers_used=4), CALM),
    ("beyond_validity", fix(angles=(0.0, 2.01, 0.0)), CALM),
    ("beyond_validity", fix(angles=(0.0, 0.0, -2.01)), CALM),
]
#: rows without angles, written by the archive's synthesis and by the chain, and what the robust method's filter says
ELSEWHERE = {"no_calibration", "not_aligned", "internal_error"}
ELSEWHERE |= {"chain_step", "innovations", "unannounced_motion", "no_ephemeris"}
ELSEWHERE |= {"sigma_roll", "sigma_pitch", "integrity_unmonitored", "protection_level", "smoothed"}


@pytest.mark.parametrize(("reason", "of_fix", "conditions"), CAUSES)
def test_each_cause_stands_alone_as_the_reason(reason, of_fix, conditions):
    assert judge(*of_fix, conditions, LIMITS) == (reason,)


def test_every_listed_reason_is_reachable_and_says_something():
    assert {reason for reason, _, _ in CAUSES} | ELSEWHERE == set(INHIBITIONS)
    assert all(len(text) > 10 for text in INHIBITIONS.values())


def test_several_reasons_are_listed_in_the_order_of_the_table():
    bad = fix(angles=(0.0, 2.5, 0.0), carriers_used=4)
    found = judge(*bad, dict.fromkeys(BESIDE, True), LIMITS)
    assert found == tuple(reason for reason in INHIBITIONS if reason in found)
    assert len(found) == len(INHIBITIONS) - len(ELSEWHERE) - 1  # a fix that is there is not `no_fix`


def test_a_good_fix_inhibits_nothing_and_limits_are_inclusive():
    assert judge(*fix(), CALM, LIMITS) == ()
    assert judge(*fix(angles=(0.4, -2.0, 2.0), carriers_used=5), CALM, LIMITS) == ()


def test_yaw_inhibits_nothing():
    assert judge(*fix(angles=(9.0, 0.1, 0.1)), CALM, LIMITS) == ()


WHOLE = FlightPayload.make()


@pytest.fixture
def flight():
    """A chain of both methods, just aligned."""
    return Flight(WHOLE)


def test_results_of_a_row_are_the_states_after_it(flight):
    seen = set()
    for minute in range(1, 40):
        measured = flight.row(minute)
        power_dbm = measured.power_dbm.copy()
        power_dbm[2] = np.nan
        power_dbm[4] -= 3.0 * (minute > 20)
        outcome = flight.chain.step(replace(measured, power_dbm=power_dbm))
        assert len(outcome.rows) == len(outcome.carriers) == len(LIVE_METHODS)
        found = outcome.carriers[0]
        _, states = flight.chain.carrier_states()
        assert found.plan_id == measured.plan_id
        assert [CARRIER_STATES[code] for code in found.state] == [state.state for state in states]
        assert [CARRIER_HYPOTHESES[code] for code in found.hypothesis] == [state.hypothesis for state in states]
        np.testing.assert_array_equal(found.deviation_db, [state.deviation_db for state in states])
        np.testing.assert_array_equal(found.residual_db, [state.residual_db for state in states])
        for each, row in zip(outcome.carriers, outcome.rows, strict=True):
            assert CARRIER_STATES[each.state[2]] == "absent"
            left_out = np.flatnonzero(each.state == CARRIER_STATES.index("excluded"))
            assert {WHOLE.ids[k] for k in left_out} <= {exclusion.carrier for exclusion in row.excluded}
            seen.update((row.method, int(k)) for k in left_out)
    assert {(method, 4) for method in LIVE_METHODS} <= seen


def test_a_late_row_and_a_method_that_fails_have_none(flight, monkeypatch):
    assert None not in flight.chain.step(flight.row(5)).carriers
    assert flight.chain.step(flight.row(3)).carriers == ()

    def fail(*_args, **_others):
        raise ValueError

    monkeypatch.setattr("service.pipeline.estimation.robust.runner.steps_in_time", fail)
    outcome = flight.chain.step(flight.row(6))
    assert outcome.rows[0].inhibitions == ("internal_error",)
    assert [each is None for each in outcome.carriers] == [True, False]
