"""Analyses: parameters of pure computations and what they give. Angles of the flexible spacecraft are in radians."""

import math
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field

from service.api.schemas.base import OF_ARRAY, Answer, Document
from service.api.schemas.record_answers import members_of
from service.core.flexible.capture.capture import StableBand
from service.core.flexible.capture.capture_analysis import CaptureAnalysis
from service.core.flexible.closed_forms import SinglePulseForms
from service.core.flexible.limit_cycle import LimitCycleAnalysis
from service.core.flexible.schedule.schedule_check import ScheduleCheck, Suggestion

#: keeps every sum and product of the analyses inside a double
_LARGEST = 1e9
Quantity = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]


def _finite_or_none(value: Any) -> Any:
    """Return None for what is not finite: there is none, or it is unbounded."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


Finding = Annotated[float | None, BeforeValidator(_finite_or_none)]


class LimitCycleDocument(Document):
    """One axis with a wheel and a position relay of pulses."""

    inertia_kg_m2: Quantity
    motor_torque_n_m: Quantity
    dry_friction_n_m: Quantity
    viscous_loss_n_m: Quantity = 0.0
    """At the momentum limit."""
    momentum_limit_n_m_s: Quantity = 20.0
    momentum_n_m_s: Quantity
    """Of the rotor while the body is at rest."""
    alpha_rad: Quantity
    """Line of release."""
    beta_rad: Quantity
    """First line of switching on."""
    pulse_s: Quantity
    pulse_count: Annotated[int, Field(ge=1, le=64)] = 1
    line_step_rad: Quantity = 0.0
    external_torque_n_m: Quantity = 0.0
    start_speed_rad_s: Quantity | None = None
    """First arrival of the ladder; default: near half the speed of a pulse."""
    returns: Annotated[int, Field(ge=1, le=500)] = 50
    map_points: Annotated[int, Field(ge=2, le=1000)] = 200


class LimitCycleFoundAnswer(Answer):
    """One periodic motion."""

    speed_rad_s: float
    """At the first line."""
    period_s: float
    inner_rad: float
    outer_rad: float
    rate_rad_s: float
    pulses: int
    multiplier: Finding
    is_stable: bool
    momentum_n_m_s: tuple[float, float]
    """Least and greatest."""
    is_momentum_consistent: bool
    """False: the rotor would stop or saturate, and the figures do not belong to this drive."""


class CycleOverBothLinesAnswer(Answer):
    """One periodic motion that visits both lines, equation (24)."""

    speed_rad_s: float
    """At the first line of the side to which friction turns the body, coming from the other side."""
    period_s: float
    pulses: tuple[int, int]
    """On that side, on the other side."""
    outer_rad: float
    rate_rad_s: float
    multiplier: Finding
    is_stable: bool


class SinglePulseAnswer(members_of(SinglePulseForms, number=Finding), Answer):
    """Closed forms of the cycle of one pulse."""


class LimitCycleAnswer(Answer):
    """Cycles, closed forms, succession function and ladder of one axis."""

    cycles: list[LimitCycleFoundAnswer]
    """On one side."""
    cycles_over_both_lines: list[CycleOverBothLinesAnswer]
    reason: str
    """For which `cycles` is empty; empty where it is not."""
    forms: SinglePulseAnswer
    passive_rad_s2: float
    pulse_rad_s2: float
    speeds_rad_s: Annotated[list[float], OF_ARRAY]
    next_speeds_rad_s: Annotated[list[Finding], OF_ARRAY]
    ladder_rad_s: Annotated[list[tuple[float, float]], OF_ARRAY]
    """Corners of the Koenigs-Lamerey diagram from the chosen start."""

    @classmethod
    def of(cls, found: LimitCycleAnalysis) -> Self:
        """Return the answer for an analysis."""
        over_both = [
            {**cycle.motion._asdict(), "multiplier": cycle.multiplier, "is_stable": cycle.is_stable}
            for cycle in found.cycles_over_both_lines
        ]
        return super().of(found, cycles_over_both_lines=over_both)


class CaptureDocument(Document):
    """One switching of a regulator while a flexible mode swings."""

    omega_rad_s: Quantity
    damping_ratio: Quantity
    """Below 1; 0: as in the derivation of the boundary."""
    coupling: Quantity
    inertia_kg_m2: Quantity
    motor_torque_n_m: Quantity
    friction_torque_n_m: Quantity = 0.0
    alpha_rad: Quantity
    beta_rad: Quantity
    pulse_s: Quantity | None = None
    """Length of a pulse; null: a relay."""
    rate_rad_s: Quantity = 0.0
    amplitude_rad: Quantity = 0.0
    """Swing of the mode at the hub before the switching."""
    is_friction_outward: bool = True


class StableBandAnswer(members_of(StableBand, number=Finding), Answer):
    """Frequencies of the mode without capture; both null: none, upper null: unbounded."""


class CaptureAnswer(
    members_of(
        CaptureAnalysis,
        number=Finding,
        types={"band": StableBandAnswer},
        descriptions={
            "verdict": "captured, free, or always: any switching is captured.",
            "p_inf_rad": "Null: unbounded, a relay on a mode without damping.",
            "perpetual_capture": "none, irregular or possible.",
        },
    ),
    Answer,
):
    """Limit of capture and the verdict on the oscillation."""


class PulseDocument(Document):
    """Torque on the body, constant for a while."""

    start_s: Quantity
    duration_s: Quantity
    torque_n_m: Quantity


class HubModeDocument(Document):
    """One flexible mode that the axis feels."""

    omega_rad_s: Quantity
    damping_ratio: Quantity
    coupling: Quantity


class PhasorDocument(Document):
    """Swing of a mode at time zero, rad: real and imaginary part."""

    re: Quantity
    im: Quantity


class ScheduleDocument(Document):
    """A torque schedule of one axis, and what it meets."""

    pulses: Annotated[list[PulseDocument], Field(min_length=1, max_length=500)]
    inertia_kg_m2: Quantity
    modes: Annotated[list[HubModeDocument], Field(min_length=1, max_length=16)]
    peak_allowed_rad: Quantity
    alpha_rad: Quantity | None = None
    beta_rad: Quantity | None = None
    pulse_s: Quantity | None = None
    """Length of a pulse of the regulator on board; null: a relay."""
    motor_torque_n_m: Quantity | None = None
    friction_torque_n_m: Quantity = 0.0
    rate_rad_s: Quantity = 0.0
    momentum_n_m_s: Quantity = 0.0
    momentum_limit_n_m_s: Quantity | None = None
    carried: Annotated[list[PhasorDocument], Field(max_length=16)] | None = None
    """Swing that the schedule before left, one a mode; null: at rest."""


class PhasorAnswer(Answer):
    """Swing of a mode, rad: real and imaginary part."""

    re: float
    im: float


class SuggestionAnswer(
    members_of(Suggestion, number=float, descriptions={"kind": "split, width, interval or wait."}), Answer
):
    """One change of the schedule and what it would give."""


class ScheduleAnswer(Answer):
    """Verdict on a torque schedule."""

    verdict: str
    """accept, warn or reject."""
    reasons: list[str]
    peak_rad: float
    """Worst over +-15 % of each frequency, summed over the modes."""
    residual_rad: float
    swing_rad: float
    p_cr_rad: Finding
    margin_rad: Finding
    p_inf_rad: Finding
    worst_mode: int
    worst_omega_rad_s: float
    momentum_n_m_s: tuple[float, float]
    suggestions: list[SuggestionAnswer]
    nominal_peak_rad: list[float]
    phasors: list[PhasorAnswer]
    """At `end_s`, to be carried to the next schedule."""
    end_s: float

    @classmethod
    def of(cls, found: ScheduleCheck) -> Self:
        """Return the answer for a check."""
        return super().of(found, phasors=[{"re": phasor.real, "im": phasor.imag} for phasor in found.phasor_rad])
