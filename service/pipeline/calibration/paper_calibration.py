"""Calibration by the paper method: quiet days give the harmonics, calibration turns give the sensitivities.

Powers and sensor angles in, a result or a CalibrationError out; nothing is read or kept here. Each carrier is judged
by the three criteria of the publication with its figures; the selected carriers and what they can see are reported.
"""

from dataclasses import dataclass, replace

import numpy as np

from service.core.estimation.calibration.sensor_axes import FreeResponse
from service.core.estimation.noise import NoiseSplit, split_noise
from service.core.estimation.observability import condition_number, crlb_deg
from service.core.estimation.paper.harmonic import HarmonicFits, evaluate_harmonic, fit_harmonics
from service.core.estimation.paper.selection import CarrierVerdicts, judge_carriers
from service.core.estimation.paper.sensitivity import TurnSensitivity, fit_turn_sensitivity, level_knots
from service.pipeline.calibration.geometry_rows import (
    CalibrationError,
    CalibrationInput,
    median_present,
    node_us,
    phase_rad,
    plan_positions,
    turn_rows,
)
from service.pipeline.calibration.sensor_signs import report_signs
from service.pipeline.calibration.turns_check import paper_turns, turns_quality, turns_warnings
from service.pipeline.calibration.window_harmonics import fitted_harmonic
from service.pipeline.config import CalibrationConfig, CriteriaConfig
from service.records.calibration import CalibrationResult, CarrierCalibration, NoiseComponent, Observability
from service.records.epoch import US_PER_S
from service.records.levels.attitude import Axes, BoolArray, FloatArray, named_axes

_AXIS_NAMES = ("yaw", "roll", "pitch")
_DAY_S = 86_400.0
#: error of a slope over the residual of its carrier, per deg, that no turns reach; the scatter of slopes is far above
_LEAST_SLOPE_SIGMA = 0.01


@dataclass(frozen=True)
class _Quiet:
    """Fit of the quiet window."""

    fits: HarmonicFits
    #: (T, N) dB
    residual_db: FloatArray
    #: dB per day
    drift_db_per_day: FloatArray
    noise: tuple[NoiseSplit, ...]
    span_s: float


def calibrate_paper(data: CalibrationInput, config: CalibrationConfig) -> CalibrationResult:
    """Return the calibration of every carrier of the plan.

    Raises
    ------
    CalibrationError
        No rows in a window, no sensor angles in the turns, an axis that was never turned, or powers that contradict the
        axes of the sensors.
    """
    result = paper_part(data, config, is_every_axis_needed=True)
    if data.spacecraft is None:
        return result
    positions = plan_positions(data.plan, data.spacecraft)
    free = _free_response(result)
    is_fixed_gain = np.array([carrier.transponder_mode != "alc" for carrier in data.plan.carriers])
    is_free = is_fixed_gain & np.isfinite(free.slope).all(axis=1) & np.isfinite(positions.geometry.azimuth_deg)
    turns = paper_turns(data, config)
    doubt = "" if turns is None else turns.reason
    report = report_signs(data, config, positions, free, is_free, result.quality["yaw_turn_reach_deg"], doubt=doubt)
    return replace(
        result,
        quality={**result.quality, **turns_quality(turns), **report.quality},
        warnings=turns_warnings(turns) + result.warnings + report.warnings,
        signs=report.signs,
        turns=turns,
    )


def _free_response(result: CalibrationResult) -> FreeResponse:
    """Return the slopes of the turns; the scale of their errors is left to the scatter of the slopes."""
    slope = np.array([carrier.sensitivity_db_per_deg for carrier in result.carriers])
    scale_db = np.array([carrier.residual_db for carrier in result.carriers])
    covariance = (_LEAST_SLOPE_SIGMA * scale_db[:, np.newaxis, np.newaxis]) ** 2 * np.eye(3)
    return FreeResponse(slope, np.zeros((len(slope), 3, 3)), covariance)


