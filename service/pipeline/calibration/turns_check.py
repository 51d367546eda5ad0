"""Check of a calibration's turns: one clock, one unit, one motion behind the powers and the sensor's angles.

The law of this file: a calibration is refused where clock, unit or sensor is contradicted, never for weather, which
carriers do not share; the likeliest cause is named, with its figures.
"""

import math
from dataclasses import replace

import numpy as np

from service.core.estimation.calibration.geometry_calibration import predict_level_dbm
from service.core.estimation.calibration.geometry_columns import BEAM_SIZE
from service.core.estimation.calibration.turns import (
    EARTH_WIDTH_DEG,
    LONGEST_LAG_S,
    BeamScale,
    TurnLag,
    TurnPowers,
    beam_scale,
    turn_lag,
)
from service.core.estimation.calibration.whitened_fit import coloured_noise
from service.core.estimation.observability import crlb_deg
from service.pipeline.calibration.geometry_fit import JointFit, fit_rows
from service.pipeline.calibration.geometry_rows import (
    CalibrationError,
    CalibrationInput,
    GeometryRows,
    geometry_rows,
    inside,
    joined_rows,
    orbit_motion,
    phase_rad,
    undisturbed,
)
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.sensor_angles import angles_at
from service.records.calibration import MotionVerdict, TurnsCheck
from service.records.epoch import US_PER_S
from service.records.levels.attitude import BoolArray, FloatArray, IntArray
from service.records.levels.measurement import ReferenceSeries

#: sigmas beyond which a figure contradicts
_SIGMAS = 4.0
#: s, a lag up to this is bearable where it costs no angle a third of its sigma
_BEARABLE_S, _BEARABLE_SHARE = 120.0, 1.0 / 3.0
#: units that angles are sent in by mistake, in each degree
_UNITS = {"mrad": 1e3 * math.pi / 180.0, "arcmin": 60.0, "arcsec": 3600.0, "rad": math.pi / 180.0}
#: logarithm of a scale from which milliradians are likelier than degrees
_NEARER_UNIT = 0.5 * math.log(_UNITS["mrad"])
#: readings may lie this many of their periods from an epoch
_REACH_PERIODS = 0.6
#: s, grid of the angles, as close as rows of the fit are
_GRID_S = 20
#: fewest carriers that determine three angles and a common level
MIN_CARRIERS = 4


def paper_turns(data: CalibrationInput, config: CalibrationConfig) -> TurnsCheck | None:
    """Return the check for a calibration by the paper method; None where places or carriers are too few.

    The joint fit serves the check alone. Where no sensor tells the angles of the quiet days, they are zero, as the
    method takes them.
    """
    at_us = data.quiet.epochs_us
    still = np.zeros((len(at_us), 3))
    zero = tuple(ReferenceSeries(name, at_us, still, still) for name in sorted(set(data.sensors)))
    try:
        data = replace(data, quiet_references=data.quiet_references or zero)
        rows = geometry_rows(data, config)
    except CalibrationError:
        return None
    joint = fit_rows(data, rows, config)
    is_used = np.isfinite(joint.fit.level_dbm) & ~rows.positions.is_beacon
    return turns_check(data, rows, joint, is_used, config) if np.count_nonzero(is_used) >= MIN_CARRIERS else None


