"""Noise of hourly means of powers, and error of the calibrated daily change, by the calibration's own noise."""

import math

import numpy as np

from service.records.calibration import CalibrationResult, CarrierCalibration, Window
from service.records.epoch import US_PER_S
from service.records.geometry import GeometryFit
from service.records.levels.attitude import FloatArray, IntArray

_HOUR_S, _YEAR_DAYS = 3600.0, 365.25
_DAY_RAD_S = 2.0 * math.pi / 86_400.0
#: dB, least noise of an hour's mean: levels are stored in steps of 0.004 dB
_LEAST_SIGMA_DB = 0.005
_DAY_US = 86_400 * US_PER_S


def hourly_sigma_db(carrier: CarrierCalibration, rows: IntArray) -> float:
    """Return the noise of an hour's mean by the noise of the calibration; rows (H,) of each mean."""
    seen = rows[rows > 0]
    white_db2 = np.nan_to_num(carrier.sigma_white_db, nan=1.0) ** 2 / (np.median(seen) if len(seen) else 1.0)
    # mean of a process of the first order over an hour
    share = [(part.sigma_db, part.correlation_time_s / _HOUR_S) for part in carrier.noise]
    slow_db2 = sum(size**2 * 2.0 * tau * (1.0 - tau * -math.expm1(-1.0 / tau)) for size, tau in share)
    return float(np.sqrt(white_db2 + slow_db2 + _LEAST_SIGMA_DB**2))


def daily_error_db(result: CalibrationResult, fit: GeometryFit, quiet: Window, start_us: IntArray) -> FloatArray:
    """Return the error of each carrier's calibrated daily change (N,) at the hours, rms, dB.

    Quiet days tell the sum of what the orbit and the Sun do each day as well as the noise lets them, and the two apart
    badly: they come apart as the orbit's day, four minutes shorter, moves on.
    """
    span_s = (quiet.stop_us - quiet.start_us) / US_PER_S
    power = [
        sum(
            part.sigma_db**2 * part.correlation_time_s / (1.0 + (_DAY_RAD_S * part.correlation_time_s) ** 2)
            for part in one.noise
        )
        for one in result.carriers
    ]
    if not len(start_us):
        return np.sqrt(4.0 * np.array(power) / span_s)
    days = (float(start_us.mean()) - 0.5 * (quiet.start_us + quiet.stop_us)) / _DAY_US
    apart = 2.0 * math.sin(math.pi * days / _YEAR_DAYS) * np.array(fit.daily_error_db or (0.0,) * len(power))
    return np.sqrt(4.0 * np.array(power) / span_s + np.square(apart))
