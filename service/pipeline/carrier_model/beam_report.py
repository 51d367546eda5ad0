"""Beams as a by-product: boresight of each antenna against the body, and beams at the stations."""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from service.core.estimation.beams import (
    MIN_CARRIERS,
    BoresightFit,
    BoresightSeries,
    StationBeams,
    Wave,
    boresight_series,
    changes_in_sigmas,
    fit_boresight,
    station_beams,
)
from service.core.estimation.calibration.geometry_columns import predict_deviation
from service.pipeline.carrier_model.expected_level import GeometryModel, geometry_model
from service.records.calibration import CalibrationResult, CarrierCalibration, GeometryFit, Window
from service.records.epoch import US_PER_S
from service.records.levels.attitude import BoolArray, FloatArray, IntArray

_HOUR_S, _YEAR_DAYS = 3600.0, 365.25
_DAY_RAD_S = 2.0 * math.pi / 86_400.0
#: dB, least noise of an hour's mean: levels are stored in steps of 0.004 dB
_LEAST_SIGMA_DB = 0.005
_DAY_US = 86_400 * US_PER_S


def hourly_sigma_db(carrier: CarrierCalibration, rows: IntArray) -> float:
    """Return the noise of an hour's mean by the noise of the calibration; rows (H,) of each mean."""
    seen = rows[rows > 0]
    white_db2 = np.nan_to_num(carrier.sigma_white_db, nan=1.0) ** 2 / (np.median(seen) if len(seen) else 1.0)
    # mean of a process of the first order over an hour
    share = [(part.sigma_db, part.correlation_time_s / _HOUR_S) for part in carrier.noise]
    slow_db2 = sum(size**2 * 2.0 * tau * (1.0 - tau * -math.expm1(-1.0 / tau)) for size, tau in share)
    return float(np.sqrt(white_db2 + slow_db2 + _LEAST_SIGMA_DB**2))


def daily_error_db(result: CalibrationResult, fit: GeometryFit, quiet: Window, start_us: IntArray) -> FloatArray:
    """Return the error of each carrier's calibrated daily change (N,) at the hours, rms, dB.

    Quiet days tell the sum of what the orbit and the Sun do each day as well as the noise lets them, and the two apart
    badly: they come apart as the orbit's day, four minutes shorter, moves on.
    """
    span_s = (quiet.stop_us - quiet.start_us) / US_PER_S
    power = [
        sum(
            part.sigma_db**2 * part.correlation_time_s / (1.0 + (_DAY_RAD_S * part.correlation_time_s) ** 2)
            for part in one.noise
        )
        for one in result.carriers
    ]
    if not len(start_us):
        return np.sqrt(4.0 * np.array(power) / span_s)
    days = (float(start_us.mean()) - 0.5 * (quiet.start_us + quiet.stop_us)) / _DAY_US
    apart = 2.0 * math.sin(math.pi * days / _YEAR_DAYS) * np.array(fit.daily_error_db or (0.0,) * len(power))
    return np.sqrt(4.0 * np.array(power) / span_s + np.square(apart))


HOUR_US = 3600 * US_PER_S
#: deg, by which the sensor's roll and pitch may range within an hour whose means are compared
MAX_TURN_DEG = 0.1
#: sigmas from which a change is reported as found
_FOUND_SIGMAS = 3.0


class Group(StrEnum):
    """Carriers taken for those of one antenna."""

    BAND = "band"
    TRANSPONDER = "transponder"


class WaveCause(StrEnum):
    """Cause of a daily change that was found."""

    #: nothing was found, or the series is too short
    NONE = "none"
    #: it differs from that of the other antennas
    ANTENNA = "antenna"
    #: there is no other antenna to compare with
    ANTENNA_OR_SENSOR = "antenna_or_sensor"
    #: the other antennas show the same
    BODY_OR_SENSOR = "body_or_sensor"


class HourlyMeans(NamedTuple):
    """Means of H hours for N carriers."""

    start_us: IntArray
    #: (H, N) dB, and of how many rows each is the mean
    deviation_db: FloatArray
    rows: IntArray
    #: (H, 3) deg, of the sensor, and by how much its roll or pitch ranged (H,)
    attitude_deg: FloatArray
    range_deg: FloatArray


