"""Fit of a calibration by geometry, its quality and its warnings."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.geometry_calibration import GeometryCalibration, fit_geometry, response_of
from service.core.estimation.calibration.geometry_columns import BEAM_SIZE, QuadraticResponse, predict_deviation
from service.core.estimation.noise import quantisation_step_db
from service.core.estimation.noise_identification import IdentifiedNoise, LevelDrift, level_drift
from service.pipeline.calibration.geometry_rows import (
    DISTURBING,
    CalibrationInput,
    GeometryRows,
    median_present,
    unturned_sides,
)
from service.pipeline.carrier_model.level_control import (
    MIN_GROUP,
    alc_groups,
    first_model_dbm,
    small_groups,
    without_group_means,
)
from service.pipeline.config import CalibrationConfig
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import BoolArray, FloatArray, IntArray

#: rows of stretches below this weight say nothing about levels
_GOOD_WEIGHT = 0.25
#: rows of a mean of what is left of the turns, and the square, in those of the noise, beyond which none counts
_SCATTER_ROWS, _GREATEST_SCATTER = 10, 25.0
#: sigma of the beams grows with this power of the scatter: more than its root, because rain outlasts the means and the
#: fit takes a part of it for turns. Normalised errors of slopes over 20 draws: 1.42 by the root, 1.04 by this one where
#: turns were flown in a storm; 0.98 in `nominal` (tests/regression/test_geometry_calibration_figures.py)
_SCATTER_POWER = 0.75


class TurnScatter(NamedTuple):
    """Squares of what the fit leaves of the turns over those of the noise, in S stretches of ten rows."""

    #: (S, N), NaN = not seen
    stretches: FloatArray
    #: (S, 2) first and last epoch, microseconds UTC
    epochs_us: IntArray
    #: (N,) mean of the stretches, NaN = not seen
    mean: FloatArray


@dataclass(frozen=True)
class JointFit:
    """Result of the joint fit."""

    fit: GeometryCalibration
    response: QuadraticResponse
    noise: IdentifiedNoise
    drift: LevelDrift
    #: (N,) number of each carrier's group under level control, -1 = none
    group: IntArray
    #: (N,) dB
    quantisation_db: FloatArray
    turn_scatter: TurnScatter


def fit_rows(data: CalibrationInput, rows: GeometryRows, config: CalibrationConfig) -> JointFit:
    """Return the fit of the rows, groups under level control by their differences."""
    group = alc_groups(data.plan)
    geometry = rows.positions.geometry
    is_asked = np.array([carrier.enabled and carrier.uplink_power_control != "auto" for carrier in data.plan.carriers])
    is_asked &= ~(np.isnan(geometry.azimuth_deg) & ~rows.positions.is_beacon) & ~small_groups(group)
    # what is not to be used must not bend the downlink that all share either
    power_dbm = np.where(is_asked, rows.rows.power_dbm, np.nan)
    if (group < 0).all():
        fit = fit_geometry(rows.rows._replace(power_dbm=power_dbm), geometry)
    else:
        taken_dbm = without_group_means(power_dbm, first_model_dbm(power_dbm), group)
        first = fit_geometry(rows.rows._replace(power_dbm=taken_dbm), geometry)
        taken_dbm = without_group_means(power_dbm, taken_dbm - first.residual_db, group)
        fit = fit_geometry(rows.rows._replace(power_dbm=taken_dbm), geometry)
    quiet = np.flatnonzero(rows.is_quiet)
    residual_db = np.where(fit.weight > _GOOD_WEIGHT, fit.residual_db, np.nan)[quiet]
    scatter = _turn_scatter(fit, rows)
    fit = _with_scatter(fit, scatter.mean)
    # means of several measurements stand on no grid
    first_dbm = data.quiet_first_dbm if data.row_measurements > 1.0 else None
    readings_dbm = rows.rows.power_dbm[quiet] if first_dbm is None else first_dbm
    return JointFit(
        fit,
        response_of(fit, geometry),
        fit.noise,
        level_drift(residual_db, rows.rows.epoch_s[quiet], fit.noise, config.reference_walk_db_sqrt_h),
        group,
        np.array([quantisation_step_db(column) for column in readings_dbm.T]),
        scatter,
    )


def _turn_scatter(fit: GeometryCalibration, rows: GeometryRows) -> TurnScatter:
    """Return by how much the squares of what is left of the turns exceed the noise; rain makes it many times."""
    turns = np.flatnonzero(~rows.is_quiet)
    turns = turns[: len(turns) // _SCATTER_ROWS * _SCATTER_ROWS]
    left_db = fit.residual_db[turns].reshape(-1, _SCATTER_ROWS, fit.residual_db.shape[1])
    count = np.isfinite(left_db).sum(axis=1)
    mean_db = np.nansum(left_db, axis=1) / np.maximum(count, 1)
    expected_db2 = fit.noise.white_db**2 / np.maximum(count, 1) + fit.noise.slow_db**2
    ratio = np.where(count > 0, np.minimum(mean_db**2 / expected_db2, _GREATEST_SCATTER), np.nan)
    seen = np.isfinite(ratio).sum(axis=0)
    mean = np.where(seen > 0, np.nansum(ratio, axis=0) / np.maximum(seen, 1), np.nan)
    return TurnScatter(ratio, rows.epochs_us[turns].reshape(-1, _SCATTER_ROWS)[:, [0, -1]], mean)


def _with_scatter(fit: GeometryCalibration, scatter: FloatArray) -> GeometryCalibration:
    """Return the fit with the covariance of the beams as large as the scatter of the turns makes it."""
    scale = np.ones(fit.covariance.shape[:2])
    scale[:, -BEAM_SIZE:] = np.fmax(scatter, 1.0)[:, np.newaxis] ** _SCATTER_POWER
    return replace(fit, covariance=fit.covariance * scale[:, :, np.newaxis] * scale[:, np.newaxis, :])


_AXIS_NAMES = ("yaw", "roll", "pitch")
#: rows that a stretch of the fit averages
_STRETCH_ROWS = 10.0


def slope_shrink(rows: GeometryRows) -> FloatArray:
    """Return by what share (3,) the noise of the sensors makes slopes come out too small; NaN without readings.

    It is the noise's share in the variance of the angles that the fit saw. Noise that was left as it is is averaged by
    a stretch; noise that was smoothed is not, and edges of turns that it hides cost as much again (0.06 deg of noise:
    1 to 2 %, 0.1 deg: 5 to 7 %, on turns of 15 min).
    """
    angles = rows.angles
    is_smoothed = angles.remaining_sigma_deg < angles.sensor_sigma_deg
    left = np.where(is_smoothed, 2.0 * angles.remaining_sigma_deg**2, angles.sensor_sigma_deg**2 / _STRETCH_ROWS)
    known = angles.attitude_deg[np.isfinite(angles.attitude_deg).all(axis=1)]
    variance = known.var(axis=0) if len(known) else np.full(3, np.nan)
    return np.asarray(left / np.maximum(variance, 1e-12))


def quality_metrics(rows: GeometryRows, joint: JointFit, is_used: BoolArray) -> dict[str, float]:
    """Return the figures of the joint fit."""
    fit = joint.fit
    known = np.isfinite(rows.angles.attitude_deg).all(axis=1)
    turns = rows.angles.attitude_deg[known & ~rows.is_quiet]
    sight = rows.rows.motion.sight_deg if rows.rows.motion is not None else np.full((1, 1, 2), np.nan)
    sigma = np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2))
    slope_sigma = np.sqrt(np.diagonal(joint.response.covariance, axis1=1, axis2=2))[:, :3]
    figures = {
        "carriers_used": float(np.count_nonzero(is_used)),
        "tracked_share": float(rows.is_tracked.mean()),
        "motion_rms_deg": _rms(sight[np.isfinite(sight)]),
        "joint_residual_rms_db": median_present(fit.residual_rms_db[is_used]),
        "level_sigma_db": median_present(sigma[is_used, 0]),
        "white_noise_db": median_present(joint.noise.white_db[is_used]),
        "slow_noise_db": median_present(joint.noise.slow_db[is_used]),
        "common_noise_db": float(np.sqrt(np.square(joint.noise.common_db).sum())),
        "reference_walk_db_sqrt_h": median_present(joint.drift.walk_db[is_used]),
        "quantisation_db": median_present(joint.quantisation_db[is_used]),
        "turn_scatter": median_present(joint.turn_scatter.mean[is_used]),
    }
    shrink = slope_shrink(rows)
    for axis, name in enumerate(_AXIS_NAMES):
        figures[f"{name}_turn_reach_deg"] = float(np.abs(turns[:, axis]).max(initial=0.0))
        figures[f"{name}_slope_sigma_db_per_deg"] = median_present(slope_sigma[is_used, axis])
        figures[f"{name}_sensor_sigma_deg"] = float(rows.angles.sensor_sigma_deg[axis])
        figures[f"{name}_slope_shrink"] = float(shrink[axis])
    return figures


def _rms(values: FloatArray) -> float:
    """Return the root mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")


