"""Configuration of the stages: frozen, built once by the composition root, every number a setting.

The defaults are those of the published method where it states one, else tuned on the simulator's truth; the
reference of settings says which.
"""

from dataclasses import dataclass

from service.records.setting import CHOSEN, PUBLISHED, TUNED, setting


@dataclass(frozen=True, slots=True)
class HarmonicConfig:
    """Least-squares fit of the daily harmonic."""

    gate_sigma: float = setting(3.0, "a sample is used while its residual is within this many sigma", PUBLISHED)
    max_iterations: int = setting(50, "passes of that rejection before the fit gives up", CHOSEN)


@dataclass(frozen=True, slots=True)
class CriteriaConfig:
    """The three criteria by which carriers are judged."""

    max_residual_rms_db: float = setting(0.25, "stable: rms after the harmonic at most this, dB", TUNED)
    max_nonlinearity_deg: float = setting(0.1, "linear: departure from a straight line at most this, deg", TUNED)
    linear_range_deg: float = setting(0.5, "linear: angles within which the line is judged, deg", PUBLISHED)
    dominance_ratio: float = setting(2.0, "dominant: greatest coefficient this many times the others", TUNED)
    yaw_scale: float = setting(8.0, "yaw coefficients are multiplied by this before the comparison", TUNED)
    min_selected: int = setting(16, "carriers selected at least; mixed ones fill up", TUNED)


@dataclass(frozen=True, slots=True)
class CalibrationConfig:
    """Calibration from quiet days and turns."""

    harmonic: HarmonicConfig = HarmonicConfig()
    criteria: CriteriaConfig = CriteriaConfig()
    reference_reach_s: float = setting(120.0, "a row of the turns needs a sensor reading this close, s", TUNED)
    short_quiet_periods: float = setting(2.0, "quiet windows shorter than this many nodal periods are warned of", TUNED)
    min_turn_rows: int = setting(60, "fewest rows with powers and angles in the turns", TUNED)
    min_quiet_rows: int = setting(200, "geometry: fewest rows with angles in the quiet window", TUNED)
    short_quiet_days: float = setting(2.9, "geometry: quiet windows shorter than this are warned of, days", TUNED)
    min_tracked_share: float = setting(
        0.95, "geometry: share of the rows that the track must reach, else warned", TUNED
    )
    max_daily_excess: float = setting(
        5.0, "geometry: a wave of half a day that the dish law leaves, over its neighbours, else warned", TUNED
    )
    max_slope_shrink: float = setting(
        0.02, "geometry: sensor noise may shrink slopes by this share, else warned", TUNED
    )
    flat_share: float = setting(
        0.5, "geometry: a carrier that turns move by less than this share of its noise is flat", TUNED
    )
    max_turn_scatter: float = setting(
        2.0, "geometry: squares left of the turns over those of the noise, else they are to be flown again", TUNED
    )
    drift_db_per_day: float = setting(0.15, "geometry: a level that drifts faster is warned of, dB/day", TUNED)
    drift_sigmas: float = setting(4.0, "geometry: and by more than this many of its sigmas", TUNED)
    place_chi_square: float = setting(16.0, "geometry: a station's place is doubted above this chi-square", TUNED)
    reference_walk_db_sqrt_h: float = setting(
        0.003, "geometry: least walk of a level, dB per square root of hour", TUNED
    )
    level_knot_s: float = setting(
        36_000.0, "knots of a carrier's level over the turns are this far apart at least, s", TUNED
    )
    min_turn_deg: float = setting(0.1, "an axis counts as turned where its angle passed this, deg", TUNED)
    min_yaw_proof_deg: float = setting(0.3, "turns of yaw below this do not prove its sign, deg", TUNED)
    max_scale_error: float = setting(0.1, "scale by which one axis of a sensor may differ, else warned", TUNED)
    momentum_bias_share: float = setting(
        0.1, "share by which the wheels' momentum along pitch may differ from the stated one, else refused", CHOSEN
    )


