"""Rows of a running sign check, and the verdicts of powers and wheel telemetry.

The filter does not get the torque of a sign check, so the powers alone must show the turn. The pulses that were
reported executed are the commanded turn, and rows from the start of a leg on are judged once it is reported: a leg
that was lost on its way is no wrong sign. Rows live in this process only: a restart interrupts a check.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S
from service.core.control.sign_check import SignContext, SignDecision, SignState, decide, weigh, wheel_decision
from service.core.control.slew_schedule import LONGEST_SHARE, AxisPulse, Drive, plan_slew
from service.core.estimation.filtering.filter_model import CarrierModel
from service.pipeline.control.release.interlock_conditions import ReleaseSettings, microseconds
from service.pipeline.control.release.sign_checks import profile_of
from service.records.epoch import US_PER_S
from service.records.inputs import TelemetryRecord
from service.records.levels.attitude import Axes, FloatArray, Pulse
from service.records.operations.release import SignCheck

AXES = ("yaw", "roll", "pitch")
#: time from the middle of a leg's first pulse to that of its second, s; roll slower, so that it stays in the envelope
_SAILING_S = {"yaw": 600.0, "roll": 400.0, "pitch": 300.0}
#: share of its time in which a slew of two pulses sails
_SAILING_SHARE = 1.0 - LONGEST_SHARE
#: more rows than this are averaged before they are weighed: time grows with the third power
_MOST_ROWS = 100
_LEAST_ROWS = 4


@dataclass(slots=True)
class SignCheckRows:
    """Rows since a sign check began."""

    #: attitude before it, deg
    attitude_deg: Axes
    #: (3, 3) in the order yaw, roll, pitch
    inertia_kg_m2: FloatArray
    has_coupling: bool
    model: CarrierModel | None = None
    epochs_us: list[int] = field(default_factory=list)
    deviations_db: list[FloatArray] = field(default_factory=list)
    #: legs and rows that were weighed last, and their decision
    judged: tuple[int, int, SignDecision] | None = None

    def append(self, epoch_us: int, model: CarrierModel, deviation_db: FloatArray) -> None:
        """Append a row; those of another model than the first one's carriers do not fit."""
        if self.model is not None and model.carriers != self.model.carriers:
            return
        self.model = model
        self.epochs_us.append(epoch_us)
        self.deviations_db.append(deviation_db)

    def leg(self, check: SignCheck, drive: Drive) -> tuple[AxisPulse, ...]:
        """Return the pulses of the next leg; ValueError where the drive cannot give them."""
        change = np.zeros(3)
        change[AXES.index(check.axis)] = profile_of(check.axis).legs[check.legs_done].change_deg
        horizon_s = _SAILING_S[check.axis] / _SAILING_SHARE
        return plan_slew(change, np.zeros(3), self.inertia_kg_m2, horizon_s, drive)

    def decision(self, check: SignCheck) -> SignDecision | None:
        """Return the decision of the powers; None while there is nothing to judge."""
        if not check.flown or self.model is None:
            return None
        epochs_us, deviation_db = np.array(self.epochs_us), np.array(self.deviations_db)
        if check.leg is not None:
            is_before = epochs_us < check.leg_start_us
            epochs_us, deviation_db = epochs_us[is_before], deviation_db[is_before]
        if len(epochs_us) < _LEAST_ROWS:
            return None
        weighed = len(check.flown), len(epochs_us)
        if self.judged is None or self.judged[:2] != weighed:
            self.judged = *weighed, self._weighed(check, self.model, epochs_us, deviation_db)
        return self.judged[2]

    def _weighed(
        self, check: SignCheck, model: CarrierModel, epochs_us: FloatArray, deviation_db: FloatArray
    ) -> SignDecision:
        size = math.ceil(len(epochs_us) / _MOST_ROWS)
        model = model._replace(white_sigma_db=model.white_sigma_db / math.sqrt(size))
        epochs_us, deviation_db = _averaged(epochs_us, deviation_db, size)
        epochs_s = (epochs_us - epochs_us[0]) / US_PER_S
        turn = turned_deg(list(check.flown), epochs_us, self.inertia_kg_m2, has_coupling=self.has_coupling)
        return decide(weigh(model, epochs_s, deviation_db, turn, SignContext(np.array(self.attitude_deg))))


