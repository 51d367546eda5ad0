"""Calibration of the geometry, its warnings and its minute rows."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_payload import DAY, HOUR, MINUTE, NAN, START_US, GeometryPayload, S, turned_angles
from hypothesis import given
from hypothesis import strategies as st

from db.encoding.record_codec import decode, encode
from service.core.estimation.noise_identification import LADDER_S
from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.geometry_rows import CalibrationError
from service.pipeline.calibration.minute_rows import mean_edges_us, minute_rows
from service.pipeline.config import CalibrationConfig
from service.records.calibration import CalibrationMethod, CalibrationRequest, CalibrationResult, Window
from service.records.catalogue import Site, Station, Track
from service.records.inputs import Operation
from service.records.levels.measurement import MeasurementSeries

CONFIG = CalibrationConfig()


@pytest.fixture(scope="module")
def payload():
    """Eight carriers, three quiet days."""
    return GeometryPayload.make(8)


@pytest.fixture(scope="module")
def data(payload):
    """What the archive holds, everything as it should be."""
    return payload.data()


@pytest.fixture(scope="module")
def result(data):
    """Its calibration."""
    return calibrate_geometry(data, CONFIG)


def others_slow(first, *others):
    """Return cases of which every change runs the first: a calibration takes a second."""
    return [first, *(pytest.param(*each, marks=pytest.mark.slow) for each in others)]


def with_powers(data, change):
    """Return the input with the powers of both windows changed."""
    parts = [replace(part, power_dbm=change(part.power_dbm.copy())) for part in (data.quiet, data.turns)]
    return replace(data, quiet=parts[0], turns=parts[1])


def with_carrier(data, k, **changes):
    """Return the input with one carrier of the plan changed."""
    carriers = list(data.plan.carriers)
    carriers[k] = replace(carriers[k], **changes)
    return replace(data, plan=replace(data.plan, carriers=tuple(carriers)))


def refusal(data):
    with pytest.raises(CalibrationError) as caught:
        calibrate_geometry(data, CONFIG)
    return str(caught.value)


def slopes(result):
    return np.array([carrier.sensitivity_db_per_deg for carrier in result.carriers])


# ---- figures --------------------------------------------------------------------------------------------------------


def test_slopes_come_back_also_that_of_yaw(payload, result):
    error = slopes(result) - payload.slopes()
    # 0.05 dB over stretches of ten rows, eight plateaus an axis: one sigma 0.002 / 0.012 / 0.012, three times that
    assert (np.sqrt((error**2).mean(axis=0)) < [0.010, 0.036, 0.036]).all()


def test_a_healthy_calibration_has_no_warning_of_the_joint_fit(result):
    assert [text for text in result.warnings if not text.startswith("paper method: only 8 carriers")] == []
    assert all(np.isfinite(value) for name, value in result.quality.items()), result.quality
    assert result.quality["carriers_used"] == 8.0
    assert np.isfinite(
        [result.observability.condition, *result.observability.dop, *result.observability.crlb_deg]
    ).all()


def test_the_record_holds_places_bands_and_noise(data, result):
    fit = result.geometry
    assert fit.is_dish_law
    assert (fit.bands, fit.band, fit.rain_share) == (("Ku",), (0,) * 8, (1.0,))
    assert (fit.transponders, fit.transponder) == (("K1", "K2"), (0, 0, 0, 0, 1, 1, 1, 1))
    assert fit.site_position == (55.9, 38.0, 160.0)
    assert fit.nominal_longitude_deg == 90.0
    assert fit.station_latitude_deg == tuple(c.station.latitude_deg for c in data.plan.carriers)
    assert np.array(fit.covariance).shape == (8, 9, 9)
    assert np.array(fit.downlink_gain).shape == (8, 9, 2)
    assert np.array(fit.solar_day_db).shape == (8, 2)
    assert fit.is_used == (True,) * 8
    assert fit.alc_group == ()
    assert fit.quantisation_db == (0.0,) * 8
    assert fit.reference_walk_db == pytest.approx([0.003] * 8)
    for carrier in result.carriers:
        # 4320 rows: one sigma of a white noise is 1.1 %, four times that and the sensor's 0.005 deg
        assert carrier.sigma_white_db == pytest.approx(0.05, rel=0.06)
        assert tuple(part.correlation_time_s for part in carrier.noise) == LADDER_S
        assert all(part.sigma_db < 0.02 for part in carrier.noise)


def test_the_record_survives_the_archive(result):
    assert decode(CalibrationResult, encode(result)) == result


def test_the_paper_part_is_carried_along(payload, result):
    for k, carrier in enumerate(result.carriers):
        assert carrier.harmonic.rms_db < 0.2
        # a side of a bent beam is steeper, the other flatter: their mean is the slope to the bend's third order
        both = np.array([carrier.sensitivity_plus_db_per_deg, carrier.sensitivity_minus_db_per_deg])
        assert both.mean(axis=0)[1:] == pytest.approx(payload.slopes()[k][1:], abs=0.3)


# ---- what the catalogue says ----------------------------------------------------------------------------------------


def test_a_beacon_stays_in_the_record_without_a_station(payload):
    carriers = (*payload.carriers[:7], replace(payload.carriers[7], kind="beacon", station=None, uplink_hz=None))
    result = calibrate_geometry(replace(payload, carriers=carriers).data(), CONFIG)
    fit = result.geometry
    assert np.isnan([fit.station_azimuth_deg[7], fit.station_latitude_deg[7]]).all()
    assert np.isfinite(fit.level_dbm[7])
    assert not np.any([fit.gradient[7], (*fit.hessian[7],)[:2], fit.daily[7][:2]])
    assert fit.is_used[7]
    # it answers to the attitude by the downlink alone, which it tells better than any carrier with a beam of its own
    assert slopes(result)[7] == pytest.approx(replace(payload, carriers=carriers).slopes()[7], abs=0.03)
    assert not any("c07" in text for text in result.warnings)


def test_automatic_power_control_is_refused_and_says_so(data):
    result = calibrate_geometry(with_carrier(data, 2, uplink_power_control="auto"), CONFIG)
    assert not result.geometry.is_used[2]
    assert any("robust: uplink power control" in reason for reason in result.carriers[2].rejected_because)
    assert "c02 has automatic uplink power control and is not used" in result.warnings


def test_a_station_that_does_not_see_the_satellite(data):
    result = calibrate_geometry(with_carrier(data, 1, station=Station(50.0, -80.0)), CONFIG)
    assert not result.geometry.is_used[1]
    assert any("does not see the satellite" in reason for reason in result.carriers[1].rejected_because)


def test_two_carriers_of_one_station(data):
    station = data.plan.carriers[0].station
    result = calibrate_geometry(with_carrier(data, 1, station=station), CONFIG)
    assert all(result.geometry.is_used)


def test_level_control_leaves_differences(payload):
    """The second transponder holds the sum of its four carriers: what all do together does not come through."""
    carriers = (*payload.carriers[:4], *(replace(c, transponder_mode="alc") for c in payload.carriers[4:]))
    coupled = replace(payload, carriers=carriers)

    def levelled(power):
        beyond = power[:, 4:] - payload.level_dbm[4:]
        power[:, 4:] -= beyond.mean(axis=1, keepdims=True)
        return power

    result = calibrate_geometry(with_powers(coupled.data(), levelled), CONFIG)
    assert result.geometry.alc_group == (-1, -1, -1, -1, 0, 0, 0, 0)
    found, truth = slopes(result)[4:], payload.slopes()[4:]
    error = (found - found.mean(axis=0)) - (truth - truth.mean(axis=0))
    # as without level control, a quarter of the rows' worth lost to the mean
    assert (np.sqrt((error**2).mean(axis=0)) < [0.015, 0.05, 0.05]).all()
    assert slopes(result)[:4] == pytest.approx(payload.slopes()[:4], abs=0.08)


def test_a_transponder_under_level_control_with_two_carriers(data):
    for k in (0, 1):
        data = with_carrier(data, k, transponder="K9", transponder_mode="alc")
    result = calibrate_geometry(data, CONFIG)
    assert result.geometry.is_used[:2] == (False, False)
    assert any(text.startswith("c00, c01: a transponder under level control needs 3") for text in result.warnings)


@pytest.mark.parametrize(
    ("band", "downlink_hz", "share"),
    others_slow(("C", 3.7e9, 0.1), ("Ka", 19.7e9, 2.5), ("fss", 7.4e9, 0.5), ("bss", 12e9, 1.0)),
)
def test_bands_take_their_share_of_the_rain(data, band, downlink_hz, share):
    for k in range(3):
        data = with_carrier(data, k, band=band, downlink_hz=downlink_hz)
    fit = calibrate_geometry(data, CONFIG).geometry
    assert fit.rain_share[fit.bands.index(band)] == share
    assert len(fit.downlink) == 2


# ---- what is wrong with the input -----------------------------------------------------------------------------------


def test_no_turns_at_all(payload):
    text = refusal(payload.data(turned=np.zeros_like(turned_angles())))
    assert "no turn of at least 0.1 deg in roll or pitch" in text


def test_windows_without_rows(data):
    cut = replace(data.quiet, epochs_us=data.quiet.epochs_us[:100], power_dbm=data.quiet.power_dbm[:100])
    assert "the quiet window holds 100 measurements, 200 are needed" in refusal(replace(data, quiet=cut))
    none = replace(data.turns, epochs_us=data.turns.epochs_us[:0], power_dbm=data.turns.power_dbm[:0])
    assert "the window of turns holds 0 measurements" in refusal(replace(data, turns=none))
    empty = replace(data.quiet, epochs_us=data.quiet.epochs_us[:0], power_dbm=data.quiet.power_dbm[:0])
    assert "neither window holds a measurement" in refusal(replace(data, quiet=empty, turns=none))


def test_a_silent_star_tracker(data):
    # the last readings of the quiet window reach two rows far
    assert "only 2 rows of the window of turns have angles of star_tracker" in refusal(replace(data, references=()))
    assert "only 2 rows of the quiet window have angles" in refusal(replace(data, quiet_references=()))


def test_a_place_that_is_not_known(data):
    assert "spacecraft of the calibration is not known" in refusal(replace(data, spacecraft=None))
    lost = replace(data.spacecraft, receiving_site=Site(55.0, -90.0))
    assert "receiving site does not see" in refusal(replace(data, spacecraft=lost))


def test_fewer_than_four_carriers(data):
    for k in range(5):
        data = with_carrier(data, k, enabled=False)
    text = refusal(data)
    assert "only 3 carriers can be used, 4 are needed" in text
    assert "c00: disabled in the plan" in text


def test_powers_that_are_all_absent(data):
    assert "only 0 carriers can be used" in refusal(with_powers(data, lambda power: np.full_like(power, NAN)))


def test_missing_rows_and_a_storm_are_survived(payload, data):
    def holes(power):
        power[::7] = NAN
        power[500:700, 3] -= 6.0
        power[900:1000] = NAN
        return power

    result = calibrate_geometry(with_powers(data, holes), CONFIG)
    assert all(result.geometry.is_used)
    assert slopes(result) == pytest.approx(payload.slopes(), abs=0.08)  # six sigma of a healthy fit


@pytest.mark.slow
def test_windows_that_overlap_count_each_row_once(data):
    wider = replace(data.request, quiet=replace(data.request.quiet, stop_us=data.request.turns.stop_us))
    both = replace(
        data.quiet,
        epochs_us=np.concatenate([data.quiet.epochs_us, data.turns.epochs_us]),
        power_dbm=np.concatenate([data.quiet.power_dbm, data.turns.power_dbm]),
    )
    result = calibrate_geometry(replace(data, request=wider, quiet=both), CONFIG)
    apart = calibrate_geometry(data, CONFIG)
    assert result.geometry.gradient == apart.geometry.gradient


def test_a_manoeuvre_inside_is_named_and_survived(payload, data):
    """Half an hour in which levels do what they like."""
    start_us = START_US + DAY + 3 * HOUR
    burn = Operation(7, "station_keeping", start_us, start_us + 30 * MINUTE)
    is_burn = (data.quiet.epochs_us >= burn.start_us) & (data.quiet.epochs_us < burn.stop_us)
    power = data.quiet.power_dbm.copy()
    power[is_burn] += 5.0
    burnt = replace(data, quiet=replace(data.quiet, power_dbm=power), operations=(burn,))
    result = calibrate_geometry(burnt, CONFIG)
    assert any(text.startswith("operation 7 (station_keeping, 2026-12-14T03:00:00") for text in result.warnings)
    assert slopes(result) == pytest.approx(payload.slopes(), abs=0.08)


def test_work_on_one_carrier_leaves_the_others_alone(data, result):
    work = Operation(8, "carrier_work", START_US + DAY, START_US + DAY + 6 * HOUR, carriers=("c03",))
    reported = calibrate_geometry(replace(data, operations=(work,)), CONFIG)
    assert any(text.startswith("operation 8 (carrier_work") for text in reported.warnings)
    assert all(reported.geometry.is_used)
    others = [k for k in range(8) if k != 3]
    # they share the downlink with it, nothing else
    assert slopes(reported)[others] == pytest.approx(slopes(result)[others], abs=0.01)


# ---- several sensors ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_each_axis_may_have_a_sensor_of_its_own(payload, data):
    def of(series, source, axes):
        angles = np.full_like(series.attitude_deg, NAN)
        angles[:, axes] = series.attitude_deg[:, axes]
        return replace(series, source=source, attitude_deg=angles)

    request = replace(data.request, source_yaw="radio_beacon", source_roll="earth_sensor", source_pitch="earth_sensor")
    split = replace(
        data,
        request=request,
        references=tuple(of(data.references[0], *one) for one in (("radio_beacon", [0]), ("earth_sensor", [1, 2]))),
        quiet_references=tuple(
            of(data.quiet_references[0], *one) for one in (("radio_beacon", [0]), ("earth_sensor", [1, 2]))
        ),
    )
    assert calibrate_geometry(split, CONFIG).geometry.gradient == calibrate_geometry(data, CONFIG).geometry.gradient


def test_a_noisy_sensor_shrinks_slopes_little_and_says_by_how_much(payload):
    result = calibrate_geometry(payload.data(sensor_deg=0.06), CONFIG)
    found, truth = slopes(result)[:, 1:], payload.slopes()[:, 1:]
    scale = (found * truth).sum(axis=0) / (truth**2).sum(axis=0)
    # without smoothing 0.9; one sigma of the scale itself is 0.01
    assert scale == pytest.approx([1.0, 1.0], abs=0.05)
    assert result.quality["roll_sensor_sigma_deg"] == pytest.approx(0.06, rel=0.05)
    assert 0.005 < result.quality["roll_slope_shrink"] < 0.04


#: first words of every warning of the joint fit
KINDS = (
    "quiet window",
    "no turn",
    "operation",
    "no track",
    "the daily change contradicts",
    "the sign of yaw",
    "the track covers",
    "the roll sensor",
    "c00 was silent",
    "c00 is flat",
    "c00 drifts",
    "check the coordinates of c00",
)


def kinds(data):
    """Return which kinds of warning a calibration has; the paper part's advice on numbers is not of the joint fit."""
    reported = [text for text in calibrate_geometry(data, CONFIG).warnings if not text.startswith("paper method")]
    found = {kind for kind in KINDS if any(text.startswith(kind) for text in reported)}
    assert len(found) == len(reported), reported
    return found


