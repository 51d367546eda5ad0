"""Wheel momentum among the hidden states: momentum of the spacecraft, and what telemetry of it has wrong.

    Hx' = w Hz + Tx,  Hz' = -w Hx + Tz,  Hy' = Ty         w = orbital rate, whether roll and yaw exchange or not
    hx = (1 + sx) (Hx + Hy (yaw + bx) - Hz pitch) - Jx wx
    hz = (1 + sz) (Hz - Hy (roll + bz) + Hx pitch) - Jz wz,   hy = Hy + Hz roll - Hx yaw - Jy wy

H N m s along x roll, y pitch, z yaw of the orbital frame; b deg, s relative. T is the profile from the catalogue and
the torque states, which stand before these. With a momentum along pitch H is a gyroscope that remembers yaw.

Two records beyond five sigma in a row are a jump, which thrusters make: the momentum is freed. The law of this file:
momentum moves nothing else; a record of telemetry has one weight.
"""

import math
from functools import lru_cache

import numpy as np

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    DRIFT,
    RATE,
    FilterSettings,
    Gaussian,
    MomentumModel,
    no_carriers,
)
from service.core.estimation.filtering.motion import (
    ORBITAL_RATE_PER_H,
    momentum_turn,
    walked_variance,
    write_momentum,
)
from service.core.estimation.filtering.motion_sensor import (
    GATE,
    NEVER_US,
    NO_EFFECT,
    TRUSTED,
    SensorEffect,
    SensorUpdate,
    SensorWatch,
    judged,
    with_record,
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

#: positions of roll, pitch, yaw among yaw, roll, pitch
_BODY = np.array([1, 2, 0])
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


def compared(
    gaussian: Gaussian,
    first: int,
    reported: FloatArray,
    after_h: float,
    settings: FilterSettings,
    wheels: MomentumModel,
) -> SensorUpdate:
    """Return a record (3,), N m s, of roll, pitch, yaw against the state; `after_h` <= 0 is its age."""
    expected, jacobian = _expected(gaussian.mean, first, after_h, settings, wheels)
    cross = jacobian @ gaussian.covariance
    noise = wheels.sigma_n_m_s**2 * np.eye(3)
    return SensorUpdate(jacobian, reported - expected, cross @ jacobian.T + noise, cross)


def with_free_momentum(gaussian: Gaussian, first: int, reported: FloatArray | None = None) -> Gaussian:
    """Return the state whose H may have changed by 1 N m s; it begins at a record (3,) where one is given."""
    mean, covariance = gaussian.mean.copy(), gaussian.covariance.copy()
    at = np.arange(first, first + 3)
    if reported is not None:
        mean[at] = reported
        covariance[at, :] = covariance[:, at] = 0.0
    covariance[at, at] += FREE_N_M_S**2
    return Gaussian(mean, covariance)


def with_impossible(watch: SensorWatch) -> SensorWatch:
    """Return the watch after a record that no wheel can hold: telemetry that begins so is refused."""
    return watch._replace(is_refused=True) if watch.newest_us == NEVER_US else watch


def momentum_advice(watch: SensorWatch, since_us: int, epoch_us: int, *, is_used: bool) -> dict[str, bool]:
    """Return which advice about the telemetry of the wheels is given at an epoch of a filter that began at another."""
    return {
        "momentum_refused": watch.is_refused,
        "momentum_jump": watch.has_jumped(epoch_us),
        "momentum_silent": is_used and watch.is_silent(since_us, epoch_us),
    }


def push_record(
    watch: SensorWatch,
    gaussian: Gaussian,
    first: int,
    record_us: int,
    reported: FloatArray,
    epoch_us: int,
    settings: FilterSettings,
    wheels: MomentumModel,
    *,
    is_unloading: bool,
) -> tuple[SensorWatch, Gaussian, SensorEffect]:
    """Return watch and state after a record (3,) of an epoch, and its effect; the state is of a not earlier epoch.

    Records that are not newer than the newest, or repeat it to the last digit, tell nothing.
    """
    if watch.is_refused or record_us <= watch.newest_us or np.array_equal(reported, watch.newest_n_m_s):
        return watch, gaussian, NO_EFFECT
    is_first = watch.newest_us == NEVER_US
    watch = with_record(watch, record_us)._replace(heard_us=record_us, newest_n_m_s=reported)
    effect = SensorEffect(np.arange(first, first + 3)) if is_first else NO_EFFECT
    if is_first or is_unloading:
        gaussian = with_free_momentum(gaussian, first, reported if is_first else None)
    after_h = (record_us - epoch_us) / 3.6e9
    found = compared(gaussian, first, reported, after_h, settings, wheels)
    excess = found.excess
    if excess > GATE:
        if excess <= _JUMP or not watch.skipped:
            watch = watch._replace(skipped=watch.skipped + 1)
            return *judged(watch, gaussian, found.mean_square, _LEAST_RECORDS, _FEW_RECORDS), effect
        watch, excess = watch.jumped(record_us), 0.0
        gaussian = with_free_momentum(gaussian, first)
        found = compared(gaussian, first, reported, after_h, settings, wheels)
    mean_square = found.mean_square
    if excess > TRUSTED:
        found = found.widened(wheels.sigma_n_m_s**2 * ((excess / TRUSTED) ** 2 - 1.0))
    watch = watch._replace(skipped=0)
    after = judged(watch, found.applied(gaussian), mean_square, _LEAST_RECORDS, _FEW_RECORDS)
    return *after, effect._replace(update=found)


def _expected(
    mean: FloatArray, first: int, after_h: float, settings: FilterSettings, wheels: MomentumModel
) -> tuple[FloatArray, FloatArray]:
    """Return the expected record (3,) and its Jacobian (3, D)."""
    coupling, degree = settings.coupling_per_h, math.radians(1.0)
    # angles at the record: attitude and rates of the state carried back
    back = np.zeros((3, len(mean)))
    back[:, ATTITUDE] = np.eye(3) + after_h * np.array([[0.0, -coupling, 0.0], [coupling, 0.0, 0.0], [0.0] * 3])
    back[:, DRIFT] = back[:, RATE] = after_h * np.eye(3)
    yaw, roll, pitch = (degree * (back @ mean)).tolist()
    turn = momentum_turn(after_h)
    own = slice(first, first + 3)
    x, y, z = (turn @ mean[own]).tolist()
    bx, bz = (degree * mean[first + 3 : first + 5]).tolist()
    sx, sz = mean[first + 5 : first + 7].tolist()
    # the wheels hold what the whole body does not turn with the orbit by itself
    whole = y - wheels.inertia_kg_m2[2] * ORBITAL_RATE_PER_H / 3600.0
    seen = np.array([x + whole * (yaw + bx) - z * pitch, y + z * roll - x * yaw, z - whole * (roll + bz) + x * pitch])
    scale = np.array([1.0 + sx, 1.0, 1.0 + sz])
    jacobian = np.zeros((3, len(mean)))
    by_angle = degree * np.array([[whole, 0.0, -z], [-x, z, 0.0], [0.0, -whole, x]])
    by_momentum = np.array([[1.0, yaw + bx, -pitch], [-yaw, 1.0, roll], [pitch, -(roll + bz), 1.0]])
    jacobian += scale[:, None] * (by_angle @ back)
    jacobian[:, own] += scale[:, None] * (by_momentum @ turn)
    jacobian[0, first + 3], jacobian[2, first + 4] = scale[0] * degree * whole, -scale[2] * degree * whole
    jacobian[0, first + 5], jacobian[2, first + 6] = seen[0], seen[2]
    # what the body itself turns with, beside the constant part along pitch that H holds
    inertia = np.array(wheels.inertia_kg_m2)[_BODY] * degree / 3600.0
    rest = coupling - ORBITAL_RATE_PER_H
    spin = np.zeros((3, len(mean)))
    spin[np.arange(3), DRIFT.start + _BODY] = spin[np.arange(3), RATE.start + _BODY] = 1.0
    spin[0, ATTITUDE.start], spin[2, ATTITUDE.start + 1] = rest, -rest
    jacobian -= inertia[:, None] * spin
    return scale * seen - inertia * (spin @ mean), jacobian
