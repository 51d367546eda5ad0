"""What inspection of the archive tells: harmonics of a window, recommended carriers."""

from typing import Self

from service.api.schemas.base import AnglesAnswer, Answer, Figure, WindowAnswer
from service.api.schemas.calibrations import HarmonicAnswer
from service.records.calibration import Window
from service.records.catalogue import Method
from service.runtime.inspection import CarrierHarmonic, CarrierRecommendation, RecommendedCarrier, WindowHarmonics


class CarrierHarmonicAnswer(HarmonicAnswer):
    """Harmonic of one carrier; sigmas hold for independent residuals."""

    carrier: str
    amplitude_sigma_db: Figure
    phase_sigma_rad: Figure
    offset_sigma_db: Figure
    converged: bool
    """Whether the rejection of outliers came to rest."""

    @classmethod
    def of_carrier(cls, fit: CarrierHarmonic) -> Self:
        """Return the answer that tells the fit of a carrier."""
        return cls.model_validate(
            {
                **HarmonicAnswer.of(fit.harmonic).model_dump(),
                "carrier": fit.carrier,
                "amplitude_sigma_db": fit.amplitude_sigma_db,
                "phase_sigma_rad": fit.phase_sigma_rad,
                "offset_sigma_db": fit.offset_sigma_db,
                "converged": fit.is_converged,
            }
        )


class WindowHarmonicsAnswer(Answer):
    """Harmonics of a window, phase from the newest ephemeris."""

    range: WindowAnswer
    method: Method
    plan_id: int
    ephemeris_id: int
    rows: int
    """Measurements in the window."""
    carriers: list[CarrierHarmonicAnswer]

    @classmethod
    def of(cls, window: Window, method: Method, harmonics: WindowHarmonics) -> Self:
        """Return the answer that tells the harmonics of a window."""
        return cls(
            range=WindowAnswer.of(window),
            method=method,
            plan_id=harmonics.plan_id,
            ephemeris_id=harmonics.ephemeris_id,
            rows=harmonics.rows,
            carriers=[CarrierHarmonicAnswer.of_carrier(fit) for fit in harmonics.carriers],
        )


class RecommendedCarrierAnswer(Answer):
    """What the rule says about one carrier."""

    carrier: str
    selected: bool
    rank: int | None
    """Place in the order of choice, 0 = first."""
    axis: str | None
    """Axis it was chosen for, else the one it answers to most."""
    dominance: Figure
    """Scaled answer to that axis over the greatest of the others."""
    sensitivity_db_per_deg: AnglesAnswer
    residual_rms_db: Figure
    departure_deg: Figure
    """Greatest departure from a straight line."""
    reasons: list[str]

    @classmethod
    def of(cls, carrier: RecommendedCarrier) -> Self:
        """Return the answer that tells a recommendation."""
        return cls.model_validate(
            {
                "carrier": carrier.carrier,
                "selected": carrier.is_selected,
                "rank": carrier.rank,
                "axis": carrier.axis,
                "dominance": carrier.dominance,
                "sensitivity_db_per_deg": carrier.sensitivity_db_per_deg,
                "residual_rms_db": carrier.residual_rms_db,
                "departure_deg": carrier.nonlinearity_deg,
                "reasons": carrier.reasons,
            }
        )


class CarrierSelectionAnswer(Answer):
    """A recommended subset of the carriers of the newest calibration that has figures."""

    rule: str
    count: int
    """Carriers asked for."""
    calibration_id: int
    selected: list[str]
    """In the order of choice; fewer than asked for when there are not enough."""
    condition: Figure
    dop: AnglesAnswer
    """deg per dB"""
    crlb_deg: AnglesAnswer
    """One row, with a common-mode unknown."""
    carriers: list[RecommendedCarrierAnswer]

    @classmethod
    def of(cls, rule: str, count: int, recommendation: CarrierRecommendation) -> Self:
        """Return the answer that tells a recommendation."""
        chosen = [(carrier.rank, carrier.carrier) for carrier in recommendation.carriers if carrier.rank is not None]
        return cls(
            rule=rule,
            count=count,
            calibration_id=recommendation.calibration_id,
            selected=[name for _, name in sorted(chosen)],
            condition=recommendation.condition,
            dop=AnglesAnswer.of(recommendation.dop_deg_per_db),
            crlb_deg=AnglesAnswer.of(recommendation.crlb_deg),
            carriers=[RecommendedCarrierAnswer.of(carrier) for carrier in recommendation.carriers],
        )