_DAY_S = 86_400.0
#: nodal periods that tell a wave of half a period from those beside it
_LEAST_PERIODS = 2.5
#: kinds of operation after which the track of before does not hold
_MANOEUVRES = ("station_keeping", "momentum_unloading")
#: stretches of the turns this near are one span, us; spans that are named
_SPAN_GAP_US, _SPANS = 3600 * US_PER_S, 3


def calibration_warnings(
    data: CalibrationInput, rows: GeometryRows, joint: JointFit, is_used: BoolArray, config: CalibrationConfig
) -> tuple[str, ...]:
    """Return the warnings, those about the windows first."""
    return (
        *_about_windows(data, rows, config),
        *_about_turns(data, joint, is_used, config),
        *_about_track(data, rows, joint, is_used, config),
        *_about_sensors(rows, config),
        *_about_carriers(data, rows, joint, is_used, config),
    )


def _about_windows(data: CalibrationInput, rows: GeometryRows, config: CalibrationConfig) -> Iterator[str]:
    """Yield warnings on the windows and on operations declared inside them."""
    quiet = rows.rows.epoch_s[rows.is_quiet]
    span_s = float(quiet[-1] - quiet[0])
    if span_s < config.short_quiet_days * _DAY_S:
        yield (
            f"quiet window of {span_s / 3600:.1f} h is shorter than {config.short_quiet_days * 24:.0f} h: slow noise "
            "is hardly seen, and level, dish and solar day are not well separated"
        )
    angles = rows.angles.attitude_deg[~rows.is_quiet]
    missing = unturned_sides(angles[np.isfinite(angles).all(axis=1)], config)
    for name in _AXIS_NAMES:
        sides = [side for side in missing if side.endswith(name)]
        if sides:
            rest = (
                "its effect follows from the station positions alone"
                if name == "yaw"
                else "its slopes rest on one side"
            )
            if name != "yaw" and len(sides) > 1:
                rest = "its slopes rest on the small motion of the quiet days and are poorly known"
            yield (
                f"no turn of at least {config.min_turn_deg} deg towards {', '.join(sides)}: {rest}, and a side "
                "that was never turned leaves the paper method without its coefficients"
            )
    for operation in data.operations:
        if operation.kind in DISTURBING:
            what = f"operation {operation.id} ({operation.kind}, {format_epoch(operation.start_us)})"
            after = ", and the track may not hold after it" if operation.kind in _MANOEUVRES else ""
            yield f"{what} lies inside the windows: the rows that it disturbs are left out{after}"


