"""Candidates among the carriers, and what wheel momentum adds to them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.core.estimation.attitude_bound import DriftStatistics, WheelStatistics, attitude_bound_deg
from service.core.estimation.calibration.whitened_fit import ColouredNoise
from service.pipeline.inputs.known_motion import rate_sensor_model
from service.pipeline.inputs.polarization import learned_feed, polarimeter_models, used_polarimeters
from service.records.calibration import CalibrationResult, CarrierCalibration, FeedFit
from service.records.catalogue import AxisTorques, CarrierPlan, FedForwardTorque, Spacecraft, WheelMomentum
from service.records.levels.attitude import Axes, BoolArray, FloatArray, IntArray, named_axes

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


#: time between records where none is stated, s
WHEEL_PERIOD_S = 300.0
#: what three quiet days tell of a feed: offset, daily cosine and sine, one sigma of 0.02 and 0.01 deg
_QUIET_FEED = FeedFit((0.0, 0.0, 0.0), ((4e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (0.0, 0.0, 1e-4)), 0.0, 0.0, 0)


class MomentumGain(NamedTuple):
    """Bounds of a filter over a day, one sigma, by a set of carriers."""

    wheels: WheelStatistics
    #: deg; NaN = the carriers do not determine it
    without_deg: Axes
    with_deg: Axes


class MotionGain(NamedTuple):
    """Bounds of a filter over a day, one sigma, deg, by a set of carriers and what the catalogue states beside them.

    NaN = the carriers do not determine it; None = nothing is stated.
    """

    powers_deg: Axes
    rates_deg: Axes | None
    polarization_deg: Axes | None
    #: wheels, rates and polarimeters together
    all_deg: Axes


def stated_wheels(
    stated: WheelMomentum | None, bias_n_m_s: float | None, sigma_n_m_s: float | None, period_s: float
) -> WheelStatistics | None:
    """Return the wheels by the options given, else by the catalogue; None where neither states a momentum."""
    known = stated or WheelMomentum()
    bias = known.pitch_bias_n_m_s if bias_n_m_s is None else bias_n_m_s
    if bias is None:
        return None
    wheels = WheelStatistics(bias, sigma_n_m_s or known.sigma_n_m_s, period_s, known.misalignment_deg)
    return wheels if known.torque is None else wheels._replace(torque_error_n_m=_error_n_m(known.torque))


def momentum_gain(candidates: Candidates, chosen: IntArray, wheels: WheelStatistics) -> MomentumGain:
    """Return the bounds by some carriers; their noise is that of a row a minute."""
    powers = _powers(candidates, chosen)
    bounds = (attitude_bound_deg(*powers, one) for one in (None, wheels))
    without_deg, with_deg = (named_axes(bound) for bound in bounds)
    return MomentumGain(wheels, without_deg, with_deg)


def motion_gain(
    candidates: Candidates, chosen: IntArray, spacecraft: Spacecraft, wheels: WheelStatistics | None
) -> MotionGain | None:
    """Return the bounds by some carriers; None where neither a rate sensor nor a polarimeter is stated and used."""
    sensor, stated = rate_sensor_model(spacecraft), used_polarimeters(spacecraft)
    if sensor is None and not stated:
        return None
    powers, models = _powers(candidates, chosen), polarimeter_models(spacecraft, stated)
    # references come from quiet days, and so does what they tell of a feed
    feeds = [learned_feed(_QUIET_FEED, one, 0) for one in stated]
    read = tuple(one._replace(learned=feed) for one, feed in zip(models, feeds, strict=True))
    bias = None if sensor is None else (sensor.bias_deg_h, sensor.bias_deg_h, sensor.bias_deg_h)
    drift = (
        None if sensor is None or bias is None else DriftStatistics(bias, sensor.bias_tau_h, sensor.noise_deg_sqrt_h)
    )
    return MotionGain(
        named_axes(attitude_bound_deg(*powers)),
        None if drift is None else named_axes(attitude_bound_deg(*powers, drift=drift)),
        named_axes(attitude_bound_deg(*powers, polarimeters=read)) if read else None,
        named_axes(attitude_bound_deg(*powers, wheels, drift, read)),
    )


def _powers(candidates: Candidates, chosen: IntArray) -> tuple[FloatArray, ColouredNoise]:
    """Return slopes and noise of some carriers."""
    return candidates.sensitivity_db_per_deg[chosen], ColouredNoise(*(part[chosen] for part in candidates.noise))


def _error_n_m(profile: FedForwardTorque) -> float:
    """Return one sigma of what a profile has wrong: its relative error of the rms of its parts along roll and yaw."""
    parts = (profile.constant_n_m, profile.cosine_n_m, profile.sine_n_m)
    size_n_m = float(np.sqrt(np.mean([_across(part) ** 2 for part in parts])))
    return math.hypot(profile.relative_error, profile.axis_relative_error) * size_n_m


def _across(torque: AxisTorques) -> float:
    return math.hypot(torque.roll, torque.yaw) / math.sqrt(2.0)
