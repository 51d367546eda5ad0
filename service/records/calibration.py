"""Calibration and alignment: what links powers to angles.

All arrays are tuples in the order of the plan's carriers or of (yaw, roll, pitch); absent figures are NaN.
"""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

from service.records.levels.attitude import Axes

Row = tuple[float, ...]
Table = tuple[Row, ...]


@dataclass(frozen=True, slots=True)
class NoiseComponent:
    """One coloured part of the noise."""

    correlation_time_s: float
    sigma_db: float


@dataclass(frozen=True, slots=True)
class GeometryFit:
    """Joint fit of N carriers with D daily coefficients and R bands; K = 1 + D + 5 own coefficients.

    Everything the robust method computes with. Arrays are nested tuples in the order of the calibration's carriers; NaN
    marks what was not found. Angles of stations and of the receiving site are those of the antenna frame that the fit
    used, so that a later change of the catalogue does not move a calibration.
    """

    #: whether ``daily`` is the dish law (b1, b2 in dB/deg, k in dB/deg^2), else two harmonics in dB
    is_dish_law: bool
    #: names of the R bands and (N,) the number of each carrier's band
    bands: tuple[str, ...]
    band: tuple[int, ...]
    #: (R,) share of the receiving site's rain that each band takes, Ku 1
    rain_share: Row
    #: names of the transponders and (N,) the number of each carrier's
    transponders: tuple[str, ...]
    transponder: tuple[int, ...]
    #: (N,) deg in the antenna frame, NaN for a beacon; geodetic places, deg
    station_azimuth_deg: Row
    station_elevation_deg: Row
    station_latitude_deg: Row
    station_longitude_deg: Row
    #: azimuth and elevation of the receiving site, deg; its geodetic place, deg, deg, m
    site_deg: tuple[float, float]
    site_position: tuple[float, float, float]
    #: East longitude from which motion is counted, deg
    nominal_longitude_deg: float
    #: (N,) dBm at zero attitude and zero motion
    level_dbm: Row
    #: (N, D)
    daily: Table
    #: (N, 2) dB/deg, azimuth and elevation
    gradient: Table
    #: (N, 3) dB/deg^2, az az, az el, el el
    hessian: Table
    #: (R, 2) dB/deg at the receiving site
    downlink: Table
    #: (N, K, K) of level, daily, gradient, Hessian
    covariance: tuple[Table, ...]
    #: (2 R, 2 R) dB^2/deg^2
    downlink_covariance: Table
    #: (N, K, 2 R)
    downlink_gain: tuple[Table, ...]
    #: (N, 2) dB, cosine and sine of the solar day, counted from midnight UTC
    solar_day_db: Table
    #: (N,) dB, step of the power readings, 0 = none seen
    quantisation_db: Row
    #: (N,) dB per square root of hour
    reference_walk_db: Row
    #: noise that all carriers share
    common_noise: tuple[NoiseComponent, ...]
    #: (N,) whether the robust method uses the carrier
    is_used: tuple[bool, ...]
    #: (N,) number of the group whose level control couples the carrier, -1 = none; empty = no carrier is coupled.
    #: Only differences within a group are known: subtract from each row's deviations the mean over the group's present
    #: carriers, and from the model's gradients the same mean
    alc_group: tuple[int, ...] = ()
    #: (N,) dB, rms over the orbit of the quiet days of what the covariance of ``daily`` alone leaves open
    daily_error_db: Row = ()


class CalibrationMethod(StrEnum):
    """Method of the calibration fit."""

    GEOMETRY = "geometry"
    PAPER = "paper"


class CalibrationState(StrEnum):
    """Life of a calibration."""

    DRAFT = "draft"
    ACTIVE = "active"
    SUPERSEDED = "superseded"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Window:
    """Interval of epochs, start inclusive, stop exclusive."""

    start_us: int
    stop_us: int


@dataclass(frozen=True, slots=True)
class Harmonic:
    """One carrier's daily harmonic, equation (3), and how well it was found."""

    amplitude_db: float
    phase_rad: float
    offset_dbm: float
    period_s: float
    node_epoch_us: Annotated[int, "Ascending node from which the phase is counted."]
    rms_db: float
    samples_used: int
    samples_rejected: int