def _about_turns(
    data: CalibrationInput, joint: JointFit, is_used: BoolArray, config: CalibrationConfig
) -> Iterator[str]:
    """Yield the demand to fly the turns again where rain fell on many stations during them."""
    scatter = np.where(is_used, joint.turn_scatter.mean, np.nan)
    if not np.isfinite(scatter).any() or np.nanmedian(scatter) <= config.max_turn_scatter:
        return
    turns = data.request.turns
    spans = _wet_spans(joint.turn_scatter, is_used, config.max_turn_scatter) or [(turns.start_us, turns.stop_us)]
    when = ", ".join(f"{format_epoch(start_us)} to {format_epoch(stop_us)}" for start_us, stop_us in spans)
    wet = [name for name, ratio in zip(data.plan.carrier_ids, scatter, strict=True) if ratio > config.max_turn_scatter]
    yield (
        f"fly the turns of {when} again when it is dry: what the beams leave of all turns is "
        f"{np.nanmedian(scatter):.1f} times the noise, most on {', '.join(wet)}"
    )


def _wet_spans(scatter: TurnScatter, is_used: BoolArray, limit: float) -> list[tuple[int, int]]:
    """Return the spans of the turns in which the carriers used scatter beyond a limit, the longest first."""
    # a carrier that is off says nothing of a stretch
    ratio = np.where(is_used & np.isfinite(scatter.stretches), scatter.stretches, 0.0)
    seen = (is_used & np.isfinite(scatter.stretches)).sum(axis=1)
    spans: list[tuple[int, int]] = []
    for start_us, stop_us in scatter.epochs_us[ratio.sum(axis=1) > limit * seen].tolist():
        if spans and start_us - spans[-1][1] <= _SPAN_GAP_US:
            spans[-1] = spans[-1][0], stop_us
        else:
            spans.append((start_us, stop_us))
    return sorted(spans, key=lambda span: span[0] - span[1])[:_SPANS]