def with_column(data, k, change):
    parts = []
    for part in (data.quiet, data.turns):
        power = part.power_dbm.copy()
        power[:, k] = change(power[:, k], part.epochs_us)
        parts.append(replace(part, power_dbm=power))
    return replace(data, quiet=parts[0], turns=parts[1])


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_healthy_calibrations_are_silent(seed):
    assert kinds(GeometryPayload.make(8, seed=seed).data(noise_db=0.12)) == set()


def test_a_short_quiet_window():
    assert kinds(GeometryPayload.make(8, quiet_days=2.0).data()) == {"quiet window"}


@pytest.mark.parametrize(("axis", "sides"), others_slow((0, "+yaw, -yaw"), (1, "+roll, -roll"), (2, "+pitch, -pitch")))
def test_an_axis_that_was_not_turned_is_named(axis, sides):
    turned = turned_angles()
    turned[:, axis] = 0.0
    payload = GeometryPayload.make(8)
    result = calibrate_geometry(payload.data(turned=turned), CONFIG)
    assert [text for text in result.warnings if f"towards {sides}:" in text]
    assert all(np.isnan(carrier.sensitivity_plus_db_per_deg[axis]) for carrier in result.carriers)
    assert np.isfinite(result.geometry.gradient).all()
    found = np.array([carrier.sensitivity_db_per_deg for carrier in result.carriers])
    # yaw is told by the stations' places; roll and pitch by 0.03 deg of motion over three days
    limit = {0: 0.02, 1: 0.3, 2: 0.3}[axis]
    assert np.abs(found - payload.slopes())[:, axis].max() < limit