@dataclass(frozen=True, slots=True)
class CarrierCalibration:
    """Result of a calibration for one carrier."""

    id: str
    level_dbm: float
    sigma_white_db: float
    noise: tuple[NoiseComponent, ...]
    harmonic: Harmonic
    sensitivity_db_per_deg: Axes
    sensitivity_plus_db_per_deg: Axes
    sensitivity_minus_db_per_deg: Axes
    #: rms of the turn fit
    residual_db: float
    stability_residual_rms_db: float
    drift_db_per_day: float
    deviation_at_0p5_deg_db: float
    #: greatest departure from the straight line in deg, and the range it was judged in
    nonlinearity_deg: float
    linear_range_deg: float
    axis: Annotated[str, "roll, pitch, yaw or mixed."]
    axis_ratio: Annotated[float, "Third criterion: greatest coefficient over the others."]
    #: of stable, linear, dominant
    criteria_met: tuple[str, ...]
    rejected_because: tuple[str, ...]
    selected: bool


@dataclass(frozen=True, slots=True)
class Observability:
    """Observability of the attitude by the selected carriers."""

    condition: float
    dop: Annotated[Axes, "deg per dB"]
    crlb_deg: Annotated[Axes, "One row, with a common-mode unknown."]


@dataclass(frozen=True, slots=True)
class CalibrationRequest:
    """Request of an operator for a calibration."""

    quiet: Window
    turns: Window
    method: CalibrationMethod
    #: sensor for each angle: star_tracker, earth_sensor, radio_beacon or other
    source_yaw: str = "star_tracker"
    source_roll: str = "star_tracker"
    source_pitch: str = "star_tracker"

    @property
    def data_until_us(self) -> int:
        """End of the data that it is made from."""
        return max(self.quiet.stop_us, self.turns.stop_us)


@dataclass(frozen=True, slots=True)
class SensorSigns:
    """Signs of the sensors' axes that the powers have proven."""

    #: yaw against roll and pitch; while it is not, yaw is not controlled
    is_yaw_proven: bool
    #: the sign that all axes have in common
    is_common_proven: bool


class MotionVerdict(StrEnum):
    """Verdict of the turns on measured motion: momentum of the wheels, rates of the body, angles of a polarimeter."""

    CONSISTENT = "consistent"
    CONTRADICTED = "contradicted"
    UNCHECKED = "not_checked"


@dataclass(frozen=True, slots=True)
class AxesCheck:
    """Check of a sensor of three axes by the turns; order roll, pitch, yaw, NaN = not determined."""

    verdict: MotionVerdict
    #: what contradicts it, why it was not checked, or what stays open; empty = nothing
    reason: str
    #: response of each axis over that of a true sensor, and one standard deviation
    response: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    response_sigma: tuple[float, float, float] = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class TurnsCheck:
    """Check of the turns by the powers against those by the sensor; NaN = not determined."""

    verdict: MotionVerdict
    #: likeliest cause, where clock, unit or sensor is contradicted; empty = nothing
    reason: str
    #: lag of the powers behind the sensor, positive = they are late, and one standard deviation
    lag_s: float = math.nan
    lag_sigma_s: float = math.nan
    #: angles of the sensor over those of the beams, and one standard deviation of its logarithm
    scale: float = math.nan
    scale_sigma: float = math.nan
    #: squares of what the turns leave over those of the noise, and sigmas by which carriers share it
    scatter: float = math.nan
    shared: float = math.nan


@dataclass(frozen=True, slots=True)
class FeedFit:
    """Feed of a polarimeter by its ratios on the quiet days and turns, while sensors told the angles."""

    #: turn of the feed at zero attitude with its leakage taken for a turn, cosine and sine of a daily wave (phase that
    #: of the solar day), deg
    mean: Row
    #: (3, 3) deg^2
    covariance: Table
    #: real part of the leakage, as the turn that it looks like, and one standard deviation, deg
    leakage_deg: float
    leakage_sigma_deg: float
    #: end of the quiet days and turns
    stop_us: int


@dataclass(frozen=True, slots=True)
class PolarimeterCheck:
    """Check of one polarimeter by the turns."""

    source: str
    verdict: MotionVerdict
    #: what contradicts it or the catalogue's turn of its feed, or why it was not checked; empty = nothing
    reason: str
    #: response to a turn about the line of sight, 1 of a true instrument, and one standard deviation
    response: float = math.nan
    response_sigma: float = math.nan
    #: None = its records are no ratios, or they contradict one another
    feed: FeedFit | None = None


