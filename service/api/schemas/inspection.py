"""Result of a fit of a window on demand: the daily change of each carrier."""

from dataclasses import asdict
from typing import Self

from service.api.schemas.base import Answer, Figure, WindowAnswer
from service.api.schemas.calibrations import HarmonicAnswer
from service.api.schemas.record_answers import members_of
from service.pipeline.calibration.window_harmonics import CarrierHarmonic, DishLaw
from service.records.calibration import Window
from service.records.catalogue import Method
from service.runtime.jobs.archive_analysis import WindowHarmonics


class DishLawAnswer(members_of(DishLaw), Answer):
    """`b1 m1 + b2 m2 - k |m|^2` dB: what a fixed dish makes of the satellite's motion m in its sky, deg."""


class CarrierHarmonicAnswer(HarmonicAnswer):
    """Daily change of one carrier; sigmas hold for independent residuals."""

    carrier: str
    law: str
    """one_harmonic, two_harmonics or dish_law; of a dish law the harmonics are those of its curve in the window."""
    second_amplitude_db: Figure
    """Of the harmonic of half the period; null where the law has none."""
    second_phase_rad: Figure
    dish_law: DishLawAnswer | None
    amplitude_sigma_db: Figure
    phase_sigma_rad: Figure
    offset_sigma_db: Figure
    converged: bool
    """True: the iteration came to rest."""

    @classmethod
    def of(cls, fit: CarrierHarmonic) -> Self:
        """Return the answer that tells the fit of a carrier."""
        return super().of(fit, dish_law=fit.dish, **asdict(fit.harmonic))


class WindowHarmonicsAnswer(Answer):
    """Daily change in a window, phase and motion from the newest ephemeris."""

    range: WindowAnswer
    method: Method
    plan_id: int
    ephemeris_id: int
    rows: int
    """Measurements in the window."""
    carriers: list[CarrierHarmonicAnswer]

    @classmethod
    def of(cls, window: Window, method: Method, harmonics: WindowHarmonics) -> Self:
        """Return the answer for the harmonics of a window."""
        carriers = [CarrierHarmonicAnswer.of(fit) for fit in harmonics.carriers]
        return super().of(harmonics, range=window, method=method, carriers=carriers)
