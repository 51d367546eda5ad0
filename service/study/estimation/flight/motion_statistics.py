"""True statistics of measured motion, as the simulator states them beside a world; sizes are one standard deviation."""

import json
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydantic import TypeAdapter

from service.records.levels.attitude import FloatArray


@dataclass(frozen=True)
class TrueWheels:
    """Reports of the wheels' momentum, and the torque that gathers in them."""

    #: momentum along pitch that an unloading restores, and what it leaves along roll and yaw
    bias_n_m_s: float
    unloaded_n_m_s: float
    unloading_us: tuple[int, ...]
    #: of a report: noise, momentum of a step of its digits, misalignment and relative scale of each axis
    noise_n_m_s: float
    quantum_n_m_s: float
    misalignment_deg: float
    scale_error: float
    #: share of the stated profile that all axes have wrong, and that of each axis
    profile_error: float
    axis_profile_error: float
    #: (3,) along roll, pitch, yaw: constant torque and amplitude of the daily wave; that of half a day as a share of it
    constant_n_m: tuple[float, float, float]
    torque_n_m: tuple[float, float, float]
    half_day_share: float
    #: torque of first order
    unknown_n_m: float
    unknown_tau_s: float


@dataclass(frozen=True)
class TrueRates:
    """Rate sensor beside the loop."""

    #: bias of first order as stated, and how many times as large it is
    bias_deg_h: float
    bias_tau_h: float
    bias_factor: float
    #: angle random walk
    noise_deg_sqrt_h: float


@dataclass(frozen=True)
class TruePolarimeter:
    """Polarimeter at the receiving site."""

    #: (3,) turn that it follows by yaw, roll, pitch, deg/deg
    sight: tuple[float, float, float]
    feed_offset_deg: float
    white_deg: float
    #: amplitudes of the constant leakage and of its daily wave; its wander, and its drift in operation
    leakage_deg: float
    daily_deg: float
    wander_deg: float
    wander_tau_s: float
    leak_drift_deg_h: float
    #: of the reported electron content, relative; the true one is so many times as large from an epoch on
    map_error: float
    storm_factor: float
    storm_from_us: int
    #: turn by rain at the site, either way
    rain_deg_db: float
    #: turn of the feed at an epoch
    feed_turn_deg: float
    feed_turn_from_us: int


class TrueMotion(NamedTuple):
    """Measurements of the motion beside powers; None = there is none."""

    wheels: TrueWheels | None = None
    rates: TrueRates | None = None
    polarimeter: TruePolarimeter | None = None
    #: (T,) deg, turn of the body that the polarimeter follows; (0,) = there is none
    polarimeter_turn_deg: FloatArray = np.empty(0)


# figures that only newer simulators state are left out
_WHEELS = TypeAdapter(TrueWheels | None)
_RATES = TypeAdapter(TrueRates | None)
_POLARIMETER = TypeAdapter(TruePolarimeter | None)
#: powers alone
NOTHING_MEASURED = TrueMotion()


def read_motion_statistics(text: str, polarimeter_turn_deg: FloatArray) -> TrueMotion:
    """Return the statistics of a world by its keys ``motion_json`` and ``polarimeter_turn_deg``."""
    stated = json.loads(text)
    wheels: TrueWheels | None = _WHEELS.validate_python(stated["wheels"])
    rates: TrueRates | None = _RATES.validate_python(stated["rates"])
    polarimeter: TruePolarimeter | None = _POLARIMETER.validate_python(stated["polarimeter"])
    return TrueMotion(wheels, rates, polarimeter, polarimeter_turn_deg)