def turns_check(
    data: CalibrationInput, rows: GeometryRows, joint: JointFit, is_used: BoolArray, config: CalibrationConfig
) -> TurnsCheck:
    """Return the check by the carriers (N,) that are used and have a station."""
    lag = _lag(data, rows, joint, is_used, config)
    transponders = [carrier.transponder for carrier in data.plan.carriers]
    fit, beam = joint.fit, np.unique(transponders, return_inverse=True)[1]
    beams = np.concatenate([fit.gradient, fit.hessian], axis=1)
    own = slice(-BEAM_SIZE, None)
    scale = beam_scale(beams, fit.covariance[:, own, own], rows.positions.geometry, beam, is_used & (joint.group < 0))
    check = TurnsCheck(MotionVerdict.UNCHECKED, "", scale=scale.scale, scale_sigma=scale.log_sigma)
    reach_deg = float(np.nanmax(np.abs(rows.angles.attitude_deg[~rows.is_quiet])))
    reason = ""
    if lag is not None:
        scatter = float(np.nanmedian(np.where(is_used, lag.left, np.nan)))
        lag_s, sigma_s = lag.best
        check = replace(check, lag_s=lag_s, lag_sigma_s=sigma_s, scatter=scatter, shared=lag.shared_sigmas)
        # another sensor's turns fit some lag, and beams by a lagging clock some unit
        reason = _about_sensor(data, check, config) or _about_lag(data, rows, joint, is_used, lag)
    reason = reason or _about_scale(scale, reach_deg)
    verdict = MotionVerdict.UNCHECKED if lag is None else MotionVerdict.CONSISTENT
    return replace(check, verdict=MotionVerdict.CONTRADICTED if reason else verdict, reason=reason)


def turns_quality(check: TurnsCheck | None) -> dict[str, float]:
    """Return the figures of the check, by name."""
    if check is None:
        return {}
    figures = {name: getattr(check, name) for name in ("lag_s", "lag_sigma_s", "scale", "scale_sigma", "shared")}
    return {f"turn_{name}": value for name, value in figures.items() if math.isfinite(value)}


def turns_warnings(check: TurnsCheck | None) -> tuple[str, ...]:
    """Return the warning of the check."""
    return (f"the turns are inconsistent: {check.reason}",) if check is not None and check.reason else ()


def _lag(
    data: CalibrationInput, rows: GeometryRows, joint: JointFit, is_used: BoolArray, config: CalibrationConfig
) -> TurnLag | None:
    """Return the lag of the powers behind the sensor; None where they are too few."""
    turns = data.request.turns
    epochs_us, power_dbm = joined_rows(data, is_around=True)
    reach_us = int(LONGEST_LAG_S) * US_PER_S
    near = (epochs_us >= turns.start_us - reach_us) & (epochs_us < turns.stop_us + reach_us)
    epochs_us = epochs_us[near]
    power_dbm = undisturbed(power_dbm[near], epochs_us, data.plan, data.operations)
    motion = orbit_motion(data, epochs_us, rows.positions)
    level_dbm = predict_level_dbm(joint.fit, rows.positions.geometry, motion, phase_rad(data.ephemeris, epochs_us))
    references = data.quiet_references + data.references
    periods_s = [np.median(np.diff(one.epochs_us)) / US_PER_S for one in references if len(one.epochs_us) > 1]
    reach_s = max([config.reference_reach_s, *(_REACH_PERIODS * float(period_s) for period_s in periods_s)])
    wide = replace(config, reference_reach_s=reach_s)

    grid_us: IntArray = np.arange(turns.start_us - 2 * reach_us, turns.stop_us + 2 * reach_us, _GRID_S * US_PER_S)
    angles = angles_at(grid_us, references, data.sensors, wide)
    is_inside = inside(grid_us, data.request.quiet) | inside(grid_us, turns)
    # nothing turned before and after the windows, else a lag could explain powers by what nobody saw
    angles = np.where(is_inside[:, np.newaxis], angles, 0.0)
    grid_s = (grid_us - turns.start_us) / US_PER_S

    def attitude_at(epoch_s: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(epoch_s, grid_s, angle_deg) for angle_deg in angles.T])

    powers = TurnPowers(
        (epochs_us - turns.start_us) / US_PER_S,
        np.where(is_used, power_dbm - level_dbm, np.nan),
        rows.positions.geometry.band,
        coloured_noise(joint.noise),
    )
    return turn_lag(powers, (0.0, (turns.stop_us - turns.start_us) / US_PER_S), attitude_at)


