"""Levels L2-L4: deviation, fix and attitude row.

A failed epoch is a value: its angles are NaN, its status is not ACQUIRED, its reasons are listed. Arrays inside
records are read-only.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.records.catalogue import Method

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Axes(NamedTuple):
    """One value for each axis, always by name; the unit stands in the name of the field that holds it."""

    yaw: float
    roll: float
    pitch: float


def named_axes(values: FloatArray) -> Axes:
    """Return an array (3,) in the order yaw, roll, pitch by name."""
    return Axes._make(values.tolist())


NO_ANGLES = Axes(math.nan, math.nan, math.nan)


class Status(StrEnum):
    """Validity of a row, the four words of the mission-control world."""

    ACQUIRED = "ACQUIRED"
    NOT_RECEIVED = "NOT_RECEIVED"
    INVALID = "INVALID"
    EXPIRED = "EXPIRED"


class Exclusion(NamedTuple):
    """One carrier left out of a fix, and why."""

    carrier: str
    #: uplink_fade, step, absent, frozen, interference, group or manual
    reason: str


@dataclass(frozen=True, slots=True)
class Deviation:
    """L2: measured minus expected power of every carrier of a plan at one epoch."""

    epoch_us: int
    #: (N,) dBm, reference plus harmonic; NaN = not known
    expected_dbm: FloatArray
    #: (N,) dB, measured minus expected; NaN = absent
    deviation_db: FloatArray


@dataclass(frozen=True, slots=True)
class AttitudeFix:
    """L3: attitude of one epoch alone."""

    epoch_us: int
    #: (3,) deg, yaw, roll, pitch; NaN = no fix
    attitude_deg: FloatArray
    #: (3, 3) deg^2
    covariance_deg2: FloatArray
    #: (N,) dB, deviation minus model; NaN = absent
    residual_db: FloatArray
    #: (N,) dB, assumed one standard deviation of each averaged deviation
    sigma_db: FloatArray
    carriers_used: int
    excluded: tuple[Exclusion, ...]


@dataclass(frozen=True, slots=True)
class AttitudeRow:
    """L4: attitude estimate of one method at one measurement.

    Tables, exports and answers derive from these fields (`service.records.record_fields`); a text beside a type is the
    description in the interface. A new field stands at the end; a method that does not compute it leaves
    its default (a number: ``math.nan``).
    """

    epoch_us: int
    received_at_us: int
    #: journal number of the measurement
    number: int
    method: Method
    attitude_deg: Axes
    sigma_deg: Annotated[Axes, "One standard deviation."]
    rates_deg_s: Annotated[Axes | None, "Null where the method knows no rate."]
    status: Status
    control_allowed: Annotated[
        bool,
        "Permission of this estimate for control, yaw apart; it does not change. For now read `control.allowed`.",
    ]
    #: yaw, roll, pitch
    control_allowed_axes: tuple[bool, bool, bool]
    inhibitions: tuple[str, ...]
    carriers_used: int
    excluded: tuple[Exclusion, ...]
    downlink_fade: bool
    downlink_fade_db: float
    common_db: float
    residual_rms_db: float
    calibration_id: int | None
    alignment_id: int | None
    advice: Annotated[tuple[str, ...], "Advice to the operator while control goes on, such as `realign`."] = ()
    protection_deg: Annotated[
        Axes, "Protection level: the error of the angle passes it with a probability of 1e-4 a row; null = not known."
    ] = NO_ANGLES
    lag_s: Annotated[
        float, "Smoothed rows: time from the row to the last one by which it was smoothed; null for other methods."
    ] = math.nan


def row_without_attitude(
    epoch_us: int, received_at_us: int, number: int, method: Method, inhibitions: tuple[str, ...]
) -> AttitudeRow:
    """Return the row of a measurement from which a method could compute nothing, and why."""
    return AttitudeRow(
        epoch_us=epoch_us,
        received_at_us=received_at_us,
        number=number,
        method=method,
        attitude_deg=NO_ANGLES,
        sigma_deg=NO_ANGLES,
        rates_deg_s=None,
        status=Status.INVALID,
        control_allowed=False,
        control_allowed_axes=(False, False, False),
        inhibitions=inhibitions,
        carriers_used=0,
        excluded=(),
        downlink_fade=False,
        downlink_fade_db=math.nan,
        common_db=math.nan,
        residual_rms_db=math.nan,
        calibration_id=None,
        alignment_id=None,
    )


@dataclass(frozen=True, slots=True)
class CarrierState:
    """State of one carrier in the chain after the newest measurement; NaN = not known."""

    carrier: str
    power_dbm: float
    expected_dbm: Annotated[float, "Reference power and daily harmonic."]
    deviation_db: Annotated[float, "Measured minus expected."]
    residual_db: Annotated[float, "Deviation minus what the attitude explains."]
    sigma_db: Annotated[float, "Scatter of one row, one sigma, in the model of the method that gives these values."]
    flags: int
    state: Annotated[str, "used, absent, excluded, unselected or uncalibrated."]
    hypothesis: Annotated[
        str | None,
        "State of the carrier by the references of the alignment: dry, wet, level_changed or level_learned.",
    ] = None
    hypothesis_probability: float = math.nan
    hypothesis_since_us: int | None = None
