"""Answers that need no powers, beside which every figure is printed.

An estimator is worth something where it beats all of them: the answer that the spacecraft never moves, the sum of the
announced corrections, and the alignment's attitude carried on by the exchange of roll and yaw with these corrections.

A fourth answer reads each correction as a measurement: its operator wants to remove the attitude that he sees,
within the feedback time. An operator who knows more than the powers tell gives it away so; in roll and pitch an
estimator from powers must be better than this reading, or the world is no test of it.
"""

import numpy as np

from service.records.inputs import Correction
from service.records.levels.attitude import FloatArray, IntArray

#: rate of the exchange of roll and yaw, rad/h: one turn in a sidereal day
COUPLING_RAD_H = 0.2625162
_HOUR_US = 3.6e9

#: time in which a correction removes what its operator sees, h
FEEDBACK_H = 1.5

#: answers that know nothing of what the operator saw, and all of them
UNINFORMED = ("zero", "corrections", "coupling")
BASELINES = (*UNINFORMED, "corrections_read")


def baseline_answers(
    epochs_us: IntArray, start_us: int, attitude_deg: FloatArray, corrections: tuple[Correction, ...]
) -> dict[str, FloatArray]:
    """Return the answer (T, 3) in deg of every baseline.

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Epochs of the rows, later than the alignment.
    start_us : int
        Epoch of the alignment.
    attitude_deg : ndarray, shape (3,), deg
        Attitude at the alignment, yaw, roll, pitch.
    corrections : tuple of Correction
        As announced, each spread evenly over its interval.
    """
    instants_us: IntArray = np.append(np.int64(start_us), epochs_us)
    commanded = commanded_deg(instants_us, corrections)
    steps = np.diff(commanded, axis=0)
    hours = np.diff((instants_us - start_us) / _HOUR_US)
    return {
        "zero": np.zeros((len(epochs_us), 3)),
        "corrections": attitude_deg + commanded[1:] - commanded[0],
        "coupling": _coupled(attitude_deg, steps, hours),
        "corrections_read": _read(epochs_us, attitude_deg, corrections),
    }


def _read(epochs_us: IntArray, attitude_deg: FloatArray, corrections: tuple[Correction, ...]) -> FloatArray:
    """Return the attitude (T, 3) in deg that the newest correction was to remove, carried on to each epoch."""
    ordered = sorted((one for one in corrections if one.start_us <= epochs_us[-1]), key=lambda one: one.start_us)
    if not ordered:
        return np.tile(attitude_deg, (len(epochs_us), 1))
    starts_us = np.array([one.start_us for one in ordered])
    changes = np.array([one.change_deg for one in ordered])
    hours = np.array([(one.stop_us - one.start_us) / _HOUR_US for one in ordered])[:, np.newaxis]
    newest = np.searchsorted(starts_us, epochs_us, side="right") - 1
    seen = (changes / np.expm1(-hours / FEEDBACK_H))[newest]
    since = (epochs_us - starts_us[newest]) / _HOUR_US
    cosine, sine = np.cos(COUPLING_RAD_H * since), np.sin(COUPLING_RAD_H * since)
    yaw, roll, pitch = seen.T
    turned = np.column_stack([cosine * yaw - sine * roll, sine * yaw + cosine * roll, pitch])
    turned += commanded_deg(epochs_us, corrections) - commanded_deg(starts_us, corrections)[newest]
    return np.where(newest[:, np.newaxis] < 0, attitude_deg, turned)


def commanded_deg(epochs_us: IntArray, corrections: tuple[Correction, ...]) -> FloatArray:
    """Return the sum (T, 3) in deg of what the corrections have commanded up to each epoch."""
    total = np.zeros((len(epochs_us), 3))
    for correction in corrections:
        share = np.clip((epochs_us - correction.start_us) / (correction.stop_us - correction.start_us), 0.0, 1.0)
        total += share[:, np.newaxis] * np.array(correction.change_deg)
    return total


def _coupled(attitude_deg: FloatArray, steps_deg: FloatArray, hours: FloatArray) -> FloatArray:
    """Return the attitude (T, 3) in deg that turns with the orbit; a step's correction acts in its middle."""
    cosine, sine = np.cos(COUPLING_RAD_H * hours), np.sin(COUPLING_RAD_H * hours)
    yaw, roll, pitch = attitude_deg.tolist()
    answers = np.empty_like(steps_deg)
    for k, (c, s) in enumerate(zip(cosine.tolist(), sine.tolist(), strict=True)):
        yaw_step, roll_step, pitch_step = (0.5 * steps_deg[k]).tolist()
        yaw, roll = yaw + yaw_step, roll + roll_step
        yaw, roll = c * yaw - s * roll + yaw_step, s * yaw + c * roll + roll_step
        pitch += 2.0 * pitch_step
        answers[k] = yaw, roll, pitch
    return answers
