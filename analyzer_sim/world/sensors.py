"""Sensors: attitude references with white noise and a wandering bias. The ground hears them until operation begins.

A sensor tells some axes and is silent about the others (NaN); it may work in sessions. Each draws from the stream of
its name, so that one sensor more moves no other.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.streams import FloatArray, first_order, stream
from analyzer_sim.world.orbit import EpochArray

_US_PER_MIN = 60_000_000
_NONE = float("nan")


@dataclass(frozen=True, slots=True)
class Sensor:
    """Attitude sensor; triples in the order yaw, roll, pitch, NaN = the axis is not measured."""

    #: as the interface names it
    source: str
    #: white noise of a reference, deg
    sigma_deg: tuple[float, float, float]
    #: wander of the bias, deg, and its correlation time
    bias_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bias_tau_s: float = 6 * 3600.0
    #: length of a session and time from one to the next, minutes; 0 = without a break
    session_min: float = 0.0
    every_min: float = 60.0


STAR_TRACKER = Sensor("star_tracker", (0.015, 0.008, 0.008))
EARTH_SENSOR = Sensor("earth_sensor", (_NONE, 0.03, 0.03), bias_deg=(0.0, 0.01, 0.01))
RADIO_BEACON = Sensor("radio_beacon", (0.1, _NONE, _NONE), session_min=20.0)


@dataclass(frozen=True, slots=True)
class References:
    """Attitudes measured by the sensors, in order of epoch."""

    #: (R,) microseconds
    epochs_us: EpochArray
    #: (R, 3) deg, order yaw, roll, pitch; NaN = not told
    attitude_deg: FloatArray
    #: (R, 3) deg, NaN likewise
    sigma_deg: FloatArray
    #: (R,) names
    source: NDArray[np.str_]

    def of(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "References":
        """Return the rows of a mask or of places."""
        return References(self.epochs_us[rows], self.attitude_deg[rows], self.sigma_deg[rows], self.source[rows])


def references(sensors: tuple[Sensor, ...], seed: int, epochs_us: EpochArray, attitude_deg: FloatArray) -> References:
    """Return at most one reference a row and sensor."""
    reported = [_reported(sensor, seed, epochs_us, attitude_deg) for sensor in sensors]
    series = References(
        np.concatenate([one.epochs_us for one in reported]),
        np.concatenate([one.attitude_deg for one in reported]),
        np.concatenate([one.sigma_deg for one in reported]),
        np.concatenate([one.source for one in reported]),
    )
    order = np.argsort(series.epochs_us, kind="stable")
    return series.of(order)


def _reported(sensor: Sensor, seed: int, epochs_us: EpochArray, attitude_deg: FloatArray) -> References:
    name, count = sensor.source.replace("_", " "), len(epochs_us)
    noise = stream(seed, name).normal(size=(count, 3)) * np.array(sensor.sigma_deg)
    step_s = float(epochs_us[1] - epochs_us[0]) / 1e6 if count > 1 else 1.0
    bias = np.stack(
        [
            first_order(stream(seed, name, "bias", axis), count, step_s, sigma, sensor.bias_tau_s)
            for axis, sigma in zip(("yaw", "roll", "pitch"), sensor.bias_deg, strict=True)
        ],
        axis=1,
    )
    works = _in_session(sensor, epochs_us)
    reported = np.round(attitude_deg + noise + bias, 6)[works]
    sigma_deg = np.broadcast_to(np.array(sensor.sigma_deg), reported.shape)
    return References(epochs_us[works], reported, sigma_deg, np.full(len(reported), sensor.source))


def _in_session(sensor: Sensor, epochs_us: EpochArray) -> NDArray[np.bool_]:
    """Tell at which epochs (T,) the sensor works; sessions count from the first epoch."""
    if sensor.session_min <= 0.0 or not len(epochs_us):
        return np.ones(len(epochs_us), dtype=np.bool_)
    minutes = (epochs_us - epochs_us[0]) / _US_PER_MIN
    return np.asarray(minutes % sensor.every_min < sensor.session_min)
