"""Wheel momentum among the hidden states: momentum of the spacecraft, and what telemetry of it has wrong.

    Hx' = w Hz + Tx,  Hz' = -w Hx + Tz,  Hy' = Ty         w = orbital rate, whether roll and yaw exchange or not
    hx = (1 + sx) (Hx + Hy (yaw + bx) - Hz pitch) - Jx wx
    hz = (1 + sz) (Hz - Hy (roll + bz) + Hx pitch) - Jz wz,   hy = Hy + Hz roll - Hx yaw - Jy wy

H N m s along x roll, y pitch, z yaw of the orbital frame; b deg, s relative. T is the profile from the catalogue and
the torque states, which stand before these. With a momentum along pitch H is a gyroscope that remembers yaw.

Two records beyond five sigma in a row are a jump, which thrusters make: the momentum is freed. The law of this file:
momentum moves nothing else; a record of telemetry has one weight. What takes a record is compiled as it stands.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.filter_model import (
    DRIFT,
    ORBITAL_RATE_PER_H,
    RATE,
    FilterSettings,
    Gaussian,
    MomentumModel,
    no_carriers,
)
from service.core.estimation.filtering.filter_state import NEVER_US
from service.core.estimation.filtering.motion import momentum_turn, walked_variance, write_momentum
from service.core.estimation.filtering.motion_sensor import (
    GATE,
    TRUSTED,
    SensorInnovation,
    begin_record,
    count_jump,
    greatest_excess,
    judge_record,
    mean_square,
    use_record,
)
from service.core.estimation.filtering.plant import (
    TORQUES,
    FilterModel,
    filter_model,
    gathered_prior_deg_h2,
    has_torque,
    momentum_count,
    sensor_states,
)

_DEGREE = math.radians(1.0)
#: states of momentum, misalignment and scales
_ERRORS = 7
#: one sigma of a momentum of which nothing is known, N m s
FREE_N_M_S = 1.0
#: sigmas from which a record that follows one that was left out is a jump
_JUMP = 5.0
#: fewest records of which a mean is judged, and records that the limit counts beside them: chance takes the mean of
#: five beyond 2.5 once in a thousand alignments, beyond 2.75 once in three thousand
_LEAST_RECORDS, _FEW_RECORDS = 5.0, 0.5


def momentum_covariance(settings: FilterSettings, wheels: MomentumModel) -> FloatArray:
    """Return the covariance before the first record, (7, 7), or (16, 16) with a torque of its own."""
    sigma = [FREE_N_M_S] * 3 + [wheels.misalignment_deg] * 2 + [wheels.scale_error] * 2
    if momentum_count(settings) > len(sigma):
        sigma += gathered_prior_deg_h2(settings).tolist()
    return np.diag(np.square(sigma))


def moved_momentum(gaussian: Gaussian, first: int, from_us: int, step_us: int, settings: FilterSettings) -> Gaussian:
    """Return the state whose momentum, from a place on, has moved on, and nothing else."""
    model = _wheels_of(settings)
    hidden = first - RATE.stop + sensor_states(settings)
    rows = np.zeros((3, RATE.stop + hidden))
    push = write_momentum(rows, model, hidden, from_us, step_us)
    positions, own = momentum_sources(first, settings), slice(first, first + 3)
    step = rows[:, positions]
    mean, covariance = gaussian.mean.copy(), gaussian.covariance.copy()
    moved = step @ covariance[positions]
    block = moved[:, positions] @ step.T
    moved[:, own] = 0.5 * (block + block.T) + walked_variance(model, step_us) * np.eye(3)
    covariance[own], covariance[:, own] = moved, moved.T
    mean[own] = step @ mean[positions] + push
    return Gaussian(mean, covariance)


@lru_cache(maxsize=8)
def _wheels_of(settings: FilterSettings) -> FilterModel:
    return filter_model(no_carriers(), settings)


def learned_positions(first: int, settings: FilterSettings) -> IntArray:
    """Return the positions (13,) of what quiet days tell, in the order of `LearnedMomentum`."""
    return np.concatenate([momentum_sources(first, settings)[:-3], np.arange(first + 3, first + _ERRORS)])


def with_learned_momentum(gaussian: Gaussian, first: int, settings: FilterSettings) -> Gaussian:
    """Return the state with what quiet days tell of torque and telemetry, where they told something."""
    wheels = settings.momentum
    if wheels is None or wheels.learned is None:
        return gaussian
    mean, covariance = gaussian.mean.copy(), gaussian.covariance.copy()
    own = learned_positions(first, settings)
    mean[own] = np.array(wheels.learned.mean)
    covariance[own, :] = covariance[:, own] = 0.0
    covariance[np.ix_(own, own)] = np.array(wheels.learned.covariance)
    return Gaussian(mean, covariance)


def momentum_sources(first: int, settings: FilterSettings) -> IntArray:
    """Return the positions of what the momentum after a step is made of: (9,) of the torque if any, (3,) its own.

    A torque of its own stands behind momentum, misalignment and scales; that which also pushes the body before them.
    """
    own = momentum_count(settings) - TORQUES
    torque = first + own if own > 0 else first - TORQUES * has_torque(settings)
    behind = torque + TORQUES if own > 0 else first
    return np.concatenate([np.arange(torque, behind), np.arange(first, first + 3)])


class WheelRecord(NamedTuple):
    """Momentum of the wheels by telemetry."""

    epoch_us: int
    #: (3,) along roll, pitch, yaw of the body
    momentum_n_m_s: FloatArray
    #: whether thrusters unload the wheels
    is_unloading: bool


def compare_momentum(
    model: FilterModel, mean: FloatArray, covariance: FloatArray, first: int, reported: FloatArray, after_h: float
) -> SensorInnovation:
    """Return a record (3,), N m s, of roll, pitch, yaw against a state; `after_h` <= 0 is its age.

    The momentum of the state stands at `first`.
    """
    jacobian, variance = np.zeros((3, len(mean))), model.plant[0]["momentum_sigma_n_m_s"] ** 2
    innovation = reported - _write_expected(jacobian, model, mean, first, after_h)
    cross = jacobian @ covariance
    return SensorInnovation(jacobian, innovation, cross @ jacobian.T + variance * np.eye(3), cross)


def free_momentum(covariance: FloatArray, first: int) -> None:
    """Let H have changed by 1 N m s, in place."""
    for place in range(first, first + 3):
        covariance[place, place] += FREE_N_M_S**2


def begin_momentum(mean: FloatArray, covariance: FloatArray, first: int, reported: FloatArray) -> None:
    """Let H begin at a record (3,), in place."""
    mean[first : first + 3] = reported
    covariance[first : first + 3] = 0.0
    covariance[:, first : first + 3] = 0.0
    free_momentum(covariance, first)


def refuse_impossible(watch: NDArray[np.void]) -> None:
    """Judge a record that no wheel can hold: telemetry that begins so is refused."""
    if watch["newest_us"] == NEVER_US:
        watch["is_refused"] = True


def push_momentum(
    model: FilterModel,
    watch: NDArray[np.void],
    mean: FloatArray,
    covariance: FloatArray,
    first: int,
    record: WheelRecord,
    epoch_us: int,
    trace_rows: FloatArray,
) -> bool:
    """Take a record into watch and state, in place; return whether the momentum begins with it.

    The state is of a not earlier epoch, its momentum stands at `first`; `trace_rows` as `use_record` writes it. Records
    that are not newer than the newest, or repeat it to the last digit, tell nothing.
    """
    record_us, reported = record.epoch_us, record.momentum_n_m_s
    is_repeated = not (reported != watch["newest_n_m_s"]).any()
    if watch["is_refused"] or record_us <= watch["newest_us"] or is_repeated:
        return False
    is_first = bool(watch["newest_us"] == NEVER_US)
    begin_record(watch, record_us)
    # the first may be of before the alignment
    watch["heard_us"] = max(watch["heard_us"], record_us)
    watch["newest_n_m_s"][:] = reported
    if is_first:
        begin_momentum(mean, covariance, first, reported)
    elif record.is_unloading:
        free_momentum(covariance, first)
    after_h = (record_us - epoch_us) / 3.6e9
    compared = compare_momentum(model, mean, covariance, first, reported, after_h)
    excess = greatest_excess(compared)
    if excess > GATE:
        if excess <= _JUMP or watch["skipped"] == 0:
            watch["skipped"] += 1
            judge_record(watch, covariance, mean_square(compared), _LEAST_RECORDS, _FEW_RECORDS)
            return is_first
        count_jump(watch, record_us)
        excess = 0.0
        free_momentum(covariance, first)
        compared = compare_momentum(model, mean, covariance, first, reported, after_h)
    square = mean_square(compared)
    variance = model.plant[0]["momentum_sigma_n_m_s"] ** 2 * (max(excess / TRUSTED, 1.0) ** 2 - 1.0)
    use_record(mean, covariance, compared, variance, trace_rows)
    watch["skipped"] = 0
    judge_record(watch, covariance, square, _LEAST_RECORDS, _FEW_RECORDS)
    return is_first


def _write_expected(
    jacobian: FloatArray, model: FilterModel, mean: FloatArray, first: int, after_h: float
) -> FloatArray:
    """Return the expected record (3,); its Jacobian (3, D) begins with zeros."""
    one = model.plant[0]
    coupling, inertia_kg_m2 = one["coupling_per_h"], one["inertia_kg_m2"]
    # angles at the record: attitude and rates of the state carried back
    back = np.array([[1.0, -after_h * coupling, 0.0], [after_h * coupling, 1.0, 0.0], [0.0, 0.0, 1.0]])
    angles = _DEGREE * (back @ mean[:3] + after_h * (mean[3:6] + mean[6:9]))
    yaw, roll, pitch = angles[0], angles[1], angles[2]
    turn = momentum_turn(after_h)
    momentum = turn @ mean[first : first + 3]
    x, y, z = momentum[0], momentum[1], momentum[2]
    bx, bz = _DEGREE * mean[first + 3], _DEGREE * mean[first + 4]
    # the wheels hold what the whole body does not turn with the orbit by itself
    whole = y - inertia_kg_m2[2] * ORBITAL_RATE_PER_H / 3600.0
    seen = np.array([x + whole * (yaw + bx) - z * pitch, y + z * roll - x * yaw, z - whole * (roll + bz) + x * pitch])
    scale = np.array([1.0 + mean[first + 5], 1.0, 1.0 + mean[first + 6]])
    by_angle = _DEGREE * np.array([[whole, 0.0, -z], [-x, z, 0.0], [0.0, -whole, x]])
    by_attitude = by_angle @ back
    by_momentum = np.array([[1.0, yaw + bx, -pitch], [-yaw, 1.0, roll], [pitch, -(roll + bz), 1.0]]) @ turn
    # what the body itself turns with, beside the constant part along pitch that H holds
    rest, expected = coupling - ORBITAL_RATE_PER_H, np.empty(3)
    for body in range(3):
        # roll, pitch, yaw among yaw, roll, pitch
        axis = (body + 1) % 3
        inertia = inertia_kg_m2[axis] * _DEGREE / 3600.0
        spin = mean[DRIFT.start + axis] + mean[RATE.start + axis]
        for other in range(3):
            jacobian[body, other] = scale[body] * by_attitude[body, other]
            jacobian[body, DRIFT.start + other] = scale[body] * after_h * by_angle[body, other]
            jacobian[body, first + other] = scale[body] * by_momentum[body, other]
        jacobian[body, DRIFT.start + axis] -= inertia
        jacobian[body, RATE.start : RATE.stop] = jacobian[body, DRIFT.start : DRIFT.stop]
        if body != 1:
            # roll turns with yaw, yaw against roll
            turned, share = (0, rest) if body == 0 else (1, -rest)
            spin += share * mean[turned]
            jacobian[body, turned] -= inertia * share
        expected[body] = scale[body] * seen[body] - inertia * spin
    jacobian[0, first + 3], jacobian[2, first + 4] = scale[0] * _DEGREE * whole, -scale[2] * _DEGREE * whole
    jacobian[0, first + 5], jacobian[2, first + 6] = seen[0], seen[2]
    return expected