def test_a_side_that_was_not_turned_is_named():
    turned = turned_angles()
    turned[turned[:, 1] < 0.0, 1] = 0.0
    result = calibrate_geometry(GeometryPayload.make(8).data(turned=turned), CONFIG)
    assert any("towards -roll: its slopes rest on one side" in text for text in result.warnings)


def test_no_track():
    payload = GeometryPayload.make(8)
    data = payload.data()
    assert kinds(replace(data, ephemeris=payload.ephemeris(is_tracked=False))) == {"no track"}


def moved(track, rows, east_deg=0.0):
    """Return a track that is some rows ahead, or that of a satellite farther East."""
    last = len(track.epochs_us) - 1
    ahead = [min(k + rows, last) for k in range(last + 1)]
    return Track(
        track.epochs_us,
        tuple(track.latitude_deg[k] for k in ahead),
        tuple(track.longitude_deg[k] + east_deg for k in ahead),
    )


@pytest.mark.parametrize(("rows", "east_deg"), others_slow((6, 0.0), (12, 0.0), (0, 50.0), (10, 50.0)))
def test_a_track_that_the_daily_change_contradicts(rows, east_deg):
    """Half-hourly track: three and six hours ahead, and of satellites 50 deg away."""
    data = GeometryPayload.make(8).data(noise_db=0.12)
    wrong = replace(data.ephemeris, track=moved(data.ephemeris.track, rows, east_deg))
    assert kinds(replace(data, ephemeris=wrong)) == {"the daily change contradicts"}


