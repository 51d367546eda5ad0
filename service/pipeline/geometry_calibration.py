"""Calibration by geometry: all carriers in one fit, tied by where their stations stand.

Powers, sensor angles, orbit and places in, a result with a ``GeometryFit`` or a CalibrationError out. The result also
carries the paper part, so that one calibration serves both methods; where an axis was not turned the paper part of
that axis is NaN and a warning says so. The law of this file: every carrier of the plan stays in the record, those that
the robust method must not use with the reason.
"""

from dataclasses import replace

import numpy as np

from service.core.estimation.calibration.geometry_calibration import GeometryCalibration, fit_geometry
from service.core.estimation.calibration.geometry_prediction import response_of
from service.pipeline.calibration import observe, paper_part
from service.pipeline.calibration_rows import CalibrationError, CalibrationInput
from service.pipeline.config import CalibrationConfig
from service.pipeline.geometry_rows import GeometryRows, geometry_rows
from service.records.attitude import BoolArray, FloatArray, named_axes
from service.records.calibration import CalibrationResult, CarrierCalibration
from service.records.catalogue import Carrier
from service.records.geometry import GeometryFit, Row, Table
from service.records.noise import NoiseComponent

#: Share of the receiving site's rain that a band takes, Ku 1: ratio of the specific attenuations at 25 mm/h (ITU-R
#: P.838: about 0.9 dB/km at 11 GHz, 0.4 at 8, 2.5 at 19); below 7 GHz rain itself is nothing and a wet feed remains.
RAIN_SHARE = {"L": 0.1, "S": 0.1, "C": 0.1, "X": 0.5, "Ku": 1.0, "K": 2.5, "Ka": 2.5}
#: The same by downlink frequency, Hz, for bands of other names: below each, that share.
_SHARE_BELOW_HZ = ((7e9, 0.1), (10e9, 0.5), (17e9, 1.0))
_HIGHEST_SHARE = 2.5
#: fewest carriers that determine three angles and a common level
MIN_CARRIERS = 4


def calibrate_geometry(data: CalibrationInput, config: CalibrationConfig) -> CalibrationResult:
    """Return the calibration of every carrier of the plan by one joint fit.

    Raises
    ------
    CalibrationError
        Too few rows or angles in a window, no axis turned, an unknown place, or fewer than four usable carriers.
    """
    rows = geometry_rows(data, config)
    fit = fit_geometry(rows.rows, rows.places.geometry)
    refusals = tuple(_refusal(carrier, k, rows, fit) for k, carrier in enumerate(data.plan.carriers))
    is_used = np.array([reason is None for reason in refusals])
    is_beacon = rows.places.is_beacon
    if np.count_nonzero(is_used & ~is_beacon) < MIN_CARRIERS:
        raise CalibrationError(_too_few(data, refusals, int(np.count_nonzero(is_used & ~is_beacon))))
    paper = paper_part(data, config, is_every_axis_needed=False)
    slope = response_of(fit, rows.places.geometry).slope
    carriers = tuple(_carrier(one, k, fit, slope, refusals[k]) for k, one in enumerate(paper.carriers))
    is_seeing = is_used & ~is_beacon
    sigma_db = np.hypot(fit.noise.white_db, np.sqrt((fit.noise.sigma_db**2).sum(axis=1)))
    return CalibrationResult(
        carriers,
        observe(slope[is_seeing], sigma_db[is_seeing]),
        paper.quality,
        paper.warnings,
        geometry_record(data, rows, fit, is_used),
    )