@dataclass(frozen=True, slots=True)
class AntennaReport:
    """Boresight of one antenna; axes East and North in the antenna frame."""

    antenna: str
    carrier_ids: tuple[str, ...]
    series: BoresightSeries
    east: BoresightFit
    north: BoresightFit
    cause: WaveCause


@dataclass(frozen=True, slots=True)
class StationReport:
    """Uplink beam at the station of one carrier."""

    carrier: str
    transponder: str
    #: East and North in the antenna frame
    azimuth_deg: float
    elevation_deg: float
    #: dB/deg to East and North, and their sigmas
    gradient: tuple[float, float]
    gradient_sigma: tuple[float, float]
    #: dB/deg^2 East East, East North, North North, and their sigmas
    curvature: tuple[float, float, float]
    curvature_sigma: tuple[float, float, float]
    #: by how many sigmas the gradient differs from that of the campaign before; NaN = no campaign before
    change_sigmas: float


@dataclass(frozen=True, slots=True)
class BeamReport:
    """Report of all antennas and stations."""

    hours: HourlyMeans
    #: (H,) hours in which the body turned too much to compare means
    is_turned: BoolArray
    antennas: tuple[AntennaReport, ...]
    stations: tuple[StationReport, ...]


def beam_report(
    result: CalibrationResult,
    fit: GeometryFit,
    quiet: Window,
    before: CalibrationResult | None,
    hours: HourlyMeans,
    group: Group,
) -> BeamReport:
    """Return boresights by the hour, their daily and yearly change, and the beams at the stations.

    Parameters
    ----------
    result : CalibrationResult
        Calibration in force, with the geometry ``fit``.
    quiet : Window
        Quiet days from which it has the daily change.
    before : CalibrationResult or None
        Campaign before it, to compare gradients with.
    hours : HourlyMeans
        In the order of the calibration's carriers.
    group : Group
        Carriers that share an antenna.
    """
    model = geometry_model(fit, result.carriers)
    beams = station_beams(model.calibration)
    is_turned = hours.range_deg > MAX_TURN_DEG
    rest_db = hours.deviation_db - predict_deviation(hours.attitude_deg, model.response)
    rest_db = np.where(is_turned[:, None], np.nan, rest_db)
    names = _antenna_names(fit, group)
    ids = tuple(carrier.id for carrier in result.carriers)
    each = zip(result.carriers, hours.rows.T, strict=True)
    sigma_db = np.array([hourly_sigma_db(carrier, rows) for carrier, rows in each])
    error_db = daily_error_db(result, fit, quiet, hours.start_us)
    found = []
    for antenna in sorted(set(names)):
        members = np.flatnonzero(_shows_beam(fit, model, beams) & (np.array(names) == antenna))
        if len(members) >= MIN_CARRIERS:
            series = boresight_series(rest_db[:, members], beams.gradient_db_deg[members], sigma_db[members])
            found.append(_antenna(antenna, tuple(ids[k] for k in members), series, hours, error_db[members]))
    return BeamReport(hours, is_turned, _with_causes(found, hours), _stations(result, fit, beams, before))


def _antenna_names(fit: GeometryFit, group: Group) -> list[str]:
    """Return the antenna of each carrier."""
    if group is Group.BAND:
        return [fit.bands[k] for k in fit.band]
    return [fit.transponders[k] for k in fit.transponder]


def _shows_beam(fit: GeometryFit, model: GeometryModel, beams: StationBeams) -> BoolArray:
    """Return which carriers (N,) show the pattern of their uplink beam."""
    is_user = np.isfinite(np.array(fit.station_azimuth_deg)) & np.array(fit.is_used)
    is_free = np.array(fit.alc_group or (-1,) * len(is_user)) < 0
    is_fitted = np.isfinite(model.response.slope).all(axis=1) & np.isfinite(beams.gradient_db_deg).all(axis=1)
    return np.asarray(is_user & is_free & is_fitted)