def test_a_track_that_ends_too_early():
    data = GeometryPayload.make(8).data()
    reported = data.ephemeris.track
    stop = int(np.searchsorted(reported.epochs_us, data.request.turns.start_us - 86_400_000_000))
    track = Track(reported.epochs_us[48:stop], reported.latitude_deg[48:stop], reported.longitude_deg[48:stop])
    result = calibrate_geometry(replace(data, ephemeris=replace(data.ephemeris, track=track)), CONFIG)
    assert any(text.startswith("the track covers only") for text in result.warnings)


def test_a_noisy_sensor():
    warnings = calibrate_geometry(GeometryPayload.make(8).data(sensor_deg=0.12), CONFIG).warnings
    assert any(text.startswith("the roll sensor has a noise of 0.1") for text in warnings)
    assert not any("yaw sensor" in text for text in warnings)


def test_a_silent_carrier():
    data = with_column(GeometryPayload.make(8).data(), 0, lambda power, _: np.full_like(power, np.nan))
    assert kinds(data) == {"c00 was silent"}


def test_a_flat_carrier():
    payload = GeometryPayload.make(8)
    beam = payload.beam.copy()
    beam[0] = (0.02, 0.02, -0.05, 0.0, -0.05)
    flat = replace(payload, beam=beam, downlink=np.zeros((1, 2)))
    assert kinds(flat.data(noise_db=0.1)) == {"c00 is flat"}