def paper_part(data: CalibrationInput, config: CalibrationConfig, *, is_every_axis_needed: bool) -> CalibrationResult:
    """Return the calibration of the paper method; where an axis may be missing its sensitivities are NaN.

    Raises
    ------
    CalibrationError
        As :func:`calibrate_paper`.
    """
    quiet = _fit_quiet(data, config)
    rows = turn_rows(data, quiet.fits, config, is_every_axis_needed=is_every_axis_needed)
    sensitivity = fit_turn_sensitivity(
        rows.angles_deg,
        rows.deviation_db,
        gate_sigma=config.harmonic.gate_sigma,
        baseline=level_knots(rows.time_s, config.level_knot_s),
    )
    criteria = config.criteria
    verdicts = judge_carriers(
        quiet.fits.rms_db,
        rows.angles_deg,
        rows.deviation_db,
        sensitivity.plus,
        sensitivity.minus,
        max_residual_rms_db=criteria.max_residual_rms_db,
        max_nonlinearity_deg=criteria.max_nonlinearity_deg,
        linear_range_deg=criteria.linear_range_deg,
        dominance_ratio=criteria.dominance_ratio,
        yaw_scale=criteria.yaw_scale,
    )
    is_usable = np.array([carrier.is_usable_for_attitude for carrier in data.plan.carriers])
    is_selected = select_carriers(verdicts, is_usable, criteria)
    carriers = tuple(
        _carrier(k, data, quiet, sensitivity, verdicts, is_usable=bool(is_usable[k]), is_selected=bool(is_selected[k]))
        for k in range(len(data.plan.carriers))
    )
    return CalibrationResult(
        carriers,
        observe(sensitivity.symmetric[is_selected], quiet.fits.rms_db[is_selected]),
        _quality(quiet, rows.angles_deg, sensitivity, is_selected),
        _warnings(data, quiet, is_selected, config),
    )


def select_carriers(verdicts: CarrierVerdicts, is_usable: BoolArray, config: CriteriaConfig) -> BoolArray:
    """Return which carriers enter the fix: all that meet the three criteria, and stable linear ones of mixed axis.

    The publication asks for a dominant axis; its own system has no more than a few such carriers an axis, so mixed
    carriers fill up to ``min_selected``, the most dominant first.
    """
    is_sound = verdicts.stable & verdicts.linear & is_usable & np.isfinite(verdicts.axis_ratio)
    is_selected = is_sound & verdicts.dominant
    mixed = np.flatnonzero(is_sound & ~verdicts.dominant)
    wanted = max(0, config.min_selected - int(np.count_nonzero(is_selected)))
    best_first = mixed[np.argsort(-verdicts.axis_ratio[mixed], kind="stable")]
    is_selected[best_first[:wanted]] = True
    return is_selected


def observe(sensitivity_db_per_deg: FloatArray, sigma_db: FloatArray) -> Observability:
    """Return condition, dilution of precision and the one-row bound with a common-mode unknown."""
    if len(sensitivity_db_per_deg) < 4:
        unseen = Axes(float("nan"), float("nan"), float("nan"))
        return Observability(float("nan"), unseen, unseen)
    return Observability(
        float(condition_number(sensitivity_db_per_deg)),
        named_axes(crlb_deg(sensitivity_db_per_deg, np.ones_like(sigma_db), with_common=False)),
        named_axes(crlb_deg(sensitivity_db_per_deg, sigma_db, with_common=True)),
    )


def _fit_quiet(data: CalibrationInput, config: CalibrationConfig) -> _Quiet:
    """Fit the harmonic of every carrier over the quiet window and look at what it leaves."""
    epochs_us = data.quiet.epochs_us
    if len(epochs_us) < 3:
        message = f"the quiet window holds {len(epochs_us)} measurements; choose a window of the archive that has more"
        raise CalibrationError(message)
    phase = phase_rad(data.ephemeris, epochs_us)
    fits = fit_harmonics(
        phase,
        data.quiet.power_dbm,
        max_iterations=config.harmonic.max_iterations,
        gate_sigma=config.harmonic.gate_sigma,
    )
    residual = data.quiet.power_dbm - fits.offset_dbm - evaluate_harmonic(phase, fits.amplitude_db, fits.phase_rad)
    time_s = (epochs_us - epochs_us[0]) / US_PER_S
    row_period_s = float(np.median(np.diff(time_s)))
    clipped = np.where(np.abs(residual) <= config.harmonic.gate_sigma * fits.rms_db, residual, np.nan)
    return _Quiet(
        fits,
        clipped,
        np.array([_slope(time_s / _DAY_S, clipped[:, k]) for k in range(clipped.shape[1])]),
        tuple(split_noise(clipped[:, k], row_period_s) for k in range(clipped.shape[1])),
        float(time_s[-1]),
    )


def _slope(x: FloatArray, y: FloatArray) -> float:
    """Return the least-squares slope of the samples present, NaN when there are fewer than three."""
    present = np.isfinite(y)
    if np.count_nonzero(present) < 3:
        return float("nan")
    centred = x[present] - x[present].mean()
    return float(centred @ y[present] / (centred @ centred))