def wheel_verdict(
    check: SignCheck, telemetry: tuple[TelemetryRecord, ...], wheel_axes: FloatArray, settings: ReleaseSettings
) -> SignState:
    """Return the verdict of wheel telemetry: momentum while sailing against that before each leg."""
    predicted, measured = [], []
    for schedule in check.flown:
        change = _sailing_change(schedule, telemetry)
        if change is not None and len(change) == len(wheel_axes):
            impulse = np.array(schedule[0].torque_n_m) * schedule[0].duration_s
            predicted.append(-impulse @ np.linalg.pinv(wheel_axes))
            measured.append(change)
    if not predicted:
        return SignState.OPEN
    return wheel_decision(np.concatenate(predicted), np.concatenate(measured), settings.wheel_sigma_n_m_s).verdict


def joint_verdict(
    check: SignCheck, powers: SignState, wheels: SignState | None, now_us: int, settings: ReleaseSettings
) -> SignState:
    """Return the verdict: of powers alone for roll and pitch; for yaw of both, and not before its time."""
    if wheels is None:
        return powers
    if not check.flown or now_us - check.flown[0][0].start_us < microseconds(settings.yaw_sign_least_s):
        return SignState.OPEN
    wrong = [each for each in (powers, wheels) if each in (SignState.MINUS, SignState.NOTHING)]
    if wrong:
        return wrong[0]
    return SignState.PLUS if powers is wheels is SignState.PLUS else SignState.OPEN


def turned_deg(
    schedules: list[tuple[Pulse, ...]], epochs_us: FloatArray, inertia_kg_m2: FloatArray, *, has_coupling: bool
) -> FloatArray:
    """Return the turn (T, 3), yaw, roll, pitch, that schedules make by some epochs, deg.

    Parameters
    ----------
    schedules : list of tuples of Pulse
        As they were carried out.
    epochs_us : ndarray, shape (T,), microseconds UTC
        Of the rows.
    inertia_kg_m2 : ndarray, shape (3, 3)
        In the order yaw, roll, pitch.
    has_coupling : bool
        Whether roll and yaw exchange at the orbital rate; to first order.

    Notes
    -----
    A pulse acts as a step of the rate in its middle: exact after its end.
    """
    turn = np.zeros((len(epochs_us), 3))
    dragged = np.zeros((len(epochs_us), 3))
    for pulse in (pulse for schedule in schedules for pulse in schedule):
        since_s = np.maximum(0.0, (epochs_us - pulse.start_us) / US_PER_S - 0.5 * pulse.duration_s)
        step_rad_s = np.linalg.solve(inertia_kg_m2, np.array(pulse.torque_n_m) * pulse.duration_s)
        turn += since_s[:, None] * step_rad_s
        dragged += 0.5 * np.square(since_s)[:, None] * step_rad_s
    if has_coupling:
        yaw, roll, _ = dragged.T
        turn[:, 1] += GEOSTATIONARY_RATE_RAD_S * yaw
        turn[:, 0] -= GEOSTATIONARY_RATE_RAD_S * roll
    return np.asarray(np.degrees(turn))


def _averaged(epochs_us: FloatArray, deviation_db: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """Return means of so many rows each; what is left over at the beginning is dropped."""
    if size == 1:
        return epochs_us, deviation_db
    first = len(epochs_us) % size
    epochs = epochs_us[first:].reshape(-1, size).mean(axis=1)
    # a carrier that is absent in one of them is absent in the mean
    return epochs, deviation_db[first:].reshape(len(epochs), size, -1).mean(axis=1)


def _sailing_change(schedule: tuple[Pulse, ...], telemetry: tuple[TelemetryRecord, ...]) -> FloatArray | None:
    """Return by how much the wheels' momentum changed with the first pulse of a leg; None without telemetry."""
    if len(schedule) < 2:
        return None
    first, last = schedule[0], schedule[-1]
    sailing_us = first.start_us + round(first.duration_s * US_PER_S)
    before = [each for each in telemetry if each.epoch_us <= first.start_us]
    while_sailing = [each for each in telemetry if sailing_us <= each.epoch_us <= last.start_us]
    if not before or not while_sailing:
        return None
    newest, sailing = before[-1].wheel_momentum_n_m_s, while_sailing[0].wheel_momentum_n_m_s
    if newest is None or sailing is None or len(newest) != len(sailing):
        return None
    return np.asarray(np.subtract(sailing, newest))
