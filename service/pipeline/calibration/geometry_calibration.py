"""Calibration by geometry: all carriers in one fit, tied by where their stations stand.

Powers, sensor angles, orbit and places in, a result with a ``GeometryFit`` or a CalibrationError out. The result also
carries the paper part, so that one calibration serves both methods; where an axis was not turned the paper part of
that axis is NaN and a warning says so. The law of this file: every carrier of the plan stays in the record, those that
the robust method must not use with the reason.

Torque that gathers in the wheels, learned on the quiet days of a calibration from their telemetry.

The filter begins with it in place of a profile that the catalogue states or does not. The law of this file: telemetry
that the turns contradict tells nothing; where quiet days tell nothing, the calibration says why.
"""

from dataclasses import replace

import numpy as np

from service.core.estimation.calibration import responses
from service.core.estimation.filtering.filter_model import FilterSettings
from service.core.estimation.filtering.plant import TORQUES
from service.pipeline.calibration.geometry_fit import JointFit, calibration_warnings, fit_rows, quality_metrics
from service.pipeline.calibration.geometry_rows import (
    CalibrationError,
    CalibrationInput,
    GeometryRows,
    epochs_of,
    geometry_rows,
)
from service.pipeline.calibration.paper_calibration import observe, paper_part
from service.pipeline.calibration.sensor_signs import report_signs
from service.pipeline.calibration.telemetry_checks import (
    axes_quality,
    momentum_check,
    momentum_warnings,
    polarimeter_checks,
    polarimeter_quality,
    polarimeter_warnings,
    rate_check,
    rate_warnings,
)
from service.pipeline.calibration.turns_check import MIN_CARRIERS, turns_check, turns_quality, turns_warnings
from service.pipeline.carrier_model.expected_level import daily_error_db, geometry_model
from service.pipeline.carrier_model.level_control import MIN_GROUP, small_groups
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.known_motion import learned_units, momentum_model
from service.pipeline.inputs.sensor_angles import angles_at
from service.records.calibration import (
    AxesCheck,
    CalibrationResult,
    CarrierCalibration,
    GatheredTorque,
    GeometryFit,
    MotionVerdict,
    NoiseComponent,
    Row,
    Table,
)
from service.records.catalogue import Carrier
from service.records.levels.attitude import BoolArray, FloatArray, named_axes

#: sigmas from which what gathered is not the torque that the catalogue states
_SIGMAS = 3.0
#: records with known angles that are needed
_LEAST_RECORDS = 50
_NEXT = "yaw begins with what onboard.momentum.torque states, or with an unknown torque"


def gathered_torque(
    data: CalibrationInput, check: AxesCheck | None, sigma_deg: FloatArray, config: CalibrationConfig
) -> GatheredTorque | None:
    """Return what the quiet days tell of the torque; sensors have a noise (3,), deg, order yaw, roll, pitch."""
    spacecraft = data.spacecraft
    if spacecraft is None or check is None or check.verdict is MotionVerdict.CONTRADICTED:
        return None
    onboard = spacecraft.onboard
    unknown = None if onboard.momentum is None else replace(onboard.momentum, torque=None)
    wheels = momentum_model(replace(spacecraft, onboard=replace(onboard, momentum=unknown, fed_forward_torque=None)))
    records = data.momentum_records(data.request.quiet)
    if wheels is None or len(records) < _LEAST_RECORDS:
        return None
    epochs_us = epochs_of(records)
    found = responses.gathered_torque(
        epochs_us,
        np.array([one.wheel_momentum_n_m_s for one in records]) @ np.array(spacecraft.wheels.axes),
        angles_at(epochs_us, data.quiet_references, data.sensors, config),
        np.nan_to_num(sigma_deg),
        np.array([bool(one.thrusters_active) for one in records], dtype=np.bool_),
        FilterSettings(momentum=wheels),
    )
    if found is None or found.records < _LEAST_RECORDS:
        return None
    scale = learned_units(spacecraft)
    covariance = scale[:, None] * found.covariance * scale
    return GatheredTorque(
        tuple((scale * found.mean).tolist()),
        tuple(map(tuple, covariance.tolist())),
        found.records,
        data.request.quiet.stop_us,
    )


