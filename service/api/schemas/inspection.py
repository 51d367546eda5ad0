"""Result of a fit of a window on demand: the daily change of each carrier."""

from typing import Self

from service.api.schemas.base import Answer, Figure, WindowAnswer
from service.api.schemas.calibrations import HarmonicAnswer
from service.pipeline.calibration.window_harmonics import CarrierHarmonic
from service.records.calibration import Window
from service.records.catalogue import Method
from service.runtime.jobs.archive_analysis import WindowHarmonics


class DishLawAnswer(Answer):
    """`b1 m1 + b2 m2 - k |m|^2` dB: what a fixed dish makes of the satellite's motion m in its sky, deg."""

    b1_db_per_deg: Figure
    b2_db_per_deg: Figure
    k_db_per_deg2: Figure
    b1_sigma_db_per_deg: Figure
    b2_sigma_db_per_deg: Figure
    k_sigma_db_per_deg2: Figure


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
    """Whether the iteration came to rest."""

    @classmethod
    def of_carrier(cls, fit: CarrierHarmonic) -> Self:
        """Return the answer for the fit of a carrier."""
        return cls.model_validate(
            {
                **HarmonicAnswer.of(fit.harmonic).model_dump(),
                "carrier": fit.carrier,
                "law": fit.law,
                "second_amplitude_db": fit.second_amplitude_db,
                "second_phase_rad": fit.second_phase_rad,
                "dish_law": None if fit.dish is None else fit.dish._asdict(),
                "amplitude_sigma_db": fit.amplitude_sigma_db,
                "phase_sigma_rad": fit.phase_sigma_rad,
                "offset_sigma_db": fit.offset_sigma_db,
                "converged": fit.is_converged,
            }
        )


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
        return cls(
            range=WindowAnswer.of(window),
            method=method,
            plan_id=harmonics.plan_id,
            ephemeris_id=harmonics.ephemeris_id,
            rows=harmonics.rows,
            carriers=[CarrierHarmonicAnswer.of_carrier(fit) for fit in harmonics.carriers],
        )