def _antenna(
    name: str, carrier_ids: tuple[str, ...], series: BoresightSeries, hours: HourlyMeans, daily_error_db: FloatArray
) -> AntennaReport:
    """Return the fits of both axes, less sure by what the calibration leaves open of the carriers' daily change."""
    middle_s = (hours.start_us + HOUR_US // 2) / US_PER_S
    # a wave of rms e has the amplitude e sqrt(2), which is the sigma of each of its parts
    open_deg = np.sqrt(2.0) * np.linalg.norm(series.gain_deg_per_db * daily_error_db, axis=1)
    east, north = (
        _less_sure(fit_boresight(middle_s, series.boresight_deg[:, k], series.sigma_deg[:, k]), float(open_deg[k]))
        for k in range(2)
    )
    return AntennaReport(name, carrier_ids, series, east, north, WaveCause.NONE)


def _less_sure(fit: BoresightFit, sigma_deg: float) -> BoresightFit:
    """Return a fit with another part of the sigma of its daily wave."""
    return fit._replace(daily=fit.daily._replace(sigma_deg=float(np.hypot(fit.daily.sigma_deg, sigma_deg))))


def _with_causes(found: list[AntennaReport], hours: HourlyMeans) -> tuple[AntennaReport, ...]:
    """Return the antennas with the cause of their daily change."""
    return tuple(replace(one, cause=_cause(one, [each for each in found if each is not one], hours)) for one in found)


def _cause(one: AntennaReport, others: list[AntennaReport], hours: HourlyMeans) -> WaveCause:
    """Return what the daily change of an antenna proves."""
    if not (_is_found(one.east.daily) or _is_found(one.north.daily)):
        return WaveCause.NONE
    if not others:
        return WaveCause.ANTENNA_OR_SENSOR
    middle_s = (hours.start_us + HOUR_US // 2) / US_PER_S
    for other in others:
        for k, axis in enumerate(("east", "north")):
            difference = one.series.boresight_deg[:, k] - other.series.boresight_deg[:, k]
            sigma = np.hypot(one.series.sigma_deg[:, k], other.series.sigma_deg[:, k])
            own_deg, its_deg = getattr(one, axis).daily.sigma_deg, getattr(other, axis).daily.sigma_deg
            daily = fit_boresight(middle_s, difference, sigma).daily
            if _is_found(daily._replace(sigma_deg=float(np.hypot(own_deg, its_deg)))):
                return WaveCause.ANTENNA
    return WaveCause.BODY_OR_SENSOR


def _is_found(wave: Wave) -> bool:
    """Return whether a wave is larger than chance."""
    return bool(wave.amplitude_deg > _FOUND_SIGMAS * wave.sigma_deg)


def _stations(
    result: CalibrationResult, fit: GeometryFit, beams: StationBeams, before: CalibrationResult | None
) -> tuple[StationReport, ...]:
    """Return the beams at the stations and how they changed since the campaign before."""
    change = _changes(result, fit, beams, before)
    position = np.column_stack([fit.station_azimuth_deg, fit.station_elevation_deg])
    is_known = np.isfinite(position).all(axis=1) & np.isfinite(beams.gradient_db_deg).all(axis=1)
    return tuple(
        StationReport(
            result.carriers[k].id,
            fit.transponders[fit.transponder[k]],
            float(position[k, 0]),
            float(position[k, 1]),
            tuple(beams.gradient_db_deg[k].tolist()),
            tuple(beams.gradient_sigma[k].tolist()),
            tuple(beams.curvature_db_deg2[k].tolist()),
            tuple(beams.curvature_sigma[k].tolist()),
            float(change[k]),
        )
        for k in np.flatnonzero(is_known)
    )


def _changes(
    result: CalibrationResult, fit: GeometryFit, beams: StationBeams, before: CalibrationResult | None
) -> FloatArray:
    """Return by how many sigmas (N,) gradients changed; NaN for carriers that the other campaign did not have there."""
    if before is None or before.geometry is None:
        return np.full(len(result.carriers), np.nan)
    other = before.geometry
    model = geometry_model(other, before.carriers)
    earlier = station_beams(model.calibration)
    numbers = {carrier.id: k for k, carrier in enumerate(before.carriers)}
    # a carrier that the other campaign lacks is compared with any and left out below
    at = np.array([numbers.get(carrier.id, 0) for carrier in result.carriers])
    change = changes_in_sigmas(beams, StationBeams(*(values[at] for values in earlier)))
    then = np.column_stack([other.station_azimuth_deg, other.station_elevation_deg])[at]
    now = np.column_stack([fit.station_azimuth_deg, fit.station_elevation_deg])
    is_same = np.array([carrier.id in numbers for carrier in result.carriers]) & np.isclose(then, now, atol=0.02).all(1)
    return np.where(is_same, change, np.nan)
