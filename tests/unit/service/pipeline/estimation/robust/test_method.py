"""The robust method: its model, its step and what changes between rows."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import CITIES, HOUR, INERTIA, MINUTE, START_US, Flight, FlightPayload, S
from stepped_robust import ALIGNED_US, CONFIG, PAYLOAD, Stepped

from service.core.estimation.filtering.filter_model import FREE_REFERENCE_DB2, rates_deg_h
from service.core.estimation.filtering.plant import torque_prior_deg_h2
from service.pipeline.config import ChainConfig, InterlockConfig, RobustConfig
from service.pipeline.estimation.robust.method import carried_state
from service.pipeline.estimation.robust.model import robust_model, signals
from service.pipeline.inputs.knowledge import Knowledge
from service.pipeline.inputs.known_motion import consume
from service.records.calibration import CalibrationMethod, Window
from service.records.catalogue import AxisTorques, FedForwardTorque
from service.records.inputs import AlignmentSet, CalibrationActivation, EphemerisChange
from service.records.levels.attitude import Status

NAN = float("nan")
ABSENT = np.full(16, NAN)


# ---- the state at an alignment --------------------------------------------------------------------------------------


def test_the_state_begins_at_the_stated_angles_with_their_sigma():
    alignment = PAYLOAD.alignment(ALIGNED_US, angles_deg=(0.1, 0.2, -0.3))
    alignment = replace(alignment, sigma_deg=replace_axes(alignment.sigma_deg, yaw=NAN))
    state = Stepped(alignment=alignment).state
    np.testing.assert_array_equal(state.filter.mean[:3], [0.1, 0.2, -0.3])
    # a sigma that nobody stated is 0.05
    np.testing.assert_allclose(state.filter.gaussian.attitude_sigma_deg, [0.05, 0.005, 0.005], rtol=1e-12)
    assert (state.filter.epoch_us, state.commanded.since_us, state.source) == (ALIGNED_US, ALIGNED_US, None)
    assert not state.filter.carriers["is_flagged"].any()


def replace_axes(axes, **changes):
    return axes._replace(**changes)


def test_a_carrier_without_reference_shows_its_level_first_and_comes_back_to_none():
    alignment = PAYLOAD.alignment(ALIGNED_US)
    announced = {name: own[1:] for name, own in alignment.references_by_method.items()}
    stepped = Stepped(alignment=replace(alignment, references_by_method=announced))
    watch = stepped.state.filter.carriers
    assert np.flatnonzero(watch["is_flagged"]).tolist() == [0]
    # level 0.0 would be that of the calibration, which the receiving chain may have moved since
    assert np.isnan(watch["saved_reference_db"][0])
    assert np.isfinite(watch["saved_reference_db"][1:]).all()
    assert stepped.state.filter.covariance[-16, -16] == FREE_REFERENCE_DB2
    rows = [stepped.step(minute).row for minute in range(1, 45)]
    assert rows[0].carriers_used == 15
    assert [(item.carrier, item.reason) for item in rows[28].excluded] == [("c00", "step")]
    assert rows[-1].carriers_used == 16
    assert stepped.state.filter.carriers["is_relearned"][0]


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
    [((0.0, 2.1, 0.0), True), ((0.0, 0.0, -2.1), True), ((2.1, 0.0, 0.0), False), ((0.0, 0.45, 0.0), False)],
    ids=["roll", "pitch", "yaw", "beyond the published model"],
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

    def broken(*args):
        known, commanded = consume(*args)
        return known._replace(correction_deg=np.full(3, NAN)), commanded

    monkeypatch.setattr("service.pipeline.estimation.robust.method.consume", broken)
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
    mean = outcome.state.filter.mean.copy()
    mean[:9] = [0.4, -0.3, 0.2, 0.01, 0.02, 0.03, 0.1, 0.2, 0.3]
    turn = stepped.model.settings.coupling_per_h
    wanted = np.array([0.3 * turn + 0.11, 0.4 * turn + 0.22, 0.33]) / 3600.0
    np.testing.assert_allclose(rates_deg_h(mean, turn) / 3600.0, wanted, rtol=1e-12)


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
    knowledge = old.knowledge._replace(active={CalibrationMethod.GEOMETRY: payload.calibration(2)})
    new = robust_model(knowledge, PAYLOAD.calibration(), CONFIG)
    carried = carried_state(old.state, old.model, new)
    mean, before = carried.filter.mean, old.state.filter.mean
    np.testing.assert_array_equal(mean[:11], before[:11])
    references, former = mean[-9:], before[-16:]
    assert former[4] > 0.8
    kept = [0, 1, 3, 4, 5, 6, 7, 8]
    np.testing.assert_array_equal(references[kept], former[[order[k] for k in kept]])
    assert carried.filter.carriers["is_flagged"].tolist() == [False, False, True] + [False] * 6
    assert carried.filter.carriers["is_relearned"].tolist() == [False, True] + [False] * 7
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


def knows(payload, calibration=None, **changes):
    calibration = calibration or payload.calibration()
    known = {
        "spacecraft": payload.spacecraft(),
        "ephemeris": payload.ephemeris(),
        "active": {CalibrationMethod.GEOMETRY: calibration},
        "alignment": payload.alignment(ALIGNED_US),
        **changes,
    }
    return Knowledge(**known)


@pytest.fixture
def payload():
    """Eight carriers."""
    return FlightPayload.make(8)


@pytest.mark.parametrize("missing", ["ephemeris", "alignment", "active"])
def test_while_something_is_missing_there_is_no_model(payload, missing):
    nothing = {} if missing == "active" else None
    assert robust_model(knows(payload, **{missing: nothing}), None, CONFIG) is None


def test_a_calibration_without_geometry_or_an_alignment_of_the_paper_method_alone_gives_none(payload):
    calibration = payload.calibration()
    plain = replace(calibration, result=replace(calibration.result, geometry=None))
    assert robust_model(knows(payload, plain), None, CONFIG) is None
    assert robust_model(knows(payload, replace(calibration, result=None)), None, CONFIG) is None
    announced = payload.alignment(ALIGNED_US).references_by_method
    by_paper = payload.alignment(ALIGNED_US, references_by_method={"paper": announced["paper"]})
    assert robust_model(knows(payload, alignment=by_paper), calibration, CONFIG) is None


def test_settings_of_the_craft_and_limits_arrive(payload):
    config = ChainConfig(
        interlock=InterlockConfig(roll_sigma_limit_deg=0.01, pitch_sigma_limit_deg=0.02, min_redundancy=5),
        robust=RobustConfig(yaw_sigma_limit_deg=0.3, innovation_limit=9.0, relearned_share=0.5, drift_time_h=2.0),
    )
    model = robust_model(knows(payload), None, config)
    limits = model.limits
    assert (limits.sigma_yaw_deg, limits.sigma_roll_deg, limits.sigma_pitch_deg) == (0.3, 0.01, 0.02)
    assert (limits.redundancy, limits.nis_ratio, limits.relearned_share) == (5, 9.0, 0.5)
    assert (model.settings.drift_tau_h, model.settings.coupling_per_h) == (2.0, 0.0)
    for record in (payload.spacecraft(coupling=True), None):
        coupled = robust_model(knows(payload, spacecraft=record), None, CONFIG)
        # one turn a sidereal day
        assert coupled.settings.coupling_per_h == pytest.approx(2 * np.pi / 23.9344696, rel=1e-6)


def test_a_torque_that_is_not_fed_forward_is_an_acceleration_of_each_axis(payload):
    record = payload.spacecraft()
    pushed = replace(record, onboard=replace(record.onboard, residual_torque_n_m=5e-7))
    model = robust_model(knows(payload, spacecraft=pushed), None, CONFIG)
    inertia = np.array([INERTIA[2][2], INERTIA[0][0], INERTIA[1][1]])
    np.testing.assert_allclose(model.settings.torque_deg_h2, np.degrees(5e-7 / inertia) * 3600.0**2)
    calm = robust_model(knows(payload), None, CONFIG)
    # none is a belief: what motion shows in spite of it can be learned
    np.testing.assert_allclose(calm.settings.torque_deg_h2, np.degrees(1e-9 / inertia) * 3600.0**2)
    np.testing.assert_allclose(calm.settings.unknown_torque_deg_h2, np.degrees(1e-6 / inertia) * 3600.0**2)


def test_a_torque_that_the_catalogue_does_not_state_is_a_prior_as_well_constant_as_wave(payload):
    record = payload.spacecraft()
    unknown = replace(record, onboard=replace(record.onboard, residual_torque_n_m=None))
    inertia = np.array([INERTIA[2][2], INERTIA[0][0], INERTIA[1][1]])
    for prior_n_m in (1e-6, 3e-6):
        config = ChainConfig(robust=RobustConfig(unknown_torque_n_m=prior_n_m))
        model = robust_model(knows(payload, spacecraft=unknown), None, config)
        size = np.degrees(prior_n_m / inertia) * 3600.0**2
        np.testing.assert_allclose(model.settings.torque_deg_h2, size)
        np.testing.assert_allclose(torque_prior_deg_h2(model.settings), np.tile(np.sqrt(0.5) * size, 3))
        assert model.is_torque_unknown
    assert CONFIG.robust.unknown_torque_n_m == 1e-6
    # a stated size, none included, is what it was
    for stated_n_m in (0.0, 5e-7):
        stated = replace(record, onboard=replace(record.onboard, residual_torque_n_m=stated_n_m))
        model = robust_model(knows(payload, spacecraft=stated), None, CONFIG)
        assert not model.is_torque_unknown


def test_without_a_statement_roll_tells_nothing_of_yaw_and_either_may_drift_by_the_other(payload):
    def settings(coupling):
        return robust_model(knows(payload, spacecraft=payload.spacecraft(coupling=coupling)), None, CONFIG).settings

    unknown, uncoupled, coupled = settings(None), settings(False), settings(True)
    assert unknown.coupling_per_h == uncoupled.coupling_per_h == 0.0 < coupled.coupling_per_h
    assert coupled.drift_deg_h == uncoupled.drift_deg_h == (0.04, 0.025, 0.025)
    turn = coupled.coupling_per_h
    np.testing.assert_allclose(unknown.drift_deg_h, np.hypot([0.04, 0.025, 0.025], [0.05 * turn, 0.2 * turn, 0.0]))


def test_what_is_fed_forward_is_counted_from_1970_whatever_epoch_states_it(payload):
    announced = FedForwardTorque(
        epoch_us=ALIGNED_US + 5 * HOUR,
        period_s=80_000.0,
        constant_n_m=AxisTorques(pitch=1e-6),
        cosine_n_m=AxisTorques(8e-6, 0.0, 2e-6),
        sine_n_m=AxisTorques(0.0, 1.3e-5, 7e-6),
    )
    record = payload.spacecraft()
    fed = replace(record, onboard=replace(record.onboard, fed_forward_torque=announced))
    model = robust_model(knows(payload, spacecraft=fed), None, CONFIG)
    profile = model.settings.fed_forward
    assert (profile.period_us, profile.relative_error, profile.axis_relative_error) == (80_000_000_000, 0.06, 0.01)
    unit = 3600.0**2 * np.degrees(1.0 / np.array([INERTIA[2][2], INERTIA[0][0], INERTIA[1][1]]))
    for at_us in (announced.epoch_us, ALIGNED_US + 31 * HOUR):
        since, phase = (2.0 * np.pi * (us / 8e10) for us in (at_us - announced.epoch_us, at_us))
        stated = np.array([0.0, 0.0, 1e-6]) + np.cos(since) * np.array([8e-6, 0.0, 2e-6])
        stated = unit * (stated + np.sin(since) * np.array([0.0, 1.3e-5, 7e-6]))
        constant, cosine, sine = np.array(profile[:3])
        np.testing.assert_allclose(constant + np.cos(phase) * cosine + np.sin(phase) * sine, stated, atol=1e-5)
    assert robust_model(knows(payload), None, CONFIG).settings.fed_forward is None


def test_expected_levels_are_references_and_day(payload):
    announced = payload.alignment(ALIGNED_US).references_by_method
    moved = tuple(replace(one, reference_dbm=one.reference_dbm + k) for k, one in enumerate(announced["robust"]))
    alignment = payload.alignment(ALIGNED_US, references_by_method={"robust": moved[:-1]})
    model = robust_model(knows(payload, alignment=alignment), payload.calibration(), CONFIG)
    epoch_us = ALIGNED_US + 5 * HOUR
    truth = payload.power_dbm([epoch_us], np.zeros(3))[0]
    # cubic between knots of ten minutes
    np.testing.assert_allclose(model.expected_dbm(epoch_us) - truth, [0, 1, 2, 3, 4, 5, 6, 0], atol=1e-5)
    assert model.is_referenced.tolist() == [True] * 7 + [False]
    np.testing.assert_allclose(model.reference_sigma_db, [0.02] * 7 + [1.0], rtol=1e-6)
    assert (model.calibration_id, model.alignment_id) == (1, 1)


def test_carriers_that_the_fit_does_not_know_or_use_are_not_used(payload):
    fit = payload.geometry()
    level = (NAN, *fit.level_dbm[1:])
    gradient = (fit.gradient[0], (NAN, NAN), *fit.gradient[2:])
    used = (True, True, False, True, True, True, True, True)
    calibration = payload.calibration(level_dbm=level, gradient=gradient, is_used=used)
    model = robust_model(knows(payload, calibration), None, CONFIG)
    assert model.is_used.tolist() == [False, False, False, True, True, True, True, True]


def other(payload, calibration_id=2, **changes):
    """Return another calibration: levels off by 0.3 dB, beams and dishes a little off."""
    moved = replace(
        payload, level_dbm=payload.level_dbm + 0.3, gradient=1.1 * payload.gradient, daily=0.9 * payload.daily
    )
    return replace(moved, **changes).calibration(calibration_id)


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.15)], ids=["at zero", "turned"])
def test_references_of_another_calibration_keep_each_mean_power_of_the_window(payload, angles):
    alignment = payload.alignment(ALIGNED_US, angles_deg=angles)
    known = knows(payload, other(payload), alignment=alignment)
    first = payload.calibration()
    model = robust_model(known, first, CONFIG)
    own = robust_model(knows(payload, alignment=alignment), first, CONFIG)
    window_us = np.linspace(alignment.window.start_us, alignment.window.stop_us, 60).astype(np.int64)

    def means(one):
        yaw = np.array(angles)
        slopes, bend = one.response.slope, one.response.curvature
        turned = slopes @ yaw + 0.5 * np.einsum("i,nij,j->n", yaw, bend, yaw)
        return np.mean([one.expected_dbm(int(epoch_us)) for epoch_us in window_us], axis=0) + turned

    # the same instants and the same formula: rounding
    np.testing.assert_allclose(means(model), means(own), atol=1e-9)
    assert model.is_referenced.all()
    # what the fake's own covariance leaves open of the daily change is far below
    np.testing.assert_allclose(model.reference_sigma_db, 0.02, rtol=1e-6)


def test_a_manual_alignment_without_window_is_compared_at_its_epoch(payload):
    alignment = payload.alignment(ALIGNED_US, window=None)
    model = robust_model(knows(payload, other(payload), alignment=alignment), payload.calibration(), CONFIG)
    truth = payload.power_dbm([ALIGNED_US], np.zeros(3))[0]
    np.testing.assert_allclose(model.expected_dbm(ALIGNED_US), truth, atol=1e-5)


def test_an_ephemeris_that_does_not_reach_back_to_the_alignment_costs_no_reference(payload):
    later = payload.ephemeris(2, ALIGNED_US + 2 * HOUR)
    known = knows(payload, other(payload), ephemeris=later)
    blind = robust_model(known, payload.calibration(), CONFIG)
    assert not blind.is_referenced.any()
    model = robust_model(known, payload.calibration(), CONFIG, payload.ephemeris())
    before = robust_model(knows(payload, other(payload)), payload.calibration(), CONFIG)
    np.testing.assert_array_equal(model.reference_offset_db, before.reference_offset_db)
    assert model.is_referenced.all()


def test_a_carrier_that_the_former_calibration_did_not_have_has_no_reference(payload):
    fewer = payload.permuted([0, 1, 2, 3, 4, 6]).calibration()
    known = knows(payload, payload.calibration(2), alignment=payload.alignment(ALIGNED_US))
    model = robust_model(known, fewer, CONFIG)
    assert model.is_referenced.tolist() == [True] * 5 + [False, True, False]
    gone = replace(fewer, result=replace(fewer.result, geometry=None))
    assert not robust_model(known, gone, CONFIG).is_referenced.any()


def test_an_id_that_another_station_was_given_has_no_reference(payload):
    cities = (*payload.cities[:3], "Magadan", *payload.cities[4:])
    transponders = (*payload.transponders[:5], "Ku3", *payload.transponders[6:])
    moved = replace(payload, cities=cities, transponders=transponders)
    model = robust_model(knows(payload, moved.calibration(2)), payload.calibration(), CONFIG)
    assert np.flatnonzero(~model.is_referenced).tolist() == [3, 5]


def test_signals_are_told_apart_by_id_place_and_transponder(payload):
    fit = payload.geometry()
    beacon = replace(fit, station_latitude_deg=(NAN, *fit.station_latitude_deg[1:]))
    assert signals(payload.ids, beacon) == signals(payload.ids, beacon)
    assert len(set(signals(("same",) * 8, fit))) == 8
    latitude_deg, longitude_deg = CITIES["Moscow"]
    assert signals(payload.ids, fit)[0] == ("c00", f"{latitude_deg}/{longitude_deg}", "C1")


# ---- error of the daily change --------------------------------------------------------------------------------------


def uncertain(payload, sigma):
    size = 1 + payload.daily.shape[1] + 5
    variance = np.full(size, 1e-10)
    variance[1:4] = sigma**2
    return payload.calibration(covariance=(tuple(map(tuple, np.diag(variance).tolist())),) * len(payload.ids))


def test_the_error_of_the_daily_change_is_slow_noise_whichever_ephemeris_holds(payload):
    sure = robust_model(knows(payload), None, CONFIG)
    np.testing.assert_allclose(sure.filter.coloured_sigma_db, np.tile([0.02, 0.01], (8, 1)), atol=1e-6)
    unsure = robust_model(knows(payload, uncertain(payload, 2.0)), None, CONFIG)
    np.testing.assert_array_equal(unsure.filter.coloured_sigma_db[:, 0], 0.02)
    assert (unsure.filter.coloured_sigma_db[:, 1] > 0.05).all()
    # the track of next week says nothing about the day of the alignment
    later = payload.ephemeris(2, START_US + 40 * HOUR)
    renewed = robust_model(knows(payload, uncertain(payload, 2.0), ephemeris=later), None, CONFIG)
    # the same orbit on another day; node and solar day have drifted apart by a few minutes
    np.testing.assert_allclose(renewed.filter.coloured_sigma_db, unsure.filter.coloured_sigma_db, rtol=0.05)


def test_a_window_is_compared_over_its_length_and_not_at_its_end(payload):
    long = Window(ALIGNED_US - 6 * HOUR, ALIGNED_US)
    alignment = payload.alignment(ALIGNED_US, window=long)
    model = robust_model(knows(payload, other(payload), alignment=alignment), payload.calibration(), CONFIG)
    instants = np.arange(long.start_us, long.stop_us, 60 * S)
    announced = np.mean([model.expected_dbm(int(epoch_us)) for epoch_us in instants[::5]], axis=0)
    truth = payload.power_dbm(instants[::5], np.zeros(3)).mean(axis=0)
    # sixty instants of the comparison against seventy-two here, of a difference of a tenth of a day's wave
    np.testing.assert_allclose(announced, truth, atol=2e-3)


def test_the_daily_change_is_doubted_only_beyond_what_it_was_over_the_quiet_days(payload):
    plain = robust_model(knows(payload), None, CONFIG)
    calibration = payload.calibration()
    fit = calibration.result.geometry
    # the dish alone is told to 20 dB/deg, one sigma: over a wander of hundredths of a degree some tenths of a dB
    covariance = np.array(fit.covariance)
    covariance[:, 1, 1] = 400.0
    loose = replace(fit, covariance=tuple(tuple(map(tuple, one)) for one in covariance.tolist()))
    doubted = robust_model(
        knows(payload, replace(calibration, result=replace(calibration.result, geometry=loose))), None, CONFIG
    )
    grown = np.sqrt(doubted.reference_sigma_db**2 - plain.reference_sigma_db**2)
    assert (grown > 0.05).all()
    slow = np.sqrt((doubted.filter.coloured_sigma_db**2 - plain.filter.coloured_sigma_db**2).sum(axis=1))
    np.testing.assert_allclose(slow, grown, rtol=1e-6)
    as_calibrated = replace(loose, daily_error_db=tuple(grown.tolist()))
    result = replace(calibration.result, geometry=as_calibrated)
    known = robust_model(knows(payload, replace(calibration, result=result)), None, CONFIG)
    # equal errors cancel to the rounding of their squares
    np.testing.assert_allclose(known.reference_sigma_db, plain.reference_sigma_db, atol=1e-6)