def gathered_warnings(
    data: CalibrationInput, check: AxesCheck | None, gathered: GatheredTorque | None
) -> tuple[str, ...]:
    """Return why the torque was not learned, or that it is not the one which the catalogue states."""
    spacecraft, wheels = data.spacecraft, momentum_model(data.spacecraft)
    is_left_out = check is None or check.verdict is MotionVerdict.CONTRADICTED
    if spacecraft is None or wheels is None or is_left_out or spacecraft.onboard.fed_forward_torque is not None:
        return ()
    if gathered is None:
        records = len(data.momentum_records(data.request.quiet))
        reason = (
            f"{records} records of momentum within the quiet days, {_LEAST_RECORDS} are needed"
            if records < _LEAST_RECORDS
            else "its records on the quiet days contradict one another, or no sensor tells the angles at them"
        )
        return (f"the torque that gathers in the wheels was not learned: {reason}; {_NEXT}",)
    if wheels.profile is None:
        return ()
    stated = learned_units(spacecraft)[:TORQUES] * np.concatenate(wheels.profile[:3])
    sigma = np.sqrt(np.trace(np.array(gathered.covariance)[:TORQUES, :TORQUES]))
    off, size = float(np.linalg.norm(np.array(gathered.mean[:TORQUES]) - stated)), float(np.linalg.norm(stated))
    if off <= _SIGMAS * (wheels.profile.relative_error + wheels.profile.axis_relative_error) * size + _SIGMAS * sigma:
        return ()
    return (
        f"the torque that gathered in the wheels differs from onboard.momentum.torque by {off:.2g} of {size:.2g} N m; "
        "the filter takes what gathered: correct the profile, its sign or its epoch",
    )


def gathered_quality(gathered: GatheredTorque | None) -> dict[str, float]:
    """Return the figures of the torque, by name."""
    if gathered is None:
        return {}
    parts = np.array(gathered.mean[:TORQUES]).reshape(3, 3)
    sigma = np.sqrt(np.diag(np.array(gathered.covariance)))[:TORQUES].reshape(3, 3)
    figures = {"gathered_torque_records": float(gathered.records)}
    for axis, name in enumerate(("yaw", "roll", "pitch")):
        figures[f"gathered_constant_{name}_n_m"] = float(parts[0, axis])
        figures[f"gathered_daily_{name}_n_m"] = float(np.hypot(parts[1, axis], parts[2, axis]))
        figures[f"gathered_{name}_sigma_n_m"] = float(np.linalg.norm(sigma[:, axis]))
    return figures


#: Share of the receiving site's rain that a band takes, Ku 1: ratio of the specific attenuations at 25 mm/h (ITU-R
#: P.838: about 0.9 dB/km at 11 GHz, 0.4 at 8, 2.5 at 19); below 7 GHz rain itself is nothing and a wet feed remains.
RAIN_SHARE = {"L": 0.1, "S": 0.1, "C": 0.1, "X": 0.5, "Ku": 1.0, "K": 2.5, "Ka": 2.5}
#: The same by downlink frequency, Hz, for bands of other names: below each, that share.
_SHARE_BELOW_HZ = ((7e9, 0.1), (10e9, 0.5), (17e9, 1.0))
_HIGHEST_SHARE = 2.5


def calibrate_geometry(data: CalibrationInput, config: CalibrationConfig) -> CalibrationResult:
    """Return the calibration of every carrier of the plan by one joint fit.

    Raises
    ------
    CalibrationError
        Too few rows or angles in a window, no axis turned, an unknown place, fewer than four usable carriers, or powers
        that contradict the axes of the sensors.
    """
    rows = geometry_rows(data, config)
    joint = fit_rows(data, rows, config)
    refusals = _refusals(data, rows, joint)
    is_used = np.array([reason is None for reason in refusals])
    is_user_carrier = is_used & ~rows.positions.is_beacon
    if np.count_nonzero(is_user_carrier) < MIN_CARRIERS:
        raise CalibrationError(_too_few(data, refusals, int(np.count_nonzero(is_user_carrier))))
    paper = paper_part(data, config, is_every_axis_needed=False)
    white_db = joint.noise.white_db * data.white_scale
    carriers = tuple(_carrier(one, k, joint, float(white_db[k]), refusals[k]) for k, one in enumerate(paper.carriers))
    quality = quality_metrics(rows, joint, is_used)
    turns = turns_check(data, rows, joint, is_user_carrier, config)
    judged = rows.positions, joint.fit.free, is_user_carrier & (joint.group < 0), quality["yaw_turn_reach_deg"]
    report = report_signs(data, config, *judged, doubt=turns.reason)
    momentum, rates, angles = momentum_check(data, config), rate_check(data, config), polarimeter_checks(data, config)
    gathered = gathered_torque(data, momentum, rows.angles.sensor_sigma_deg, config)
    sigma_db = np.hypot(white_db, joint.noise.slow_db)
    record = geometry_record(data, rows, joint, is_used)
    error_db = daily_error_db(geometry_model(record), record, data.ephemeris, data.request.quiet.start_us)
    return CalibrationResult(
        carriers,
        observe(joint.response.slope[is_user_carrier], sigma_db[is_user_carrier]),
        {
            **paper.quality,
            **quality,
            **turns_quality(turns),
            **report.quality,
            **axes_quality("momentum", momentum),
            **axes_quality("rate", rates),
            **polarimeter_quality(angles),
            **gathered_quality(gathered),
        },
        (
            *turns_warnings(turns),
            *calibration_warnings(data, rows, joint, is_used, config),
            *report.warnings,
            *momentum_warnings(momentum),
            *gathered_warnings(data, momentum, gathered),
            *rate_warnings(data, rates),
            *polarimeter_warnings(angles),
            # the joint fit says the others itself
            *(f"paper method: {text}" for text in paper.warnings if "carriers are stable and linear" in text),
        ),
        replace(record, daily_error_db=_row(error_db)),
        report.signs,
        momentum,
        rates,
        angles,
        gathered,
        turns,
    )


