"""Configuration of the stages: frozen, built once by the composition root, every number a setting.

The defaults are those of the published method where it states one, else tuned on the simulator's truth; the
reference of settings says which.
"""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class HarmonicConfig:
    """Least-squares fit of the daily harmonic."""

    #: a sample is used while its residual is within this many sigma
    gate_sigma: float = 3.0
    max_iterations: int = 50


@dataclass(frozen=True, slots=True)
class CriteriaConfig:
    """The three criteria by which carriers are judged."""

    #: stable: rms after the harmonic, dB
    max_residual_rms_db: float = 0.25
    #: linear: departure from a straight line, in degrees of the carrier's own axis
    max_nonlinearity_deg: float = 0.1
    linear_range_deg: float = 0.5
    #: dominant: ratio of the greatest coefficient to the others
    dominance_ratio: float = 2.0
    #: yaw coefficients are this many times smaller by geometry and are scaled up before the comparison
    yaw_scale: float = 8.0
    #: carriers that are selected at least, mixed ones filling up when dominant ones are few
    min_selected: int = 16


@dataclass(frozen=True, slots=True)
class CalibrationConfig:
    """Calibration from quiet days and turns."""

    harmonic: HarmonicConfig = HarmonicConfig()
    criteria: CriteriaConfig = CriteriaConfig()
    #: a row of the turns needs a sensor reading this close in time, s
    reference_reach_s: float = 120.0
    #: quiet windows shorter than this many nodal periods are warned of
    short_quiet_periods: float = 2.0
    #: fewest rows with powers and angles in the turns
    min_turn_rows: int = 60
    #: fewest rows with powers and angles in the quiet window of a calibration by geometry
    min_quiet_rows: int = 200
    #: quiet windows shorter than this are warned of in a calibration by geometry, days
    short_quiet_days: float = 2.9
    #: share of the rows that the track should cover
    min_tracked_share: float = 0.95
    #: power of a wave of half a day that the dish law may leave, over that of neighbouring waves
    max_daily_excess: float = 5.0
    #: share by which the noise of a sensor may shrink the slopes without a warning
    max_slope_shrink: float = 0.02
    #: a carrier is flat when the turns move it, rms, by less than this share of the noise of a row
    flat_share: float = 0.5
    #: a level drifts beyond both, dB per day and sigmas of what its noise explains
    drift_db_per_day: float = 0.15
    drift_sigmas: float = 4.0
    #: chi-square of two degrees of freedom beyond which a station is said to stand elsewhere
    place_chi_square: float = 16.0
    #: random walk of a carrier's level at least, dB per square root of hour
    reference_walk_db_sqrt_h: float = 0.003
    #: knots of a carrier's level over the turns are at least this far apart, s; the default gives one straight line
    level_knot_s: float = 36_000.0
    #: an axis counts as turned where its angle passed this, deg
    min_turn_deg: float = 0.1
    #: turns of yaw below this do not prove its sign, deg
    min_yaw_proof_deg: float = 0.3
    #: scale by which one axis of a sensor may differ from the others without a warning
    max_scale_error: float = 0.1


@dataclass(frozen=True, slots=True)
class AlignmentConfig:
    """Alignment to an outside sensor."""

    #: window of powers before a manual alignment, s
    manual_window_s: float = 900.0
    #: fewest rows of a carrier for a reference
    min_rows: int = 8
    #: powers contradict the angles below this probability
    min_probability: float = 1e-4
    #: wander of a carrier's level since calibration, dB per square root of hour
    level_walk_db_sqrt_h: float = 0.006
    #: a carrier whose level changed by more than this many sigma is left out of the contradiction test
    changed_level_sigma: float = 4.0


@dataclass(frozen=True, slots=True)
class EstimationConfig:
    """The paper method in operation."""

    #: trailing mean of the deviations, s
    averaging_window_s: float = 900.0
    #: fewest rows of a carrier in that mean
    min_rows: int = 8
    #: uplink rain: a carrier this far below the others is left out, dB
    uplink_gate_db: float = 1.5
    gate_sigma: float = 3.0
    min_carriers: int = 4
    #: rates are the slope of the fixes over this time, s
    rate_window_s: float = 1800.0
    #: a row later than this after its predecessor starts the means anew, s
    max_gap_s: float = 1800.0


@dataclass(frozen=True, slots=True)
class FadeConfig:
    """Downlink rain by the rule of one sign and near size."""

    #: carriers must lie below minus this, dB
    depth_db: float = 0.3
    #: share of the carriers that must
    share: float = 0.8
    #: their spread (1.48 MAD) must stay below this share of the median
    spread_ratio: float = 0.5
    #: control stops after the rule has held this long, s
    entry_s: float = 300.0
    #: control returns after the median has been above minus depth this long, s
    exit_s: float = 600.0
    #: a longer pause between rows starts the count of wet time anew, s
    max_gap_s: float = 300.0
    #: mean of the deviations that the rule looks at, s
    averaging_window_s: float = 600.0


