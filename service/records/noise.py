"""Noise of a carrier's level, as a calibration learned it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class NoiseComponent:
    """One coloured part of the noise."""

    correlation_time_s: float
    sigma_db: float
