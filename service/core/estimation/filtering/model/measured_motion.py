"""Motion of the body measured by a rate sensor outside of the loop on board, in place of the inertial model.

    yaw' = -w roll + z_yaw + e_yaw      roll' = w yaw + z_roll + e_roll      pitch' = z_pitch + e_pitch

z is the measured inertial rate of the body about its axes, pitch without the turn of the orbit, deg/h; e = - bias of
the sensor. z stands in the states of the rate and e in those of the drift, so that whatever reads a rate from the state
reads that of the body. What was commanded is in z: nothing of it is added. The law of this file: yaw and roll exchange
by the orbit, whatever mode is flown; order yaw, roll, pitch.
"""

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.filtering.model.filter_model import (
    DRIFT,
    RATE,
    RATE_FLOOR_DEG_H,
    FilterSettings,
    Gaussian,
    RateSensorModel,
)

#: exchange of roll and yaw in the orbital frame, 1/h
ORBITAL_RATE_PER_H = 0.2625162


def measured_settings(settings: FilterSettings, sensor: RateSensorModel) -> FilterSettings:
    """Return the settings of a step whose rate is measured: bias in place of drift, the true exchange."""
    bias = sensor.bias_deg_h
    return settings._replace(
        coupling_per_h=ORBITAL_RATE_PER_H,
        drift_deg_h=(bias, bias, bias),
        drift_tau_h=sensor.bias_tau_h,
        rate_noise_deg_sqrt_h=sensor.noise_deg_sqrt_h,
    )


def with_measured_rate(gaussian: Gaussian, measured_deg_h: FloatArray) -> Gaussian:
    """Return the state whose rate (3,) is the measured one; the step by it makes it known exactly but for the bias."""
    mean = gaussian.mean.copy()
    mean[RATE] = measured_deg_h
    return Gaussian(mean, gaussian.covariance)


def with_sensor_bias(gaussian: Gaussian, bias_deg_h: float) -> Gaussian:
    """Return the state whose drift becomes the bias of the sensor, of which only its size is known."""
    return _with_block(gaussian, DRIFT, np.zeros(3), np.full(3, bias_deg_h))


def with_inertial_drift(gaussian: Gaussian, commanded_deg_h: FloatArray, residual_deg_h: FloatArray) -> Gaussian:
    """Return the state that goes on by the inertial model; its drift is what was beside the commanded rate (3,)."""
    mean = gaussian.mean.copy()
    mean[DRIFT] += residual_deg_h
    return _with_block(Gaussian(mean, gaussian.covariance), RATE, commanded_deg_h, np.full(3, RATE_FLOOR_DEG_H))


def with_unknown_drift(gaussian: Gaussian, commanded_deg_h: FloatArray, drift_deg_h: FloatArray) -> Gaussian:
    """Return the state that goes on by the inertial model, of whose drift (3,) nothing is known."""
    drifting = _with_block(gaussian, DRIFT, np.zeros(3), drift_deg_h)
    return _with_block(drifting, RATE, commanded_deg_h, np.full(3, RATE_FLOOR_DEG_H))


def _with_block(gaussian: Gaussian, positions: slice, value: FloatArray, sigma: FloatArray) -> Gaussian:
    """Return the state in which three numbers are others, correlated with nothing."""
    mean, covariance = gaussian.mean.copy(), gaussian.covariance.copy()
    mean[positions] = value
    covariance[positions, :] = covariance[:, positions] = 0.0
    covariance[positions, positions] = np.diag(sigma**2)
    return Gaussian(mean, covariance)