def _about_track(
    data: CalibrationInput, rows: GeometryRows, joint: JointFit, is_used: BoolArray, config: CalibrationConfig
) -> Iterator[str]:
    """Yield warnings on a missing track, or on a daily change that contradicts it."""
    if not joint.fit.is_dish_law:
        yield (
            "no track of the satellite over the windows: two harmonics stand for the dishes; they age with the orbit's "
            "plane, to about 0.035, 0.04 and 0.055 dB on day 1, 3 and 7, where the dish law keeps to 0.025 dB"
        )
    elif rows.is_tracked.mean() < config.min_tracked_share:
        yield f"the track covers only {100 * rows.is_tracked.mean():.0f} % of the rows; the others take no part"
    excess = _daily_excess(rows, joint, is_used, data.ephemeris.nodal_period_s)
    if joint.fit.is_dish_law and excess > config.max_daily_excess:
        yield (
            f"the daily change contradicts the track: beside the dish law a wave of half a day stands out {excess:.0f} "
            "times above the noise; check that the ephemeris is that of this satellite and of these days"
        )


def _daily_excess(rows: GeometryRows, joint: JointFit, is_used: BoolArray, period_s: float) -> float:
    """Return the power of what the dish law leaves at half the nodal period over that of the neighbouring waves.

    The dish law has its second harmonic by the size of the motion alone; a wrong track gives it the wrong phase. Noise
    is taken from waves of 1.5 and 2.5 a period, which days that are too few (``nan``) do not tell apart.
    """
    quiet = np.flatnonzero(rows.is_quiet)
    time_s = rows.rows.epoch_s[quiet]
    if np.ptp(time_s) < _LEAST_PERIODS * period_s:
        return float("nan")
    left_db = np.where(joint.fit.weight > _GOOD_WEIGHT, joint.fit.residual_db, np.nan)[quiet][:, is_used]
    left_db = np.nan_to_num((left_db - np.nanmean(left_db, axis=0)) / np.nanstd(left_db, axis=0))
    waves = np.exp(2j * np.pi * np.outer([1.5, 2.0, 2.5], time_s / period_s))
    below, at, above = np.square(np.abs(waves @ left_db)).sum(axis=1)
    return float(2.0 * at / (below + above))


def _about_sensors(rows: GeometryRows, config: CalibrationConfig) -> Iterator[str]:
    """Yield warnings on the noise of the sensors."""
    for name, sigma_deg, shrink in zip(_AXIS_NAMES, rows.angles.sensor_sigma_deg, slope_shrink(rows), strict=True):
        # yaw has no slope of its own to shrink
        if name != "yaw" and shrink > config.max_slope_shrink:
            yield (
                f"the {name} sensor has a noise of {sigma_deg:.3f} deg: after averaging, slopes of {name} still come "
                f"out about {100 * shrink:.0f} % too small"
            )