@dataclass(frozen=True, slots=True)
class GatheredTorque:
    """Torque from outside that gathered in the wheels on the quiet days, and what their telemetry had wrong."""

    #: (13,) constant, cosine, sine of the torque, each yaw, roll, pitch, N m, its phase that of the solar day;
    #: misalignments about roll and yaw, deg; errors of the scale along roll and yaw
    mean: Row
    #: (13, 13)
    covariance: Table
    #: records it is made from, and the end of their days
    records: int
    stop_us: int


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """Outcome of a fit."""

    carriers: tuple[CarrierCalibration, ...]
    observability: Observability
    #: figures of the fit as a whole, by name
    quality: dict[str, float]
    warnings: tuple[str, ...]
    #: what the robust method computes with; None from a calibration of the paper method
    geometry: GeometryFit | None = None
    signs: SensorSigns | None = None
    #: None where the catalogue stated nothing of the momentum
    momentum: AxesCheck | None = None
    #: None where the catalogue has no rate sensor beside the loop
    rates: AxesCheck | None = None
    #: of each polarimeter that the catalogue uses
    polarimeters: tuple[PolarimeterCheck, ...] = ()
    #: None where the catalogue does not use the momentum, the turns contradict it, or quiet days do not tell it
    gathered: GatheredTorque | None = None
    #: None where a calibration of the paper method has too few carriers with a place
    turns: TurnsCheck | None = None


@dataclass(frozen=True, slots=True)
class Calibration:
    """One calibration of the archive."""

    id: int
    plan_id: int
    ephemeris_id: int
    state: CalibrationState
    request: CalibrationRequest
    created_at_us: int
    created_by: str
    #: None while draft work runs or when it failed
    result: CalibrationResult | None
    error: Annotated[str | None, "Why it failed."] = None
    override_reason: Annotated[str | None, "Why it was activated although its turns are inconsistent."] = None

    @property
    def contradiction(self) -> str:
        """Likeliest cause of inconsistent turns; empty = they are consistent."""
        check = None if self.result is None else self.result.turns
        return "" if check is None else check.reason

    @property
    def is_momentum_contradicted(self) -> bool:
        """Return whether the turns contradict the momentum of the wheels in telemetry."""
        check = None if self.result is None else self.result.momentum
        return check is not None and check.verdict is MotionVerdict.CONTRADICTED

    @property
    def is_rates_contradicted(self) -> bool:
        """Return whether the turns contradict the rates of the body in telemetry."""
        check = None if self.result is None else self.result.rates
        return check is not None and check.verdict is MotionVerdict.CONTRADICTED

    @property
    def contradicted_polarimeters(self) -> frozenset[str]:
        """Return the polarimeters that the turns contradict."""
        checks = () if self.result is None else self.result.polarimeters
        return frozenset(check.source for check in checks if check.verdict is MotionVerdict.CONTRADICTED)


@dataclass(frozen=True, slots=True)
class CarrierReference:
    """Reference power of one carrier, harmonic removed."""

    carrier: str
    reference_dbm: float
    sigma_db: float
    samples: int
    change_since_calibration_db: float


@dataclass(frozen=True, slots=True)
class Alignment:
    """An alignment of the archive; sets state and references of every method."""

    id: int
    epoch_us: int
    attitude_deg: Axes
    sigma_deg: Axes
    calibration_id: int
    source: str
    created_at_us: int
    created_by: str
    references: Annotated[tuple[CarrierReference, ...], "Of the calibration named above."]
    window: Annotated[Window | None, "Where the reference powers were taken from."] = None
    override_reason: str | None = None
    #: references of each method that had a calibration, where they differ from ``references``
    references_by_method: dict[str, tuple[CarrierReference, ...]] = field(default_factory=dict)
    #: calibration that the references of each method were made with
    calibration_by_method: dict[str, int] = field(default_factory=dict)
    changed_carriers: Annotated[
        tuple[str, ...],
        "More than four sigma from the calibration. Their reference is that of the window alone; a level lower than "
        "in\nquiet days of the last three days is taken for wet, and the reference stays the calibrated one.",
    ] = ()
    warnings: Annotated[tuple[str, ...], "Gaps of the catalogue at the alignment and their cost in accuracy."] = ()
