"""Carriers to choose from: what a calibration knows of them, in the form that planning takes.

A carrier that no rule may choose is refused with its first reason. Criteria that only the paper's rule asks for are
kept apart, because the robust method follows curved beams and weighs unsteady users instead of leaving them out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.core.estimation.calibration.coloured_rows import ColouredNoise
from service.records.calibration import CalibrationResult, CarrierCalibration
from service.records.catalogue import CarrierPlan
from service.records.levels.attitude import BoolArray, FloatArray, IntArray

#: fewest carriers that determine three angles and a common level
MIN_USABLE = 4
NOT_USABLE = "not usable for attitude: disabled, a beacon, or under uplink power control"
GONE = "no longer in the carrier plan"
NOT_MEASURED = "the calibration has no sensitivity of it for every axis"


@dataclass(frozen=True)
class Candidates:
    """N carriers to choose from; NaN = not known."""

    carrier_ids: tuple[str, ...]
    transponders: tuple[str, ...]
    #: (N, 3)
    sensitivity_db_per_deg: FloatArray
    noise: ColouredNoise
    #: (N,) rms after the daily harmonic, dB, and departure from a straight line, deg
    residual_rms_db: FloatArray
    nonlinearity_deg: FloatArray
    #: (N,) number of the level that a carrier shares, -1 = the one common to all that no level control holds
    level: IntArray
    #: why no rule may choose a carrier; empty = it may be chosen
    refusals: tuple[tuple[str, ...], ...]
    #: why the paper's rule may not
    paper_refusals: tuple[tuple[str, ...], ...]

    @property
    def sigma_db(self) -> FloatArray:
        """(N,) noise of one row, correlated parts included."""
        return np.asarray(np.sqrt(self.noise.white_db**2 + np.sum(self.noise.sigma_db**2, axis=1)))

    @property
    def is_usable(self) -> BoolArray:
        """(N,) whether a rule may choose the carrier."""
        return np.array([not refusal for refusal in self.refusals], dtype=np.bool_)

    @property
    def transponder_numbers(self) -> IntArray:
        """(N,) number of each carrier's transponder."""
        names = sorted(set(self.transponders))
        return np.array([names.index(name) for name in self.transponders], dtype=np.int64)

    def joined(self, others: "Candidates") -> "Candidates":
        """Return these and other carriers, whose noise has as many parts."""
        return Candidates(
            self.carrier_ids + others.carrier_ids,
            self.transponders + others.transponders,
            np.vstack([self.sensitivity_db_per_deg, others.sensitivity_db_per_deg]),
            ColouredNoise(*(np.concatenate(parts) for parts in zip(self.noise, others.noise, strict=True))),
            np.concatenate([self.residual_rms_db, others.residual_rms_db]),
            np.concatenate([self.nonlinearity_deg, others.nonlinearity_deg]),
            np.concatenate([self.level, others.level]),
            self.refusals + others.refusals,
            self.paper_refusals + others.paper_refusals,
        )


def candidates_of(result: CalibrationResult, plan: CarrierPlan) -> Candidates:
    """Return the carriers of a calibration; the newest plan says which may be used and who shares a transponder."""
    known = {carrier.id: carrier for carrier in plan.carriers}
    carriers = result.carriers
    sensitivity = np.array([carrier.sensitivity_db_per_deg for carrier in carriers], dtype=np.float64).reshape(-1, 3)
    noise = _identified_noise(carriers)
    is_kept = result.geometry.is_used if result.geometry is not None else (True,) * len(carriers)
    refusals = []
    for k, carrier in enumerate(carriers):
        texts = (
            (carrier.id in known, GONE),
            (carrier.id not in known or known[carrier.id].is_usable_for_attitude, NOT_USABLE),
            (bool(np.isfinite(sensitivity[k]).all()), NOT_MEASURED),
            (bool(np.isfinite(noise.white_db[k])), "the calibration has not learned its noise"),
            (is_kept[k], f"the calibration leaves it out: {_rejection(carrier)}"),
        )
        # the first reason is enough: what is not measured was rarely usable
        refusals.append(tuple(text for is_met, text in texts if not is_met)[:1])
    return Candidates(
        tuple(carrier.id for carrier in carriers),
        tuple(known[c.id].transponder if c.id in known else "" for c in carriers),
        sensitivity,
        noise,
        np.array([carrier.stability_residual_rms_db for carrier in carriers], dtype=np.float64),
        np.array([carrier.nonlinearity_deg for carrier in carriers], dtype=np.float64),
        _levels(result),
        tuple(refusals),
        tuple(_unmet_criteria(carrier) for carrier in carriers),
    )


def _levels(result: CalibrationResult) -> IntArray:
    """Return the level that each carrier shares; a transponder under level control has its own."""
    groups = result.geometry.alc_group if result.geometry is not None else ()
    return np.array(groups or (-1,) * len(result.carriers), dtype=np.int64)


def _identified_noise(carriers: Sequence[CarrierCalibration]) -> ColouredNoise:
    """Return the noise of calibrated carriers; where it was not split, all of the residual counts as white."""
    size = max([1, *(len(carrier.noise) for carrier in carriers)])
    sigma, tau = np.zeros((len(carriers), size)), np.ones((len(carriers), size))
    white = np.array([carrier.sigma_white_db for carrier in carriers], dtype=np.float64)
    for k, carrier in enumerate(carriers):
        for position, part in enumerate(carrier.noise):
            if math.isfinite(part.sigma_db) and part.correlation_time_s > 0.0:
                sigma[k, position], tau[k, position] = part.sigma_db, part.correlation_time_s
    rms = np.array([carrier.harmonic.rms_db for carrier in carriers], dtype=np.float64)
    return ColouredNoise(np.where(np.isfinite(white), white, rms), sigma, tau)


def _rejection(carrier: CarrierCalibration) -> str:
    """Return why the robust method must not use a carrier; reasons of the paper's rule are told apart from it."""
    mark = "robust: "
    own = [reason.removeprefix(mark) for reason in carrier.rejected_because if reason.startswith(mark)]
    return "; ".join(own or carrier.rejected_because) or "no reason kept"


def _unmet_criteria(carrier: CarrierCalibration) -> tuple[str, ...]:
    """Return which criteria of the paper a carrier fails, with its figures."""
    texts = (
        ("stable", f"not stable: rms {carrier.stability_residual_rms_db:.3f} dB"),
        ("linear", f"not linear: departs {carrier.nonlinearity_deg:.3f} deg"),
    )
    return tuple(text for name, text in texts if name not in carrier.criteria_met)