@dataclass(frozen=True, slots=True)
class AlignmentConfig:
    """Alignment to an outside sensor."""

    manual_window_s: float = setting(900.0, "window of powers before a manual alignment, s", TUNED)
    min_rows: int = setting(8, "fewest rows of a carrier for a reference power", TUNED)
    min_probability: float = setting(1e-4, "powers contradict the stated angles below this probability", TUNED)
    level_walk_db_sqrt_h: float = setting(
        0.006, "wander of a level since calibration, dB per square root of hour", TUNED
    )
    changed_level_sigma: float = setting(4.0, "a level changed by more sigma is left out of that test", TUNED)
    wet_level_sigma: float = setting(2.0, "a level lower by more sigma is wet: that of the calibration serves", TUNED)
    wet_level_h: float = setting(72.0, "age of the quiet days up to which a lower level is taken for wet, h", TUNED)


@dataclass(frozen=True, slots=True)
class EstimationConfig:
    """The paper method in operation."""

    averaging_window_s: float = setting(900.0, "trailing mean of the deviations, s", TUNED)
    min_rows: int = setting(8, "fewest rows of a carrier in that mean", TUNED)
    uplink_gate_db: float = setting(1.5, "uplink rain: a carrier this far below the others is left out, dB", TUNED)
    gate_sigma: float = setting(3.0, "a carrier is used while its residual is within this many sigma", PUBLISHED)
    min_carriers: int = setting(4, "fewest carriers of a fix", TUNED)
    max_gap_s: float = setting(1800.0, "a row later than this after its predecessor starts the means again, s", TUNED)


@dataclass(frozen=True, slots=True)
class FadeConfig:
    """Downlink rain by the rule of one sign and near size."""

    depth_db: float = setting(0.3, "downlink rain: carriers lie below minus this, dB", TUNED)
    share: float = setting(0.9, "share of the carriers that must", TUNED)
    spread_ratio: float = setting(0.5, "their spread (1.48 MAD) stays below this share of the median", TUNED)
    entry_s: float = setting(180.0, "control stops after a change of that depth has held this long, s", TUNED)
    exit_s: float = setting(
        600.0, "control returns after levels are back within depth, or a turn explains them, this long, s", TUNED
    )
    max_gap_s: float = setting(300.0, "a longer pause between rows starts the count of wet time again, s", TUNED)
    averaging_window_s: float = setting(180.0, "mean of the deviations that the rule looks at, s", TUNED)


@dataclass(frozen=True, slots=True)
class RobustConfig:
    """The robust method in operation."""

    yaw_drift_deg_h: float = setting(0.04, "drift of the inertial model about yaw, one sigma, deg/h", TUNED)
    roll_drift_deg_h: float = setting(0.025, "the same about roll", TUNED)
    pitch_drift_deg_h: float = setting(0.025, "the same about pitch", TUNED)
    drift_time_h: float = setting(8.0, "correlation time of the drifts, h", TUNED)
    correction_scale_error: float = setting(0.05, "relative error of the effect of an announced correction", TUNED)
    torque_scale_error: float = setting(0.02, "relative error of the effect of a torque", TUNED)
    chain_walk_db_sqrt_h: float = setting(0.03, "random walk of the receiving chain, dB per square root of hour", TUNED)
    common_reference_sigma_db: float = setting(
        0.1, "what all references may have wrong together at an alignment, dB", TUNED
    )
    min_white_db: float = setting(0.02, "white noise of a carrier is never believed to be below this, dB", TUNED)
    yaw_sigma_limit_deg: float = setting(
        0.125, "a greater sigma of yaw withholds yaw while nothing is lost by waiting, deg", TUNED
    )
    unknown_torque_n_m: float = setting(
        1e-6, "prior of a residual torque that the catalogue does not state, one sigma, N m", CHOSEN
    )
    least_stated_torque_n_m: float = setting(
        1e-9, "a stated torque is not believed to be smaller, one sigma, N m", TUNED
    )
    innovation_limit: float = setting(2.0, "mean normalised innovation squared above which control is withheld", TUNED)
    relearned_share: float = setting(
        1.0 / 3.0, "share of references learned again above which an alignment is advised", TUNED
    )
    disagreement_deg: float = setting(0.15, "methods this far apart in roll or pitch disagree, deg", CHOSEN)
    disagreement_s: float = setting(900.0, "when they have been apart for this long, s", CHOSEN)


