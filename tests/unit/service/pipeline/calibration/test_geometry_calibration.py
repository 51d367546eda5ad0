"""Calibration by geometry: known figures come back, the record holds them, and what is missing is said in words."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_payload import DAY, HOUR, MINUTE, NAN, START_US, GeometryPayload, turned_angles

from db.encoding.json_documents import decode, encode
from service.core.estimation.noise_identification import LADDER_S
from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.windows import CalibrationError
from service.pipeline.config import CalibrationConfig
from service.records.calibration import CalibrationResult
from service.records.catalogue import Site, Station
from service.records.inputs import Operation

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
    print(f"seed {payload.seed}: rms of slopes {np.sqrt((error**2).mean(axis=0))} dB/deg")
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
    ("band", "downlink_hz", "share"), [("C", 3.7e9, 0.1), ("Ka", 19.7e9, 2.5), ("fss", 7.4e9, 0.5), ("bss", 12e9, 1.0)]
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
    print(f"Earth sensor of 0.06 deg: scale of roll and pitch {scale}")
    # without smoothing 0.9; one sigma of the scale itself is 0.01
    assert scale == pytest.approx([1.0, 1.0], abs=0.05)
    assert result.quality["roll_sensor_sigma_deg"] == pytest.approx(0.06, rel=0.05)
    assert 0.005 < result.quality["roll_slope_shrink"] < 0.04