def geometry_record(
    data: CalibrationInput, rows: GeometryRows, fit: GeometryCalibration, is_used: BoolArray
) -> GeometryFit:
    """Return the fit as the archive keeps it."""
    geometry, stations, carriers = rows.places.geometry, rows.places.stations, data.plan.carriers
    transponders = tuple(sorted({carrier.transponder for carrier in carriers}))
    return GeometryFit(
        is_dish_law=fit.is_dish_law,
        bands=rows.places.bands,
        band=tuple(geometry.band.tolist()),
        rain_share=tuple(_rain_share(band, carriers) for band in rows.places.bands),
        transponders=transponders,
        transponder=tuple(transponders.index(carrier.transponder) for carrier in carriers),
        station_azimuth_deg=_row(geometry.azimuth_deg),
        station_elevation_deg=_row(geometry.elevation_deg),
        station_latitude_deg=_row(stations.latitude_deg[:-1]),
        station_longitude_deg=_row(stations.longitude_deg[:-1]),
        site_deg=(float(geometry.site_deg[0]), float(geometry.site_deg[1])),
        site_place=(float(stations.latitude_deg[-1]), float(stations.longitude_deg[-1]), float(stations.height_m[-1])),
        nominal_longitude_deg=data.spacecraft.longitude_deg if data.spacecraft else float("nan"),
        level_dbm=_row(fit.level_dbm),
        daily=_table(fit.daily),
        gradient=_table(fit.gradient),
        hessian=_table(fit.hessian),
        downlink=_table(fit.downlink),
        covariance=tuple(_table(one) for one in fit.covariance),
        downlink_covariance=_table(fit.downlink_covariance),
        downlink_gain=tuple(_table(one) for one in fit.downlink_gain),
        solar_day_db=_table(np.zeros((len(carriers), 2)) if fit.solar_db is None else fit.solar_db),
        quantisation_db=_row(np.zeros(len(carriers))),
        reference_walk_db=_row(np.full(len(carriers), 0.006)),
        common_noise=_common_noise(fit),
        is_used=tuple(bool(used) for used in is_used),
    )


def _common_noise(fit: GeometryCalibration) -> tuple[NoiseComponent, ...]:
    """Return the parts of the noise that all carriers share."""
    if fit.learned is None:
        return ()
    parts = zip(fit.learned.tau_s.tolist(), fit.learned.common_db.tolist(), strict=True)
    return tuple(NoiseComponent(tau_s, sigma_db) for tau_s, sigma_db in parts if sigma_db > 0.0)


def _row(values: FloatArray) -> Row:
    """Return a vector as the record keeps it."""
    return tuple(float(value) for value in values)


def _table(values: FloatArray) -> Table:
    """Return a matrix as the record keeps it."""
    return tuple(_row(row) for row in values)


def _rain_share(band: str, carriers: tuple[Carrier, ...]) -> float:
    """Return the share of a band, by its name or else by the frequency of its carriers."""
    if band in RAIN_SHARE:
        return RAIN_SHARE[band]
    downlink_hz = float(np.median([carrier.downlink_hz for carrier in carriers if carrier.band == band]))
    return next((share for limit_hz, share in _SHARE_BELOW_HZ if downlink_hz < limit_hz), _HIGHEST_SHARE)


def _refusal(carrier: Carrier, k: int, rows: GeometryRows, fit: GeometryCalibration) -> str | None:
    """Return why the robust method must not use a carrier, None if it may."""
    if not carrier.enabled:
        return "disabled in the plan"
    if carrier.uplink_power_control == "auto":
        return "uplink power control hides what the attitude does: never used for attitude"
    if np.isnan(fit.level_dbm[k]):
        return "seen in too few stretches of the windows"
    if carrier.station is not None and np.isnan(rows.places.geometry.azimuth_deg[k]):
        return "its station does not see the satellite: check its coordinates"
    return None


def _too_few(data: CalibrationInput, refusals: tuple[str | None, ...], usable: int) -> str:
    """Return the text that says how many carriers are left and why the others are not."""
    reasons = [f"{c.id}: {why}" for c, why in zip(data.plan.carriers, refusals, strict=True) if why is not None]
    shown = "; ".join(reasons[:5]) + (f"; and {len(reasons) - 5} more" if len(reasons) > 5 else "")
    text = f"only {usable} carriers can be used, {MIN_CARRIERS} are needed for three angles and the common level"
    return f"{text} ({shown})" if shown else text


def _carrier(
    paper: CarrierCalibration, k: int, fit: GeometryCalibration, slope: FloatArray, refusal: str | None
) -> CarrierCalibration:
    """Return a carrier of the paper part with the noise and the slopes of the joint fit."""
    parts = zip(fit.noise.tau_s[k], fit.noise.sigma_db[k], strict=True)
    reasons = paper.rejected_because + ((f"robust: {refusal}",) if refusal is not None else ())
    return replace(
        paper,
        sigma_white_db=float(fit.noise.white_db[k]),
        noise=tuple(NoiseComponent(float(tau_s), float(sigma_db)) for tau_s, sigma_db in parts),
        sensitivity_db_per_deg=named_axes(slope[k]),
        rejected_because=reasons,
    )
