"""The robust method's step: late rows, coasting, lost numbers, changes of source and of calibration."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import MINUTE, Flight, FlightPayload
from stepped_robust import ALIGNED_US, CONFIG, PAYLOAD, Stepped

from service.core.estimation.filtering.model.filter_state import FREE_REFERENCE_DB2
from service.pipeline.estimation.robust.attitude_rows import rates_deg_s
from service.pipeline.estimation.robust.method import carried_state
from service.pipeline.estimation.robust.model import robust_model
from service.records.calibration import CalibrationMethod
from service.records.inputs import AlignmentSet, CalibrationActivation, EphemerisChange
from service.records.levels.attitude import Status

NAN = float("nan")
ABSENT = np.full(16, NAN)


# ---- the state at an alignment --------------------------------------------------------------------------------------


def test_the_state_begins_at_the_stated_angles_with_their_sigma():
    alignment = PAYLOAD.alignment(ALIGNED_US, angles_deg=(0.1, 0.2, -0.3))
    alignment = replace(alignment, sigma_deg=replace_axes(alignment.sigma_deg, yaw=NAN))
    state = Stepped(alignment=alignment).state
    np.testing.assert_array_equal(state.filter.gaussian.mean[:3], [0.1, 0.2, -0.3])
    # a sigma that nobody stated is 0.05
    np.testing.assert_allclose(state.filter.gaussian.attitude_sigma_deg, [0.05, 0.005, 0.005], rtol=1e-12)
    assert (state.filter.epoch_us, state.commanded.since_us, state.source) == (ALIGNED_US, ALIGNED_US, None)
    assert not state.filter.carriers.is_flagged.any()


def replace_axes(axes, **changes):
    return axes._replace(**changes)


def test_a_carrier_without_reference_shows_its_level_first_and_comes_back_to_none():
    alignment = PAYLOAD.alignment(ALIGNED_US)
    announced = {name: own[1:] for name, own in alignment.references_by_method.items()}
    stepped = Stepped(alignment=replace(alignment, references_by_method=announced))
    watch = stepped.state.filter.carriers
    assert np.flatnonzero(watch.is_flagged).tolist() == [0]
    # level 0.0 would be that of the calibration, which the receiving chain may have moved since
    assert np.isnan(watch.saved_reference_db[0])
    assert np.isfinite(watch.saved_reference_db[1:]).all()
    assert stepped.state.filter.gaussian.covariance[-16, -16] == FREE_REFERENCE_DB2
    rows = [stepped.step(minute).row for minute in range(1, 45)]
    assert rows[0].carriers_used == 15
    assert [(item.carrier, item.reason) for item in rows[28].excluded] == [("c00", "step")]
    assert rows[-1].carriers_used == 16
    assert stepped.state.filter.carriers.is_relearned[0]


# ---- rows -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("has_track", [True, False], ids=["dish law", "harmonics"])
def test_an_exact_payload_is_told_within_a_hundredth_of_a_degree(has_track):
    truth = (0.12, -0.2, 0.25)
    stepped = Stepped(FlightPayload.make(has_track=has_track), angles=truth)
    for minute in range(1, 181):
        row = stepped.step(minute).row
        np.testing.assert_allclose(row.attitude_deg, truth, atol=0.01)
        assert row.status is Status.ACQUIRED
        assert row.carriers_used == 16
    assert row.control_allowed
    assert row.residual_rms_db < 0.01
    assert row.common_db == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("angles", "is_beyond"),
    [((0.0, 0.45, 0.0), True), ((0.0, 0.0, -0.45), True), ((0.45, 0.0, 0.0), False)],
    ids=["roll", "pitch", "yaw"],
)
def test_roll_and_pitch_beyond_what_the_calibration_covers_forbid_control(angles, is_beyond):
    row = Stepped(angles=angles).step(1).row
    assert ("beyond_validity" in row.inhibitions, row.control_allowed) == (is_beyond, not is_beyond)


def test_an_alignment_that_was_a_little_off_is_put_right_by_the_powers():
    alignment = PAYLOAD.alignment(ALIGNED_US)
    stated = replace(alignment, sigma_deg=replace_axes(alignment.sigma_deg, yaw=0.1, roll=0.05, pitch=0.05))
    stepped = Stepped(alignment=stated)
    # roll and pitch 0.04 deg beside what the sensor said; the references are those of zero attitude
    for minute in range(1, 241):
        row = stepped.step(minute, angles=(0.0, 0.04, -0.04)).row
    np.testing.assert_allclose(row.attitude_deg[1:], [0.04, -0.04], atol=0.01)


def test_a_late_row_stands_alone_and_leaves_the_state_as_it_is():
    stepped = Stepped(angles=(0.05, 0.1, -0.1))
    for minute in range(1, 30):
        stepped.step(minute)
    before = repr(stepped.state)
    late = stepped.step(12, keeps=False, is_late=True, angles=(0.0, -0.2, 0.2), source="another")
    assert late.state is stepped.state
    assert repr(stepped.state) == before
    # one row of exact powers; the error of the rotation's second order through weak yaw
    np.testing.assert_allclose(late.row.attitude_deg[1:], [-0.2, 0.2], atol=0.01)
    assert (late.row.inhibitions, late.row.control_allowed) == (("late",), False)
    assert late.row.control_allowed_axes == (False, False, False)
    assert late.row.rates_deg_s is None
    assert late.row.status is Status.ACQUIRED


def test_a_late_row_of_too_few_carriers_has_no_fix():
    stepped = Stepped()
    gone = np.where(np.arange(16) < 3, 0.0, NAN)
    late = stepped.step(5, gone, is_late=True).row
    assert late.status is Status.INVALID
    assert late.inhibitions == ("late", "no_fix")
    assert np.isnan(late.attitude_deg).all()
    assert {item.reason for item in late.excluded} == {"absent"}
    assert len(late.excluded) == 13


def test_a_late_row_tells_which_carriers_were_out():
    stepped = Stepped()
    change = np.zeros(16)
    change[2], change[5], change[9] = -6.0, 6.0, NAN
    late = stepped.step(5, change, is_late=True).row
    assert [(item.carrier, item.reason) for item in late.excluded] == [
        ("c02", "uplink_fade"),
        ("c05", "step"),
        ("c09", "absent"),
    ]
    np.testing.assert_allclose(late.attitude_deg[1:], 0.0, atol=0.02)


@pytest.mark.parametrize("present", [0, 3])
def test_with_fewer_than_four_carriers_the_filter_coasts(present):
    stepped = Stepped(angles=(0.1, 0.1, 0.1))
    for minute in range(1, 60):
        sure = stepped.step(minute).row
    rows = [stepped.step(minute, np.where(np.arange(16) < present, 0.0, NAN)).row for minute in range(60, 240)]
    assert {row.status for row in rows} == {Status.EXPIRED}
    assert all("redundancy" in row.inhibitions and not row.control_allowed for row in rows)
    assert all(row.carriers_used == 0 for row in rows)
    sigma = np.array([row.sigma_deg for row in rows])
    assert (np.diff(sigma, axis=0) > 0.0).all()
    assert (sigma[0] > np.array(sure.sigma_deg)).all()
    assert np.isfinite([row.attitude_deg for row in rows]).all()
    # nothing moved: what remains is the drift learned from second-order errors of the model
    np.testing.assert_allclose(rows[-1].attitude_deg, 0.1, atol=0.02)
    assert np.isnan([row.residual_rms_db for row in rows]).all()
    back = [stepped.step(minute).row for minute in range(240, 302)]
    assert back[0].status is Status.ACQUIRED
    np.testing.assert_allclose(back[-1].attitude_deg, 0.1, atol=0.02)
    assert back[-1].control_allowed


def test_four_carriers_are_enough_to_go_on_but_not_to_control():
    stepped = Stepped()
    row = stepped.step(1, np.where(np.arange(16) % 4 == 1, 0.0, NAN)).row
    assert (row.status, row.carriers_used) == (Status.ACQUIRED, 4)
    assert row.inhibitions == ("redundancy",)


def test_where_the_ephemeris_ends_the_filter_coasts_and_a_new_one_brings_it_back():
    flight = Flight(PAYLOAD)
    flight.documents.ephemerides[1] = PAYLOAD.ephemeris(stop_us=flight.at(60))
    for content in flight.opening():
        flight.chain.update(content)
    # the cubic wants two knots ahead, and the rate of the orbit five minutes more
    known = flight.run(range(1, 35))
    assert known[-1].control_allowed
    blind = flight.run(range(70, 130))
    unmonitored = {"integrity_unmonitored"}
    assert {frozenset(row.inhibitions) - unmonitored for row in blind} == {frozenset({"redundancy", "no_ephemeris"})}
    # the last answer of the references holds for half an hour
    assert "integrity_unmonitored" in blind[-1].inhibitions
    assert {row.status for row in blind} == {Status.EXPIRED}
    assert np.isfinite([row.attitude_deg for row in blind]).all()
    assert {item.reason for item in blind[0].excluded} == {"absent"}
    flight.documents.ephemerides[2] = PAYLOAD.ephemeris(2, flight.at(100))
    flight.chain.update(EphemerisChange(2))
    back = flight.run(range(130, 200))
    assert back[0].status is Status.ACQUIRED
    np.testing.assert_allclose(flight.error_deg(back[-1]), 0.0, atol=0.01)
    assert back[-1].control_allowed


def test_numbers_that_break_the_filter_leave_the_state_before_them(monkeypatch):
    stepped = Stepped()
    for minute in range(1, 5):
        stepped.step(minute)
    before = stepped.state
    real = __import__("service.pipeline.estimation.robust.method", fromlist=["step"]).step

    def broken(*args, **options):
        announced = real(*args, **options)
        return announced._replace(attitude_deg=announced.attitude_deg * NAN)

    monkeypatch.setattr("service.pipeline.estimation.robust.method.step", broken)
    with pytest.raises(ArithmeticError, match="lost its numbers"):
        stepped.step(5)
    monkeypatch.undo()
    assert stepped.state is before
    assert stepped.step(6).row.control_allowed


# ---- what was told about a step -------------------------------------------------------------------------------------


def test_another_source_frees_the_common_level_and_holds_control():
    stepped = Stepped(angles=(0.0, 0.1, -0.1))
    for minute in range(1, 30):
        stepped.step(minute)
    # the backup reads 1.2 dB more on all carriers
    rows = [stepped.step(minute, 1.2, source="sa-2").row for minute in range(30, 60)]
    assert rows[0].inhibitions == ("chain_step",)
    assert not rows[8].control_allowed
    assert rows[11].control_allowed
    np.testing.assert_allclose([row.attitude_deg for row in rows], np.tile([0.0, 0.1, -0.1], (30, 1)), atol=0.01)
    assert rows[-1].common_db == pytest.approx(1.2, abs=0.02)
    assert not rows[-1].downlink_fade
    # and it is no news any more
    assert stepped.step(60, 1.2, source="sa-2").row.control_allowed


def test_the_first_source_after_an_alignment_is_no_change():
    stepped = Stepped()
    assert stepped.step(1, source="whatever").row.control_allowed
    assert stepped.state.source == "whatever"


def test_rates_are_those_of_the_state():
    stepped = Stepped(spacecraft=PAYLOAD.spacecraft(coupling=True))
    measurement = PAYLOAD.measurement(ALIGNED_US + MINUTE)
    assert measurement.plan_id == 1
    outcome = stepped.step(1)
    gaussian = outcome.state.filter.gaussian
    mean = gaussian.mean.copy()
    mean[:9] = [0.4, -0.3, 0.2, 0.01, 0.02, 0.03, 0.1, 0.2, 0.3]
    turn = stepped.model.settings.coupling_per_h
    wanted = np.array([0.3 * turn + 0.11, 0.4 * turn + 0.22, 0.33]) / 3600.0
    np.testing.assert_allclose(rates_deg_s(mean, turn), wanted, rtol=1e-12)


# ---- another calibration --------------------------------------------------------------------------------------------


def test_the_state_is_carried_over_by_signal():
    old = Stepped()
    for minute in range(1, 90):
        # c04 steps and is learned again
        old.step(minute, np.where(np.arange(16) == 4, 1.0 if minute > 20 else 0.0, 0.0))
    order = [7, 4, 9, 0, 1, 2, 12, 13, 14]
    payload = PAYLOAD.permuted(order)
    cities = ("Magadan" if name == "c09" else city for name, city in zip(payload.ids, payload.cities, strict=True))
    payload = replace(payload, cities=tuple(cities))
    knowledge = replace(old.knowledge, active={CalibrationMethod.GEOMETRY: payload.calibration(2)})
    new = robust_model(knowledge, PAYLOAD.calibration(), CONFIG)
    carried = carried_state(old.state, old.model, new)
    mean, before = carried.filter.gaussian.mean, old.state.filter.gaussian.mean
    np.testing.assert_array_equal(mean[:11], before[:11])
    references, former = mean[-9:], before[-16:]
    assert former[4] > 0.8
    kept = [0, 1, 3, 4, 5, 6, 7, 8]
    np.testing.assert_array_equal(references[kept], former[[order[k] for k in kept]])
    assert carried.filter.carriers.is_flagged.tolist() == [False, False, True] + [False] * 6
    assert carried.filter.carriers.is_relearned.tolist() == [False, True] + [False] * 7
    assert (carried.commanded, carried.source) == (old.state.commanded, old.state.source)


def test_the_same_calibration_keeps_the_very_state():
    stepped = Stepped()
    again = robust_model(stepped.knowledge, None, CONFIG)
    assert carried_state(stepped.state, stepped.model, again) is stepped.state


@pytest.mark.parametrize("renewed_first", [False, True], ids=["same ephemeris", "under a later ephemeris"])
def test_activation_of_another_calibration_moves_no_angle(renewed_first):
    flight = Flight(PAYLOAD)
    before = flight.run(range(1, 90))[-1]
    rng = np.random.default_rng(8)
    other = replace(
        PAYLOAD,
        level_dbm=PAYLOAD.level_dbm + rng.normal(0.0, 0.2, 16),
        gradient=PAYLOAD.gradient + rng.normal(0.0, 0.02, (16, 2)),
    )
    flight.documents.calibrations[2] = other.calibration(2)
    flight.documents.ephemerides[2] = PAYLOAD.ephemeris(2, flight.at(30))
    changes = [CalibrationActivation(2, 2), EphemerisChange(2)]
    for content in reversed(changes) if renewed_first else changes:
        flight.chain.update(content)
        after = flight.robust(flight.row(90 + len(flight.chain.knowledge.active) + changes.index(content)))
        np.testing.assert_allclose(after.attitude_deg, before.attitude_deg, atol=0.01)
    rows = flight.run(range(95, 200))
    assert {row.calibration_id for row in rows} == {2}
    assert {row.carriers_used for row in rows} == {16}
    np.testing.assert_allclose(np.array(rows[-1].attitude_deg)[1:], flight.truth_deg[1:], atol=0.01)


def test_a_new_alignment_starts_from_its_angles():
    flight = Flight(PAYLOAD)
    flight.run(range(1, 30))
    flight.documents.alignments[2] = PAYLOAD.alignment(flight.at(30), 2, angles_deg=(0.2, -0.1, 0.15))
    flight.chain.update(AlignmentSet(2))
    row = flight.robust(flight.row(31, (0.2, -0.1, 0.15)))
    np.testing.assert_allclose(row.attitude_deg, (0.2, -0.1, 0.15), atol=0.01)
    assert row.alignment_id == 2
