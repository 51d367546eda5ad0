"""Daily change of any stretch of the archive, on demand: what an operator looks at before deciding on a calibration.

``paper`` is the published fit, one harmonic and 3 sigma. ``robust`` is a trimmed start and Tukey's estimate: of the
dish law where ballistics covers at least half of the rows and the carrier has a station, else of two harmonics. Both
are told as harmonics of the node's phase; those of a dish law are the harmonics of its curve over these rows. Nothing
is refused: what was not fitted is NaN.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.geometry_columns import OrbitMotion, daily_columns
from service.core.estimation.calibration.joint_tukey import DailyFits, fit_daily
from service.core.estimation.paper.harmonic import HarmonicFits, fit_harmonics
from service.core.geometry.line_of_sight import (
    Positions,
    sight_motion_deg,
    track_position_deg,
)
from service.pipeline.calibration.geometry_rows import node_us, phase_rad
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.polarization import predicted_track
from service.records.calibration import Harmonic
from service.records.catalogue import Carrier, Ephemeris
from service.records.levels.attitude import FloatArray, IntArray
from service.records.levels.measurement import MeasurementSeries

#: share of the rows that ballistics must cover for the dish law
_MIN_COVERED = 0.5


class DishLaw(NamedTuple):
    """``b1 m1 + b2 m2 - k |m|^2``: what a fixed dish makes of the satellite's motion m in its sky, with sigmas."""

    b1_db_per_deg: float
    b2_db_per_deg: float
    k_db_per_deg2: float
    b1_sigma_db_per_deg: float
    b2_sigma_db_per_deg: float
    k_sigma_db_per_deg2: float


class CarrierHarmonic(NamedTuple):
    """Daily change of one carrier in a window; sigmas hold for independent residuals."""

    carrier: str
    #: one_harmonic, two_harmonics or dish_law
    law: str
    harmonic: Harmonic
    amplitude_sigma_db: float
    phase_sigma_rad: float
    offset_sigma_db: float
    #: ``am2 cos(2 w t + phi2)``; NaN where the law has none
    second_amplitude_db: float
    second_phase_rad: float
    #: None where it was not fitted
    dish: DishLaw | None
    #: whether the iteration came to rest
    is_converged: bool


def paper_harmonics(
    series: MeasurementSeries, ephemeris: Ephemeris, stop_us: int, config: CalibrationConfig
) -> tuple[CarrierHarmonic, ...]:
    """Return the published fit of every carrier; ``stop_us`` is the end of the window."""
    fits = fit_harmonics(
        phase_rad(ephemeris, series.epochs_us),
        series.power_dbm,
        max_iterations=config.harmonic.max_iterations,
        gate_sigma=config.harmonic.gate_sigma,
    )
    start_us = node_us(ephemeris, int(series.epochs_us[-1]) if len(series.epochs_us) else stop_us - 1)
    return tuple(
        _paper_carrier(name, fitted_harmonic(fits, k, ephemeris.nodal_period_s, start_us), fits, k)
        for k, name in enumerate(series.carrier_ids)
    )


def fitted_harmonic(fits: HarmonicFits, k: int, period_s: float, start_us: int) -> Harmonic:
    """Return the published harmonic of the k-th carrier as it is stored, its phase counted from a node."""
    return Harmonic(
        float(fits.amplitude_db[k]),
        float(fits.phase_rad[k]),
        float(fits.offset_dbm[k]),
        period_s,
        start_us,
        float(fits.rms_db[k]),
        int(fits.samples_used[k]),
        int(fits.samples_rejected[k]),
    )


def robust_harmonics(
    series: MeasurementSeries,
    ephemeris: Ephemeris,
    stop_us: int,
    carriers: Sequence[Carrier],
    longitude_deg: float,
) -> tuple[CarrierHarmonic, ...]:
    """Return the robust fit of every carrier; ``carriers`` are those of the series, in its order."""
    phase = phase_rad(ephemeris, series.epochs_us)
    waves = daily_columns(None, phase, len(carriers))
    sight = _sight_deg(series.epochs_us, ephemeris, carriers, longitude_deg)
    is_dish = np.isfinite(sight).all(axis=2).sum(axis=0) > _MIN_COVERED * len(sight)
    dish = daily_columns(OrbitMotion(sight, sight), phase, len(carriers))
    start_us = node_us(ephemeris, int(series.epochs_us[-1]) if len(series.epochs_us) else stop_us - 1)
    reported: dict[int, CarrierHarmonic] = {}
    for columns, chosen in ((waves, np.flatnonzero(~is_dish)), (dish, np.flatnonzero(is_dish))):
        fits = fit_daily(columns[:, chosen], series.power_dbm[:, chosen].astype(np.float64))
        for position, k in enumerate(chosen.tolist()):
            curve = _as_waves(fits, columns[:, k], waves[:, k], position)
            law = _dish_law(fits, position) if is_dish[k] else None
            name, period_s = carriers[k].id, ephemeris.nodal_period_s
            reported[k] = _robust_carrier(name, curve, fits, law, position, period_s, start_us)
    return tuple(reported[k] for k in range(len(carriers)))