def test_a_carrier_that_drifts():
    data = GeometryPayload.make(8).data()
    start_us = data.request.quiet.start_us
    drifting = with_column(data, 0, lambda power, us: power + 0.5 * (us - start_us) / 86_400e6)
    assert "c00 drifts" in kinds(drifting)


def test_a_station_in_another_country():
    """Sixty degrees of longitude, 5 deg in the antenna frame."""
    payload = GeometryPayload.make(8)
    beam = payload.beam.copy()
    beam[0, :2] = (-1.5, 1.5)
    data = replace(payload, beam=beam).data()
    carriers = list(data.plan.carriers)
    position = carriers[0].station
    carriers[0] = replace(carriers[0], station=Station(position.latitude_deg, position.longitude_deg - 60.0))
    wrong = replace(data, plan=replace(data.plan, carriers=tuple(carriers)))
    assert kinds(wrong) == {"check the coordinates of c00"}


NAMES = ("a", "b")


def series(epochs_us, power_dbm=None):
    epochs_us = np.asarray(epochs_us, dtype=np.int64)
    if power_dbm is None:
        power_dbm = np.random.default_rng(1).normal(-45.0, 0.1, (len(epochs_us), len(NAMES)))
    return MeasurementSeries(NAMES, epochs_us, power_dbm)


def parts_of(whole, cuts):
    stops = [*sorted(min(cut, len(whole.epochs_us)) for cut in cuts), len(whole.epochs_us)]
    for start, stop in zip([0, *stops[:-1]], stops, strict=True):
        yield MeasurementSeries(NAMES, whole.epochs_us[start:stop], whole.power_dbm[start:stop])


