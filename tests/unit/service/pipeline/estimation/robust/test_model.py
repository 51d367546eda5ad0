"""The robust model: what calibration, alignment and ephemeris give it, and what happens to references in between."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import CITIES, HOUR, INERTIA, START_US, FlightPayload, S

from service.core.estimation.filtering.model.torque_prior import torque_prior_deg_h2
from service.pipeline.config import ChainConfig, InterlockConfig, RobustConfig
from service.pipeline.estimation.robust.model import robust_model, signals
from service.pipeline.inputs.knowledge import Knowledge
from service.records.calibration import CalibrationMethod, Window
from service.records.catalogue import AxisTorques, FedForwardTorque

CONFIG = ChainConfig()
ALIGNED_US = START_US + HOUR
NAN = float("nan")


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


def test_a_torque_that_is_not_fed_forward_is_an_acceleration_of_each_axis_and_lets_yaw_be_worse_known(payload):
    record = payload.spacecraft()
    pushed = replace(record, onboard=replace(record.onboard, residual_torque_n_m=5e-7))
    model = robust_model(knows(payload, spacecraft=pushed), None, CONFIG)
    inertia = np.array([INERTIA[2][2], INERTIA[0][0], INERTIA[1][1]])
    np.testing.assert_allclose(model.settings.torque_deg_h2, np.degrees(5e-7 / inertia) * 3600.0**2)
    assert model.limits.sigma_yaw_deg == CONFIG.robust.pushed_yaw_sigma_limit_deg
    calm = robust_model(knows(payload), None, CONFIG)
    assert calm.settings.torque_deg_h2 == (0.0, 0.0, 0.0)
    assert calm.limits.sigma_yaw_deg == CONFIG.robust.yaw_sigma_limit_deg


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
    # left alone its yaw is lost: it is controlled as long as it is known to a degree
    assert model.limits.sigma_yaw_deg == CONFIG.robust.unknown_torque_yaw_sigma_limit_deg == 1.0
    assert CONFIG.robust.unknown_torque_n_m == 1e-6
    # a stated size, none included, is what it was
    for stated_n_m in (0.0, 5e-7):
        stated = replace(record, onboard=replace(record.onboard, residual_torque_n_m=stated_n_m))
        model = robust_model(knows(payload, spacecraft=stated), None, CONFIG)
        assert (model.is_torque_unknown, model.settings.torque_constant_share) == (False, 0.2)


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
    assert model.limits.sigma_yaw_deg == CONFIG.robust.pushed_yaw_sigma_limit_deg
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