def _sight_deg(
    epochs_us: IntArray, ephemeris: Ephemeris, carriers: Sequence[Carrier], longitude_deg: float
) -> FloatArray:
    """Return the satellite's motion in the sky of each carrier's station (T, N, 2); NaN where it is not known."""
    if ephemeris.track is None:
        return np.full((len(epochs_us), len(carriers), 2), np.nan)
    placed = [
        (np.nan, np.nan) if carrier.station is None else (carrier.station.latitude_deg, carrier.station.longitude_deg)
        for carrier in carriers
    ]
    latitudes, longitudes = np.array(placed, dtype=np.float64).reshape(-1, 2).T
    positions = Positions(latitudes, longitudes, np.zeros(len(carriers)))
    return sight_motion_deg(track_position_deg(predicted_track(ephemeris.track), epochs_us), positions, longitude_deg)


def _as_waves(fits: DailyFits, columns: FloatArray, waves: FloatArray, k: int) -> tuple[FloatArray, FloatArray]:
    """Return level, cosine and sine of the phase and of twice the phase (5,) of a curve, and covariance (5, 5)."""
    is_known = np.isfinite(columns).all(axis=1) & np.isfinite(waves).all(axis=1)
    if not is_known.any() or np.isnan(fits.coefficients[k]).any():
        return np.full(5, np.nan), np.full((5, 5), np.nan)
    ones = np.ones((int(np.count_nonzero(is_known)), 1))
    basis = np.concatenate([ones, waves[is_known]], axis=1)
    own = np.concatenate([ones, columns[is_known]], axis=1)
    change = np.linalg.lstsq(basis, own, rcond=None)[0]
    return change @ fits.coefficients[k], change @ fits.covariance[k] @ change.T


def _dish_law(fits: DailyFits, k: int) -> DishLaw | None:
    """Return the coefficients of a fitted dish law."""
    if np.isnan(fits.coefficients[k]).any():
        return None
    b1, b2, bend = fits.coefficients[k, 1:].tolist()
    return DishLaw(b1, b2, bend, *np.sqrt(np.diagonal(fits.covariance[k])[1:]).tolist())


def _robust_carrier(
    name: str,
    curve: tuple[FloatArray, FloatArray],
    fits: DailyFits,
    dish: DishLaw | None,
    k: int,
    period_s: float,
    start_us: int,
) -> CarrierHarmonic:
    """Return the k-th carrier's daily change as it is told."""
    (level, *wave), covariance = curve
    amplitude_db, phase_rad = _polar(*wave[:2])
    counts = float(fits.rms_db[k]), int(fits.samples_used[k]), int(fits.samples_rejected[k])
    return CarrierHarmonic(
        name,
        "two_harmonics" if dish is None else "dish_law",
        Harmonic(amplitude_db, phase_rad, float(level), period_s, start_us, *counts),
        *_sigmas(covariance[:3, :3], amplitude_db, phase_rad),
        *_polar(*wave[2:]),
        dish,
        is_converged=bool(fits.converged[k]),
    )


def _paper_carrier(name: str, harmonic: Harmonic, fits: HarmonicFits, k: int) -> CarrierHarmonic:
    """Return the k-th carrier's published harmonic as it is told."""
    sigmas = _sigmas(fits.covariance[k], harmonic.amplitude_db, harmonic.phase_rad)
    return CarrierHarmonic(
        name, "one_harmonic", harmonic, *sigmas, np.nan, np.nan, None, is_converged=bool(fits.converged[k])
    )


def _polar(cosine: float, sine: float) -> tuple[float, float]:
    """Return amplitude and phase of ``a1 cos + a2 sin = am cos(. + phi)``."""
    return float(np.hypot(cosine, sine)), float(np.arctan2(-sine, cosine))


def _sigmas(covariance: FloatArray, amplitude_db: float, phase_rad: float) -> tuple[float, float, float]:
    """Return the sigmas of amplitude, phase and offset from the covariance (3, 3) of h, a1, a2."""
    # a1 = am cos phi, a2 = -am sin phi: an error along the vector (a1, a2) is one of am, across it one of phi
    along = np.array([0.0, np.cos(phase_rad), -np.sin(phase_rad)])
    across = np.array([0.0, np.sin(phase_rad), np.cos(phase_rad)])
    phase_sigma = float(np.sqrt(across @ covariance @ across)) / amplitude_db if amplitude_db else float("nan")
    return float(np.sqrt(along @ covariance @ along)), phase_sigma, float(np.sqrt(covariance[0, 0]))