@dataclass(frozen=True, slots=True)
class OperationConfig:
    """Effects of declared operations on the robust method."""

    station_keeping_deg: float = setting(0.1, "sigma of each angle after a burn that states none, deg", TUNED)
    momentum_unloading_deg: float = setting(0.05, "the same after an unloading of momentum, deg", TUNED)
    eclipse_gain_db_sqrt_h: float = setting(
        0.3, "walk of a transponder's gain in eclipse, dB per square root of hour", TUNED
    )
    eclipse_level_db_sqrt_h: float = setting(
        0.06, "walk of single levels in eclipse, dB per square root of hour", TUNED
    )
    gain_step_db: float = setting(2.0, "a gain or the receiving chain moves by this when worked on, dB", TUNED)
    carrier_step_db: float = setting(3.0, "a carrier that was worked on comes back within this, dB", TUNED)


@dataclass(frozen=True, slots=True)
class InterlockConfig:
    """Limits beyond which control is inhibited."""

    validity_limit_deg: float = setting(
        0.4,
        "range of the published model, in which angles are to stay, deg",
        PUBLISHED,
    )
    model_range_deg: float = setting(2.0, "roll or pitch beyond this inhibits control, deg", CHOSEN)
    roll_sigma_limit_deg: float = setting(0.06, "greatest sigma of roll with which control is allowed, deg", TUNED)
    pitch_sigma_limit_deg: float = setting(0.10, "greatest sigma of pitch with which control is allowed, deg", TUNED)
    alert_limit_deg: float = setting(
        0.22, "greatest protection level of roll and of pitch with which control is allowed, deg", TUNED
    )
    min_redundancy: int = setting(2, "fewest carriers beyond the three unknowns", TUNED)


@dataclass(frozen=True, slots=True)
class TorqueConfig:
    """Torque pulses of the attitude control law."""

    min_pulse_s: float = setting(0.1, "shortest pulse the drive executes, s", TUNED)
    time_step_s: float = setting(0.001, "pulses are timed to this, s", TUNED)
    default_period_s: float = setting(60.0, "command period until row periods are known, s", CHOSEN)
    period_rows: int = setting(15, "rows from whose median the command period is taken", CHOSEN)
    slew_share: float = setting(0.75, "part of a command's period within which it slews", CHOSEN)
    balance_s: float = setting(450.0, "a known torque is balanced this often after the slew, s", CHOSEN)
    hold_s: float = setting(
        10_800.0, "while control is inhibited the torque known before is balanced for this long, s", TUNED
    )
    envelope_share: float = setting(0.95, "share of the envelope that the law uses by itself", CHOSEN)
    least_wheel_momentum_n_m_s: float = setting(
        0.2, "momentum from which null motion keeps a wheel away, N m s", CHOSEN
    )
    telemetry_age_s: float = setting(3600.0, "momentum that was told longer ago is not known any more, s", CHOSEN)
    rate_stale_periods: float = setting(3.0, "body rates older than so many row periods are not used ...", CHOSEN)
    rate_stale_margin_s: float = setting(30.0, "... and this much more, s", CHOSEN)
    panel_peak_limit_deg: float = setting(0.005, "what flexible modes may add to the angle of the hub, deg", CHOSEN)


@dataclass(frozen=True, slots=True)
class AlarmConfig:
    """Default limits of alarms; the limits of a spacecraft replace them."""

    attitude_warning_deg: float = setting(0.3, "an angle beyond this is a warning, deg", PUBLISHED)
    attitude_critical_deg: float = setting(0.4, "an angle beyond this is critical, deg", PUBLISHED)
    protection_warning_deg: float = setting(
        0.22, "a protection level of roll or pitch beyond this for ten minutes is a warning, deg", CHOSEN
    )
    stale_periods: float = setting(3.0, "no row for so many row periods is a warning", CHOSEN)
    disk_warning_mb: float = setting(1024.0, "less room than this beside the archive's file is a warning, MB", CHOSEN)
    disk_critical_mb: float = setting(256.0, "less room than this is critical, MB", CHOSEN)
    check_period_s: float = setting(2.0, "links, sources and ages are looked at this often, s", CHOSEN)


@dataclass(frozen=True, slots=True)
class ChainConfig:
    """Configuration of the whole chain."""

    estimation: EstimationConfig = EstimationConfig()
    fade: FadeConfig = FadeConfig()
    interlock: InterlockConfig = InterlockConfig()
    torque: TorqueConfig = TorqueConfig()
    robust: RobustConfig = RobustConfig()
    operations: OperationConfig = OperationConfig()
