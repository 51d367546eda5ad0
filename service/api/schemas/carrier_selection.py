"""Selection of carriers, their observability and turns."""

from enum import StrEnum
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator

from service.api.schemas.base import AnglesAnswer, Answer, Figure
from service.pipeline.planning import planning
from service.records.epoch import US_PER_S
from service.records.levels.attitude import named_axes
from service.runtime.jobs.analysis import CarrierRecommendation


def _named(values: Any) -> Any:
    return named_axes(values) if isinstance(values, np.ndarray) else values


_Angles = Annotated[AnglesAnswer, BeforeValidator(_named)]


class Turns(StrEnum):
    """Kind of the calibration turns in an answer."""

    NONE = "none"
    STANDARD = "standard"
    #: yaw to 1 deg, where the spacecraft allows it
    FAR_YAW = "far_yaw"


class RecommendedCarrierAnswer(Answer):
    """Result of the selection rule for one carrier."""

    carrier: str
    transponder: str
    selected: bool
    rank: int | None
    """Place in the order of choice, 0 = first."""
    axis: str | None
    """Axis it was chosen for, else the one it answers to most."""
    dominance: Figure
    """Scaled answer to that axis over the greatest of the others."""
    sensitivity_db_per_deg: _Angles
    sigma_db: Figure
    """Noise of one row, correlated parts included."""
    residual_rms_db: Figure
    departure_deg: Figure
    """Greatest departure from a straight line."""
    reasons: list[str]

    @classmethod
    def of(cls, recommendation: planning.Recommendation, k: int) -> Self:
        """Return the answer for what is recommended of the k-th carrier."""
        candidates, word = recommendation.candidates, recommendation.words[k]
        return super().of(
            word,
            carrier=candidates.carrier_ids[k],
            transponder=candidates.transponders[k],
            selected=word.rank is not None,
            sensitivity_db_per_deg=candidates.sensitivity_db_per_deg[k],
            sigma_db=float(candidates.sigma_db[k]),
            residual_rms_db=float(candidates.residual_rms_db[k]),
            departure_deg=float(candidates.nonlinearity_deg[k]),
        )


class SetCarrierAnswer(Answer):
    """A carrier as a member of a set."""

    carrier: str
    leverage: Figure
    """How much of the carrier's own error the fix follows, 0 to 1; those of a set add up to its unknowns."""
    undetectable_fault_db: Figure
    """Fault that one row overlooks in one case of ten; null where no other carrier checks it."""
    fault_shift_deg: _Angles
    """Shift of the angles by that fault."""


class AveragedSigmaAnswer(Answer):
    """Bound after averaging rows of a minute while the attitude stands still, with the learned noise."""

    span_s: float
    sigma_deg: _Angles


class CarrierSetAnswer(Answer):
    """Observability of the attitude by a set of carriers."""

    selected: list[str]
    """In the order of choice."""
    condition: Figure
    """Of the sensitivities; null = infinite."""
    dop: _Angles
    """deg per dB, without a common level."""
    dop_with_common: _Angles
    angle_dop: Figure
    """deg per dB, of the three angles together."""
    crlb_deg: _Angles
    """Smallest sigma of one row, with a common-mode unknown."""
    crlb_without_common_deg: _Angles
    averaged: list[AveragedSigmaAnswer]
    common_share: Figure
    """Share of a change common to all carriers that some attitude explains, 0 to 1."""
    redundancy: int
    """Carriers beyond three angles, their common levels and the level of one moved transponder."""
    transponder_share: float
    """Largest share of the carriers in one transponder."""
    sufficient: bool
    shortcomings: list[str]
    """Requirements of the robust method that the set lacks."""
    carriers: list[SetCarrierAnswer]

    @classmethod
    def of(cls, found: planning.CarrierSet, candidates: planning.Candidates) -> Self:
        """Return the answer for a set."""
        statistics = found.figures
        names = [candidates.carrier_ids[k] for k in found.chosen]
        carriers = [
            {
                "carrier": name,
                "leverage": float(statistics.leverage[k]),
                "undetectable_fault_db": float(statistics.undetectable_fault_db[k]),
                "fault_shift_deg": statistics.fault_shift_deg[k],
            }
            for k, name in enumerate(names)
        ]
        averaged = zip(planning.AVERAGING_SPANS_S, found.averaged_deg, strict=True)
        return super().of(
            statistics,
            selected=names,
            dop=statistics.dop_deg_per_db,
            dop_with_common=statistics.dop_with_common_deg_per_db,
            angle_dop=statistics.angle_dop_deg_per_db,
            averaged=[{"span_s": span_s, "sigma_deg": sigma} for span_s, sigma in averaged],
            transponder_share=found.transponder_share,
            sufficient=not found.shortcomings,
            shortcomings=found.shortcomings,
            carriers=carriers,
        )


class CarrierSetsAnswer(Answer):
    """Three sets side by side."""

    optimal: CarrierSetAnswer
    """Weighted A-optimal by exchange, for the robust method."""
    paper: CarrierSetAnswer
    """For each axis the stable and linear carriers that answer mostly to it."""
    all: CarrierSetAnswer
    """Every carrier that can be used."""