@dataclass(frozen=True, slots=True)
class RobustConfig:
    """The robust method in operation."""

    #: drift of the inertial model, one standard deviation, deg/h, and its correlation time, h
    yaw_drift_deg_h: float = 0.04
    roll_drift_deg_h: float = 0.025
    pitch_drift_deg_h: float = 0.025
    drift_time_h: float = 8.0
    #: relative error of the effect of an announced correction and of a torque
    correction_scale_error: float = 0.05
    torque_scale_error: float = 0.02
    #: random walk of the receiving chain, dB per square root of hour
    chain_walk_db_sqrt_h: float = 0.03
    #: what all references may have wrong together at an alignment, dB
    common_reference_sigma_db: float = 0.1
    #: white noise of a carrier is never believed to be below this, dB
    min_white_db: float = 0.02
    #: greatest own sigma of yaw with which it is controlled, deg
    yaw_sigma_limit_deg: float = 0.125
    #: the same of a craft that a residual torque turns: left alone its yaw is lost within hours
    pushed_yaw_sigma_limit_deg: float = 0.5
    #: prior of a residual torque that the catalogue does not state, one standard deviation an axis, N m
    unknown_torque_n_m: float = 1e-6
    #: greatest own sigma of yaw with which it is controlled under such a torque, deg
    unknown_torque_yaw_sigma_limit_deg: float = 1.0
    #: yaw beyond it is left alone, deg; it moves no station by more than a sixth of itself
    yaw_validity_limit_deg: float = 2.0
    #: running mean of the normalised innovation squared above which the model is not believed
    innovation_limit: float = 2.0
    #: share of references learned anew above which an alignment is advised
    relearned_share: float = 1.0 / 3.0
    #: methods that differ by this in roll or pitch for this long disagree, deg and s
    disagreement_deg: float = 0.15
    disagreement_s: float = 900.0


@dataclass(frozen=True, slots=True)
class OperationConfig:
    """What declared operations mean to the robust method."""

    #: one standard deviation of each angle where an operation states none, deg
    station_keeping_deg: float = 0.1
    momentum_unloading_deg: float = 0.05
    #: eclipse: walk of a transponder's gain, and of single levels where the reflector bends, dB per square root of hour
    eclipse_gain_db_sqrt_h: float = 0.3
    eclipse_level_db_sqrt_h: float = 0.06
    #: a gain or the receiving chain is taken to move by this when it is worked on, dB
    gain_step_db: float = 2.0
    #: a carrier that was worked on comes back within this, dB
    carrier_step_db: float = 3.0


@dataclass(frozen=True, slots=True)
class InterlockConfig:
    """What inhibits control."""

    #: validity of the model in roll and pitch, deg; under `paper` yaw beyond it withholds the yaw torque only
    validity_limit_deg: float = 0.4
    #: greatest own sigma with which an axis is controlled, deg
    yaw_sigma_limit_deg: float = 0.20
    roll_sigma_limit_deg: float = 0.06
    pitch_sigma_limit_deg: float = 0.10
    #: fewest carriers beyond the three unknowns
    min_redundancy: int = 2


@dataclass(frozen=True, slots=True)
class TorqueConfig:
    """Torque pulses of the attitude control law."""

    #: shortest pulse the drive executes, s
    min_pulse_s: float = 0.1
    #: pulses are timed to this, s
    time_step_s: float = 0.001
    #: command period until row periods are known, s
    default_period_s: float = 60.0
    #: rows from whose median the command period is taken
    period_rows: int = 15
    #: part of a command's period within which it slews; the rest is for its report and for the next one's way
    slew_share: float = 0.75
    #: a known torque is balanced this often after the slew, s
    balance_s: float = 450.0
    #: share of the envelope that the law uses by itself
    envelope_share: float = 0.95
    #: momentum from which null motion keeps a wheel away, N m s; wheels beyond three have it
    least_wheel_momentum_n_m_s: float = 0.2
    #: momentum that was told longer ago is not known any more, s
    telemetry_age_s: float = 3600.0
    #: rates of the body are too old beyond so many row periods and this much more, s
    rate_stale_periods: float = 3.0
    rate_stale_margin_s: float = 30.0
    #: what flexible modes may add to the angle of the hub, deg
    panel_peak_limit_deg: float = 0.005


@dataclass(frozen=True, slots=True)
class AlarmConfig:
    """What alarms by default; the limits of a spacecraft say more."""

    #: angles from nominal, deg
    attitude_warning_deg: float = 0.3
    attitude_critical_deg: float = 0.4
    #: no row for so many row periods
    stale_periods: float = 3.0
    #: free room beside the archive's file, MB
    disk_warning_mb: float = 1024.0
    disk_critical_mb: float = 256.0
    #: links, sources and ages are looked at this often, s
    check_period_s: float = 2.0


@dataclass(frozen=True, slots=True)
class ChainConfig:
    """Configuration of the whole chain."""

    estimation: EstimationConfig = EstimationConfig()
    fade: FadeConfig = FadeConfig()
    interlock: InterlockConfig = InterlockConfig()
    torque: TorqueConfig = TorqueConfig()
    robust: RobustConfig = RobustConfig()
    operations: OperationConfig = OperationConfig()
    #: who does the arithmetic of the robust filter; both agree to rounding
    kernels: Literal["numba", "numpy"] = "numpy"