def _about_carriers(
    data: CalibrationInput, rows: GeometryRows, joint: JointFit, is_used: BoolArray, config: CalibrationConfig
) -> Iterator[str]:
    """Yield warnings on single carriers."""
    names, is_lonely = data.plan.carrier_ids, small_groups(joint.group)
    for k, carrier in enumerate(data.plan.carriers):
        if not carrier.enabled:
            continue
        if carrier.uplink_power_control == "auto":
            yield f"{names[k]} has automatic uplink power control and is not used"
        elif carrier.station is not None and np.isnan(rows.positions.geometry.azimuth_deg[k]):
            yield f"check the coordinates of {names[k]}: its station does not see the satellite"
        elif np.isnan(joint.fit.level_dbm[k]) and not is_lonely[k]:
            yield f"{names[k]} was silent or hardly seen in the windows and is not calibrated"
    for number in range(int(joint.group.max(initial=-1)) + 1):
        members = np.flatnonzero(joint.group == number)
        if len(members) < MIN_GROUP:
            yield (
                f"{', '.join(names[k] for k in members)}: a transponder under level control needs {MIN_GROUP} carriers "
                "of the plan; these are not used"
            )
    yield from _about_flat(rows, joint, names, is_used & ~rows.positions.is_beacon, config)
    yield from _about_drift(joint, names, is_used, config)
    yield from _position_warnings(joint, names, is_used & ~rows.positions.is_beacon, config)


def _about_flat(
    rows: GeometryRows, joint: JointFit, names: tuple[str, ...], is_asked: BoolArray, config: CalibrationConfig
) -> Iterator[str]:
    """Yield the carriers that the turns moved less than their noise."""
    turns = rows.angles.attitude_deg[~rows.is_quiet]
    turns = turns[np.isfinite(turns).all(axis=1)]
    answer = predict_deviation(turns, joint.response)
    moved_db = answer.std(axis=0) if len(turns) else np.full(len(names), np.nan)
    noise_db = np.hypot(joint.noise.white_db, joint.noise.slow_db)
    for k in np.flatnonzero(is_asked):
        if moved_db[k] < config.flat_share * noise_db[k]:
            yield (
                f"{names[k]} is flat: the turns moved it by {moved_db[k]:.3f} dB rms, its noise is {noise_db[k]:.3f} dB"
            )


def _about_drift(
    joint: JointFit, names: tuple[str, ...], is_asked: BoolArray, config: CalibrationConfig
) -> Iterator[str]:
    """Yield the carriers whose level drifted over the quiet days."""
    slope = joint.drift.slope_db_per_day
    # a carrier that drifts is also thought to be noisy: the others tell what noise explains
    typical = float(np.median(joint.drift.sigma_db_per_day[is_asked]))
    limit = max(config.drift_db_per_day, config.drift_sigmas * typical)
    for k in np.flatnonzero(is_asked & (np.abs(slope) > limit)):
        yield f"{names[k]} drifts: {slope[k]:+.2f} dB a day over the quiet window, noise explains {typical:.2f}"


def _position_warnings(
    joint: JointFit, names: tuple[str, ...], is_asked: BoolArray, config: CalibrationConfig
) -> Iterator[str]:
    """Yield the carrier whose station the data want elsewhere most."""
    offsets = joint.fit.offsets
    chi_square = np.where(is_asked & (joint.group < 0), offsets.chi_square, 0.0)
    # one wrong place bends the downlink and with it the others: only the worst is named
    worst = int(np.argmax(chi_square))
    if chi_square[worst] > config.place_chi_square:
        east_deg, north_deg = offsets.offset_deg[worst]
        sigma_deg = float(np.sqrt(np.trace(offsets.covariance_deg2[worst]) / 2.0))
        yield (
            f"check the coordinates of {names[worst]}: the turns want its station {east_deg:+.0f} deg East and "
            f"{north_deg:+.0f} deg North of its place in the antenna frame (one sigma about {sigma_deg:.0f} deg)"
        )
