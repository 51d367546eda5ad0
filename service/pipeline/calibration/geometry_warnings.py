"""Warnings of a calibration by geometry, for the operator who activates it.

Each text names the carrier, the axis or the operation that it is about and its figure. The law of this file: a healthy
calibration has no warning; limits stand in ``CalibrationConfig``.
"""

from collections.abc import Iterator

import numpy as np

from service.core.estimation.calibration.quadratic_response import predict_deviation
from service.pipeline.calibration.geometry_fit import JointFit, TurnScatter
from service.pipeline.calibration.geometry_quality import slope_shrink
from service.pipeline.calibration.geometry_rows import DISTURBING, GeometryRows
from service.pipeline.calibration.windows import CalibrationInput, unturned_sides
from service.pipeline.carrier_model.level_control import MIN_GROUP, small_groups
from service.pipeline.config import CalibrationConfig
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import BoolArray

_AXIS_NAMES = ("yaw", "roll", "pitch")
_DAY_S = 86_400.0
#: rows of stretches below this weight say nothing of the daily change
_GOOD_WEIGHT = 0.25
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
    noise_db = np.hypot(joint.noise.white_db, np.sqrt(np.square(joint.noise.sigma_db).sum(axis=1)))
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
    if joint.fit.offsets is None:
        return
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