def _carrier(
    k: int,
    data: CalibrationInput,
    quiet: _Quiet,
    sensitivity: TurnSensitivity,
    verdicts: CarrierVerdicts,
    *,
    is_usable: bool,
    is_selected: bool,
) -> CarrierCalibration:
    noise = quiet.noise[k]
    start_us = node_us(data.ephemeris, int(data.quiet.epochs_us[-1]))
    harmonic = fitted_harmonic(quiet.fits, k, data.ephemeris.nodal_period_s, start_us)
    criteria = {"stable": verdicts.stable[k], "linear": verdicts.linear[k], "dominant": verdicts.dominant[k]}
    refused = () if is_usable else ("not usable for attitude: disabled, a beacon, or under uplink power control",)
    axis = int(verdicts.axis[k])
    coloured = NoiseComponent(noise.correlation_time_s, noise.sigma_coloured_db)
    return CarrierCalibration(
        id=data.plan.carriers[k].id,
        level_dbm=harmonic.offset_dbm,
        sigma_white_db=noise.sigma_white_db * data.white_scale,
        noise=(coloured,) if noise.sigma_coloured_db > 0.0 else (),
        harmonic=harmonic,
        sensitivity_db_per_deg=named_axes(sensitivity.symmetric[k]),
        sensitivity_plus_db_per_deg=named_axes(sensitivity.plus[k]),
        sensitivity_minus_db_per_deg=named_axes(sensitivity.minus[k]),
        residual_db=float(sensitivity.residual_db[k]),
        stability_residual_rms_db=harmonic.rms_db,
        drift_db_per_day=float(quiet.drift_db_per_day[k]),
        deviation_at_0p5_deg_db=float(verdicts.deviation_at_0p5_deg_db[k]),
        nonlinearity_deg=float(verdicts.nonlinearity_deg[k]),
        linear_range_deg=float(verdicts.range_deg[k]),
        axis="mixed" if axis < 0 else _AXIS_NAMES[axis],
        axis_ratio=float(verdicts.axis_ratio[k]),
        criteria_met=tuple(name for name, met in criteria.items() if met),
        rejected_because=() if is_selected else refused + _reasons(k, verdicts),
        selected=is_selected,
    )


def _reasons(k: int, verdicts: CarrierVerdicts) -> tuple[str, ...]:
    """Return why the criteria leave a carrier out, each with its figure."""
    texts = (
        (verdicts.stable[k], f"not stable: residual rms {verdicts.residual_rms_db[k]:.3f} dB after the harmonic"),
        (verdicts.linear[k], f"not linear: departs {verdicts.nonlinearity_deg[k]:.3f} deg from a straight line"),
        (verdicts.dominant[k], f"no dominant axis: ratio {verdicts.axis_ratio[k]:.2f}"),
    )
    return tuple(text for met, text in texts if not met)


def _quality(
    quiet: _Quiet, angles_deg: FloatArray, sensitivity: TurnSensitivity, is_selected: BoolArray
) -> dict[str, float]:
    return {
        "quiet_span_s": quiet.span_s,
        "quiet_rows": float(len(quiet.residual_db)),
        "turn_rows": float(len(angles_deg)),
        "turn_reach_deg": float(np.abs(angles_deg).max()),
        "yaw_turn_reach_deg": float(np.abs(angles_deg[:, 0]).max()),
        "median_residual_rms_db": median_present(quiet.fits.rms_db),
        "median_turn_residual_db": median_present(sensitivity.residual_db),
        "carriers_selected": float(np.count_nonzero(is_selected)),
    }


def _warnings(
    data: CalibrationInput, quiet: _Quiet, is_selected: BoolArray, config: CalibrationConfig
) -> tuple[str, ...]:
    warnings = []
    needed_s = config.short_quiet_periods * data.ephemeris.nodal_period_s
    if quiet.span_s < needed_s:
        warnings.append(
            f"quiet window of {quiet.span_s / 3600:.1f} h is shorter than {needed_s / 3600:.1f} h: "
            "level and harmonic are not well separated"
        )
    if np.count_nonzero(is_selected) < config.criteria.min_selected:
        warnings.append(
            f"only {np.count_nonzero(is_selected)} carriers are stable and linear; "
            f"{config.criteria.min_selected} are advised"
        )
    silent = [c.id for c, used in zip(data.plan.carriers, quiet.fits.samples_used, strict=True) if used == 0]
    if silent:
        warnings.append(f"no fit for {', '.join(silent)}: absent in the quiet window")
    return tuple(warnings)
