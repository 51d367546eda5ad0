"""Snapshot fix, L2 to L3: the averaged deviation of the selected carriers solved for yaw, roll and pitch.

The paper's system with sign-dependent coefficients, equation (2), by sign-constrained least squares over the eight
octants; carriers hit by uplink rain are left out first. With fewer carriers than unknowns plus one the fix is NaN.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from service.core.estimation.noise_model import averaged_sigma_db
from service.core.estimation.paper.downlink_fade import median_of
from service.core.estimation.paper.octants import OctantFix, predict_deviation_db
from service.core.estimation.paper.rejection import RejectionReason, reject_faded_carriers
from service.pipeline.config import EstimationConfig
from service.records.calibration import Calibration
from service.records.levels.attitude import AttitudeFix, BoolArray, Exclusion, FloatArray, IntArray

# numbers: a member of an enumeration is compared at the cost of an array
_USED, _ABSENT = int(RejectionReason.USED), int(RejectionReason.ABSENT)


@dataclass(frozen=True)
class SensitivityModel:
    """Sensitivities and noise of the carriers of a calibration, as arrays."""

    carrier_ids: tuple[str, ...]
    #: (N, 3) dB/deg for positive and negative angles
    plus_db_per_deg: FloatArray
    minus_db_per_deg: FloatArray
    #: (N,) whether the carrier enters the fix
    is_selected: BoolArray
    #: (N,) dB
    sigma_white_db: FloatArray
    #: (N, C) dB and s, zeros where a carrier has fewer parts
    sigma_coloured_db: FloatArray
    correlation_time_s: FloatArray


def sensitivity_model(calibration: Calibration) -> SensitivityModel:
    """Return the arrays of a finished calibration."""
    carriers = calibration.result.carriers if calibration.result else ()
    most = max((len(carrier.noise) for carrier in carriers), default=0)
    sigma_db, time_s = np.zeros((len(carriers), most)), np.zeros((len(carriers), most))
    for k, carrier in enumerate(carriers):
        for position, part in enumerate(carrier.noise):
            sigma_db[k, position], time_s[k, position] = part.sigma_db, part.correlation_time_s
    return SensitivityModel(
        tuple(carrier.id for carrier in carriers),
        np.array([carrier.sensitivity_plus_db_per_deg for carrier in carriers], dtype=np.float64).reshape(-1, 3),
        np.array([carrier.sensitivity_minus_db_per_deg for carrier in carriers], dtype=np.float64).reshape(-1, 3),
        np.array([carrier.selected for carrier in carriers], dtype=np.bool_),
        np.array([carrier.sigma_white_db for carrier in carriers], dtype=np.float64),
        sigma_db,
        time_s,
    )


def answer_db(model: SensitivityModel, angles_deg: FloatArray) -> FloatArray:
    """Return the calibrated change (T, N) in dB at attitudes (T, 3); an axis without coefficients changes nothing."""
    plus, minus = np.nan_to_num(model.plus_db_per_deg), np.nan_to_num(model.minus_db_per_deg)
    return predict_deviation_db(plus, minus, angles_deg)


def solve_attitude(
    epoch_us: int, deviation_db: FloatArray, rows: int, span_s: float, model: SensitivityModel, config: EstimationConfig
) -> AttitudeFix:
    """Return the fix of one deviation that is the mean of some rows over a span."""
    considered_db = np.where(model.is_selected, deviation_db, np.nan)
    noise = model.sigma_white_db, model.sigma_coloured_db, model.correlation_time_s
    sigma_db = _averaged_sigma_db(*(values.tobytes() for values in noise), model.sigma_coloured_db.shape, rows, span_s)
    outcome = reject_faded_carriers(
        model.plus_db_per_deg,
        model.minus_db_per_deg,
        considered_db,
        gate_db=config.uplink_gate_db,
        gate_sigma=config.gate_sigma,
        min_carriers=config.min_carriers,
    )
    # a carrier without all its coefficients took no part, whatever its level
    is_used = outcome.reason == _USED
    return AttitudeFix(
        epoch_us,
        outcome.fix.attitude_deg,
        outcome.fix.covariance_deg2 * _variance_ratio(outcome.fix, sigma_db[is_used])
        + _common_covariance_deg2(model, outcome.fix.attitude_deg, considered_db, is_used),
        outcome.residual_db,
        sigma_db,
        int(np.count_nonzero(is_used)),
        _exclusions(model, outcome.reason),
    )


@lru_cache(maxsize=256)
def _averaged_sigma_db(
    white: bytes, coloured: bytes, times: bytes, shape: tuple[int, ...], rows: int, span_s: float
) -> FloatArray:
    """Return one standard deviation (N,) of the mean of some rows, dB: from row to row it hardly ever changes."""
    parts = (np.frombuffer(each).reshape(shape) for each in (coloured, times))
    sigma_db = averaged_sigma_db(np.frombuffer(white), *parts, rows=rows, span_s=span_s)
    sigma_db.setflags(write=False)
    return sigma_db


def _variance_ratio(fix: OctantFix, sigma_db: FloatArray) -> float:
    """Return by how much the covariance of a fix must grow to be honest, 1 at least.

    Unweighted least squares scales its covariance by the scatter of the residuals. Where a few of them happen to agree
    better than the learned noise of the carriers allows, the learned noise holds.
    """
    scatter_db2 = fix.cost / max(fix.carriers_used - 3, 1)
    known_db = sigma_db[np.isfinite(sigma_db)]
    known_mean_db2 = float((known_db**2).sum()) / len(known_db) if len(known_db) else 0.0
    return max(1.0, known_mean_db2 / scatter_db2) if scatter_db2 > 0.0 else 1.0


def _common_covariance_deg2(
    model: SensitivityModel, attitude_deg: FloatArray, deviation_db: FloatArray, is_used: BoolArray
) -> FloatArray:
    """Return the covariance (3, 3) that a fix has if what its levels have in common is no attitude, deg^2.

    A fade too shallow for the rule of one sign turns the angles by as much as its median does.
    """
    if not is_used.any():
        return np.zeros((3, 3))
    slope = np.where(attitude_deg < 0.0, model.minus_db_per_deg, model.plus_db_per_deg)[is_used]
    common_db = np.full(len(slope), median_of(deviation_db[is_used]))
    turned_deg = np.linalg.lstsq(slope, common_db, rcond=None)[0]
    return np.asarray(np.outer(turned_deg, turned_deg))


def _exclusions(model: SensitivityModel, reason: IntArray) -> tuple[Exclusion, ...]:
    """Return the selected carriers that did not enter, each with its reason."""
    is_out = model.is_selected & (reason != _USED)
    return tuple(
        Exclusion(model.carrier_ids[k], "absent" if reason[k] == _ABSENT else "uplink_fade")
        for k in is_out.nonzero()[0].tolist()
    )