class TurnStepAnswer(Answer):
    """One level of the calibration turns."""

    offset_s: float
    """From the start of the turns."""
    duration_s: float
    yaw_deg: float
    roll_deg: float
    pitch_deg: float

    @classmethod
    def of(cls, step: planning.TurnStep) -> Self:
        """Return the answer for a level of turns that start at 0."""
        yaw_deg, roll_deg, pitch_deg = step.attitude_deg
        return cls(
            offset_s=step.start_us / US_PER_S,
            duration_s=(step.stop_us - step.start_us) / US_PER_S,
            yaw_deg=yaw_deg,
            roll_deg=roll_deg,
            pitch_deg=pitch_deg,
        )


class TurnsAnswer(Answer):
    """Recommended calibration turns."""

    total_s: float
    steps: list[TurnStepAnswer]

    @classmethod
    def of(cls, turns: Turns) -> Self:
        """Return the answer for the turns asked for."""
        steps = planning.turn_timetable(0, far_yaw=turns is Turns.FAR_YAW)
        return cls(total_s=steps[-1].stop_us / US_PER_S, steps=[TurnStepAnswer.of(step) for step in steps])


class FurtherCarrierAnswer(Answer):
    """A carrier that would help the chosen ones most, after those named before it."""

    carrier: str
    transponder: str
    in_plan: bool
    """false: a user to look for near that latitude and longitude, deg; only of plans with stated or assumed beams."""
    bound_ratio: AnglesAnswer
    """Bounds of one row with it over those without it; null: not determined without it."""


class MomentumGainAnswer(Answer):
    """Smallest sigma of a filter over a day, with and without the momentum of the wheels in telemetry."""

    pitch_bias_n_m_s: float
    """Momentum along pitch."""
    sigma_n_m_s: float
    """Noise of a record along an axis."""
    period_s: float
    """Time between two records."""
    without_deg: _Angles
    """By powers alone."""
    with_deg: _Angles
    """By powers and momentum."""

    @classmethod
    def of(cls, gain: planning.MomentumGain) -> Self:
        """Return the answer for a gain."""
        return super().of(gain, **gain.wheels._asdict())


class MotionGainAnswer(Answer):
    """Smallest sigma of a filter over a day by powers, and with what the catalogue states to measure motion."""

    powers_deg: _Angles
    """By powers alone."""
    rates_deg: _Angles | None
    """By powers and `onboard.rate_sensor`; null where none outside of the loop on board is stated."""
    polarization_deg: _Angles | None
    """By powers and the `polarimeters` in use; null where there is none."""
    all_deg: _Angles
    """By powers and all of these, the momentum of the wheels included."""

    @classmethod
    def of(cls, gain: planning.MotionGain) -> Self:
        """Return the answer for a gain."""
        return super().of(gain)


class CarrierSelectionAnswer(Answer):
    """A recommended subset of the carriers of a calibration."""

    rule: str
    count: int
    """Carriers asked for."""
    calibration_id: int | None
    """null: nothing was calibrated, beams and noise are assumed."""
    calibration_method: str | None
    selected: list[str]
    """In the order of choice; fewer than asked for when there are not enough."""
    condition: Figure
    dop: _Angles
    """deg per dB"""
    crlb_deg: _Angles
    """One row, with a common-mode unknown."""
    sufficient: bool
    """True: the subset has all that the robust method wants."""
    shortcomings: list[str]
    notes: list[str]
    """Cautions on the figures."""
    carriers: list[RecommendedCarrierAnswer]
    sets: CarrierSetsAnswer
    further: list[FurtherCarrierAnswer]
    """At most three that were left out of the chosen set, in the order of their effect."""
    momentum: MomentumGainAnswer | None
    """Bounds with and without the momentum of the wheels; null where neither query nor catalogue states one."""
    measured_motion: MotionGainAnswer | None
    """Bounds with rate sensor and polarimeters of the catalogue; null where it states neither."""
    turns: TurnsAnswer | None

    @classmethod
    def of(cls, found: CarrierRecommendation, turns: Turns) -> Self:
        """Return the answer for a recommendation."""
        recommendation = found.recommendation
        candidates = recommendation.candidates
        sets = {name: CarrierSetAnswer.of(one, candidates) for name, one in recommendation.sets.items()}
        chosen = sets[recommendation.rule.value]
        return cls(
            rule=recommendation.rule.value,
            count=found.count,
            calibration_id=found.calibration_id,
            calibration_method=found.calibration_method,
            selected=chosen.selected,
            condition=chosen.condition,
            dop=chosen.dop,
            crlb_deg=chosen.crlb_deg,
            sufficient=chosen.sufficient,
            shortcomings=chosen.shortcomings,
            notes=list(found.notes),
            carriers=[RecommendedCarrierAnswer.of(recommendation, k) for k in range(len(candidates.carrier_ids))],
            sets=CarrierSetsAnswer(**sets),
            further=[FurtherCarrierAnswer.of(one) for one in recommendation.further],
            momentum=None if found.momentum is None else MomentumGainAnswer.of(found.momentum),
            measured_motion=None if found.measured_motion is None else MotionGainAnswer.of(found.measured_motion),
            turns=None if turns is Turns.NONE else TurnsAnswer.of(turns),
        )