def geometry_record(data: CalibrationInput, rows: GeometryRows, joint: JointFit, is_used: BoolArray) -> GeometryFit:
    """Return the fit as the archive keeps it."""
    fit = joint.fit
    geometry, stations, carriers = rows.positions.geometry, rows.positions.stations, data.plan.carriers
    transponders = tuple(sorted({carrier.transponder for carrier in carriers}))
    return GeometryFit(
        is_dish_law=fit.is_dish_law,
        bands=rows.positions.bands,
        band=tuple(geometry.band.tolist()),
        rain_share=tuple(_rain_share(band, carriers) for band in rows.positions.bands),
        transponders=transponders,
        transponder=tuple(transponders.index(carrier.transponder) for carrier in carriers),
        station_azimuth_deg=_row(geometry.azimuth_deg),
        station_elevation_deg=_row(geometry.elevation_deg),
        station_latitude_deg=_row(stations.latitude_deg[:-1]),
        station_longitude_deg=_row(stations.longitude_deg[:-1]),
        site_deg=(float(geometry.site_deg[0]), float(geometry.site_deg[1])),
        site_position=(
            float(stations.latitude_deg[-1]),
            float(stations.longitude_deg[-1]),
            float(stations.height_m[-1]),
        ),
        nominal_longitude_deg=data.spacecraft.longitude_deg if data.spacecraft else float("nan"),
        level_dbm=_row(fit.level_dbm),
        daily=_table(fit.daily),
        gradient=_table(fit.gradient),
        hessian=_table(fit.hessian),
        downlink=_table(fit.downlink),
        covariance=tuple(_table(one) for one in fit.covariance),
        downlink_covariance=_table(fit.downlink_covariance),
        downlink_gain=tuple(_table(one) for one in fit.downlink_gain),
        solar_day_db=_table(fit.solar_db),
        quantisation_db=_row(joint.quantisation_db),
        reference_walk_db=_row(joint.drift.walk_db),
        common_noise=_common_noise(joint),
        is_used=tuple(bool(used) for used in is_used),
        alc_group=tuple(joint.group.tolist()) if (joint.group >= 0).any() else (),
    )


def _common_noise(joint: JointFit) -> tuple[NoiseComponent, ...]:
    """Return the parts of the noise that all carriers share."""
    parts = zip(joint.noise.tau_s.tolist(), joint.noise.common_db.tolist(), strict=True)
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


def _refusals(data: CalibrationInput, rows: GeometryRows, joint: JointFit) -> tuple[str | None, ...]:
    """Return for each carrier why the robust method must not use it, None if it may."""
    carriers, lonely = data.plan.carriers, "its transponder is under level control and has fewer than"
    reasons = (
        ([not each.enabled for each in carriers], "disabled in the plan"),
        (
            [each.uplink_power_control == "auto" for each in carriers],
            "uplink power control hides the effect of the attitude",
        ),
        (
            np.isnan(rows.positions.geometry.azimuth_deg) & ~rows.positions.is_beacon,
            "its station does not see the satellite: check its coordinates",
        ),
        (small_groups(joint.group), f"{lonely} {MIN_GROUP} carriers in the plan"),
        (np.isnan(joint.fit.level_dbm), "seen in too few stretches of the windows"),
    )
    return tuple(next((text for applies, text in reasons if applies[k]), None) for k in range(len(carriers)))


def _too_few(data: CalibrationInput, refusals: tuple[str | None, ...], usable: int) -> str:
    """Return the text that says how many carriers are left and why the others are not."""
    reasons = [f"{c.id}: {why}" for c, why in zip(data.plan.carriers, refusals, strict=True) if why is not None]
    shown = "; ".join(reasons[:5]) + (f"; and {len(reasons) - 5} more" if len(reasons) > 5 else "")
    text = f"only {usable} carriers can be used, {MIN_CARRIERS} are needed for three angles and the common level"
    return f"{text} ({shown})" if shown else text


def _carrier(
    paper: CarrierCalibration, k: int, joint: JointFit, white_db: float, refusal: str | None
) -> CarrierCalibration:
    """Return a carrier of the paper part with the noise and the slopes of the joint fit."""
    parts = zip(joint.noise.tau_s.tolist(), joint.noise.sigma_db[k].tolist(), strict=True)
    slope = joint.response.slope[k]
    return replace(
        paper,
        sigma_white_db=white_db,
        noise=tuple(NoiseComponent(tau_s, sigma_db) for tau_s, sigma_db in parts),
        sensitivity_db_per_deg=named_axes(slope) if np.isfinite(slope).all() else paper.sensitivity_db_per_deg,
        rejected_because=paper.rejected_because + ((f"robust: {refusal}",) if refusal is not None else ()),
    )