def _about_lag(data: CalibrationInput, rows: GeometryRows, joint: JointFit, is_used: BoolArray, lag: TurnLag) -> str:
    """Return what a lag costs where it is more than bearable; empty = it is not."""
    lag_s, sigma_s = lag.best
    size_s = abs(lag_s)
    if not size_s > _SIGMAS * sigma_s or lag.gain < 0.5 * _SIGMAS**2:
        return ""
    ahead = "ahead of" if lag_s < 0.0 else "behind"
    text = f"the powers are {_duration(size_s)} {ahead} the {_sensors(data)} (one sigma {sigma_s:.0f} s)"
    if size_s > max(_BEARABLE_S, _SIGMAS * sigma_s):
        return f"{text}: correct the clock or the time zone of one of them, or name its epochs as it means them"
    error_deg = _lag_error_deg(rows, size_s)
    sigma_db = np.hypot(joint.noise.white_db, joint.noise.slow_db)
    sigma_deg = np.asarray(crlb_deg(joint.response.slope[is_used], sigma_db[is_used], with_common=True))
    worst = int(np.argmax(error_deg / sigma_deg))
    if not error_deg[worst] > _BEARABLE_SHARE * sigma_deg[worst]:
        return ""
    name = ("yaw", "roll", "pitch")[worst]
    return f"{text}, which makes {name} wrong by {error_deg[worst]:.3f} deg (one sigma {sigma_deg[worst]:.3f} deg)"


def _lag_error_deg(rows: GeometryRows, lag_s: float) -> FloatArray:
    """Return the error (3,) of an angle of usual size of the turns, deg: a lag makes slopes too small.

    A slope by angles of another time is that of the true ones times their autocorrelation.
    """
    turned = np.flatnonzero(~rows.is_quiet)
    time_s, angles = rows.rows.epoch_s[turned], np.nan_to_num(rows.angles.attitude_deg[turned])
    then = np.column_stack([np.interp(time_s - lag_s, time_s, angles[:, axis]) for axis in range(3)])
    size = np.sqrt(np.square(angles).mean(axis=0))
    return np.asarray(0.5 * np.square(angles - then).mean(axis=0) / np.maximum(size, 1e-9))


def _about_scale(scale: BeamScale, reach_deg: float) -> str:
    """Return which unit makes the beams impossible; empty = they are possible."""
    logarithm = math.log(scale.scale) if scale.scale > 0.0 else 0.0
    is_other_unit = abs(logarithm) > max(_NEARER_UNIT, _SIGMAS * scale.log_sigma)
    if not is_other_unit and not scale.flat_sigmas > _SIGMAS:
        return ""
    unit = min(_UNITS, key=lambda name: abs(math.log(_UNITS[name]) - logarithm)) if is_other_unit else "mrad"
    figures = f"beams differ between their stations as for angles {scale.scale:.2g} times smaller"
    if scale.flat_sigmas > _SIGMAS:
        figures = (
            f"beams would fall by {scale.curvature:.2g} dB/deg^2, less than an antenna as wide as the Earth, "
            f"{EARTH_WIDTH_DEG} deg, by {scale.flat_sigmas:.0f} sigma"
        )
    return f"turns of {reach_deg:.1f} deg: are the references in {unit}? {figures}"


def _about_sensor(data: CalibrationInput, check: TurnsCheck, config: CalibrationConfig) -> str:
    """Return what speaks for another sensor than the one named; empty = nothing, or weather."""
    if not check.scatter > config.max_turn_scatter or not check.shared > _SIGMAS:
        return ""
    return (
        f"the powers turn otherwise than the {_sensors(data)} says: it leaves {check.scatter:.1f} times the noise, and "
        f"the carriers share it by {check.shared:.0f} sigma, which rain does not do; is it another sensor, another "
        "spacecraft, or an axis that stands still?"
    )


def _sensors(data: CalibrationInput) -> str:
    return ", ".join(sorted({name.replace("_", " ") for name in data.sensors}))


def _duration(size_s: float) -> str:
    """Return a time for people, as 14 min 50 s."""
    hours, rest = divmod(round(size_s), 3600)
    minutes, seconds = divmod(rest, 60)
    parts = ((hours, "h"), (minutes, "min"), (seconds, "s"))
    return " ".join(f"{count} {unit}" for count, unit in parts if count) or "0 s"