def equal(one, other):
    arrays = ((found.series.epochs_us, found.series.power_dbm, found.measurements) for found in (one, other))
    for first, second in zip(*arrays, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("period_s", [20, 60, 300])
def test_rows_that_are_no_closer_than_twenty_seconds_stay_to_the_bit(period_s):
    rows = series(np.arange(3000) * period_s * S)
    rows.power_dbm[5, 1] = np.nan
    found = minute_rows([rows], NAMES, [7 * MINUTE])
    np.testing.assert_array_equal(found.series.power_dbm, rows.power_dbm)
    np.testing.assert_array_equal(found.series.epochs_us, rows.epochs_us)
    assert (found.measurements == 1).all()
    assert found.usual_measurements == 1.0


def test_close_rows_become_means_of_a_minute_without_impulses():
    rows = series(np.arange(3600) * S)
    expected = rows.power_dbm.reshape(60, 60, 2).mean(axis=1)
    kept = np.delete(rows.power_dbm[:60, 0], 7).mean()
    rows.power_dbm[7, 0] += 6.0
    rows.power_dbm[60:120, 1] = np.nan
    found = minute_rows([rows], NAMES, ())
    assert found.series.epochs_us.tolist() == [MINUTE * k + 29_500_000 for k in range(60)]
    assert found.series.power_dbm[0, 0] == pytest.approx(kept, abs=1e-12)
    assert np.isnan(found.series.power_dbm[1, 1])
    np.testing.assert_allclose(found.series.power_dbm[2:], expected[2:], atol=1e-12)
    np.testing.assert_array_equal(found.first_dbm, rows.power_dbm[::60])
    assert found.usual_measurements == 60.0


def test_no_mean_reaches_across_a_window_or_an_operation():
    quiet, turns = Window(0, 90 * S), Window(90 * S, 300 * S)
    request = CalibrationRequest(quiet, turns, CalibrationMethod.GEOMETRY)
    operation = Operation(1, "eclipse", 130 * S, 200 * S)
    edges_us = mean_edges_us(request, [operation])
    rows = series(np.arange(300) * S)
    found = minute_rows([rows], NAMES, edges_us)
    assert found.measurements.tolist() == [60, 30, 30, 10, 50, 20, 40, 60]
    # rows that belong to both windows have one epoch
    twice = minute_rows([series(np.arange(60, 300) * S)], NAMES, edges_us)
    assert set(twice.series.epochs_us.tolist()) <= set(found.series.epochs_us.tolist())


@given(st.lists(st.integers(0, 5000), max_size=6), st.sampled_from([1, 5, 13, 19, 20, 60]), st.integers(0, 59_999_999))
def test_where_parts_end_does_not_change_the_rows(cuts, period_s, begin_us):
    rows = series(begin_us + np.arange(5000) * period_s * S)
    equal(minute_rows(parts_of(rows, cuts), NAMES, ()), minute_rows([rows], NAMES, ()))


def test_a_change_of_the_row_period_keeps_every_measurement():
    epochs_us = np.concatenate([np.arange(2000) * MINUTE, 2000 * MINUTE + np.arange(7200) * S])
    found = minute_rows([series(epochs_us)], NAMES, ())
    assert found.measurements.sum() == len(epochs_us)
    assert (np.diff(found.series.epochs_us) > 0).all()
    assert len(found.series.epochs_us) < 2000 + 1200


def test_nothing_has_its_columns():
    found = minute_rows([], NAMES, ())
    assert found.series.power_dbm.shape == found.first_dbm.shape == (0, 2)
    assert found.usual_measurements == 1.0


@pytest.mark.slow
def test_a_calibration_by_means_tells_the_noise_of_a_measurement_and_the_steps_of_the_analyzer():
    data = GeometryPayload.make(8, quiet_days=2.0).data(noise_db=0.02)
    stepped_dbm = np.round(data.quiet.power_dbm / 0.1) * 0.1
    of_means = replace(data, row_measurements=9.0, quiet_first_dbm=stepped_dbm)
    plain, means = (calibrate_geometry(each, CalibrationConfig()) for each in (data, of_means))
    white_db = np.array([[carrier.sigma_white_db for carrier in result.carriers] for result in (plain, means)])
    np.testing.assert_allclose(white_db[1], 3.0 * white_db[0], rtol=1e-12)
    assert plain.quality["quantisation_db"] == 0.0
    assert means.quality["quantisation_db"] == pytest.approx(0.1, rel=0.02)
