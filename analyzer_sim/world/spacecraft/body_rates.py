"""Body rates: what a rate sensor beside the loop on board tells of the flown attitude.

    w = S (roll', pitch', yaw') - w0 C e_y        inertial rate in body axes; C e_y as in `body_dynamics`
    told = w + bias + noise                       mean since the row before; S of the sequence yaw, pitch, roll

The bias is a first-order process, the noise an angle random walk. Columns yaw, roll, pitch; deg/s.
"""

import math

import numpy as np

from analyzer_sim.epochs import US_PER_S
from analyzer_sim.streams import FloatArray, stream
from analyzer_sim.world.noise import first_order
from analyzer_sim.world.orbit.orbit import EARTH_RATE_RAD_S, EpochArray
from analyzer_sim.world.scenario.story import RateTelemetry
from analyzer_sim.world.spacecraft.body_dynamics import orbit_normal_in_body

_AXES = ("yaw", "roll", "pitch")


def reported_rates(
    figures: RateTelemetry, seed: int, row_period_s: float, epochs_us: EpochArray, attitude_deg: FloatArray
) -> FloatArray:
    """Return the rates (T, 3) that are told at epochs (T,) of attitudes (T, 3); the first row repeats the second."""
    count, hours = len(epochs_us), row_period_s / 3600.0
    sigma = figures.bias_factor * figures.bias_deg_h
    tau_s = 3600.0 * figures.bias_tau_h
    bias = [first_order(stream(seed, "rate bias", axis), count, row_period_s, sigma, tau_s) for axis in _AXES]
    noise = figures.noise_deg_sqrt_h / math.sqrt(hours) * stream(seed, "rate noise").normal(size=(count, 3))
    error_deg_s = (np.stack(bias, axis=1) + noise) / 3600.0
    return np.asarray(np.round(true_rates(epochs_us, attitude_deg) + error_deg_s, 10))


def true_rates(epochs_us: EpochArray, attitude_deg: FloatArray) -> FloatArray:
    """Return the mean inertial rates (T, 3) of the body from each row to the next; the first row repeats the second."""
    attitude = np.radians(attitude_deg)
    seconds = np.diff(epochs_us) / US_PER_S
    gained, middle = np.diff(attitude, axis=0) / seconds[:, None], 0.5 * (attitude[1:] + attitude[:-1])
    rates = [_rate(*both) for both in zip(gained.tolist(), middle.tolist(), strict=True)]
    return np.asarray(np.degrees([rates[0], *rates]))


def _rate(gained: list[float], attitude: list[float]) -> tuple[float, float, float]:
    """Return the inertial rate about yaw, roll, pitch, rad/s, of angles yaw, roll, pitch that change."""
    (yaw_rate, roll_rate, pitch_rate), (yaw, roll, pitch) = gained, attitude
    x, y, z = orbit_normal_in_body(roll, pitch, yaw)
    cosine, sine = math.cos(roll), math.sin(roll)
    about_x = roll_rate - math.sin(pitch) * yaw_rate
    about_y = cosine * pitch_rate + math.cos(pitch) * sine * yaw_rate
    about_z = math.cos(pitch) * cosine * yaw_rate - sine * pitch_rate
    return about_z - EARTH_RATE_RAD_S * z, about_x - EARTH_RATE_RAD_S * x, about_y - EARTH_RATE_RAD_S * y
