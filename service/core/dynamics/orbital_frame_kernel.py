"""Flight of the spacecraft in the orbital frame, period by period of its computer; one source, compiled or plain.

The law of this file: what numba compiles without help. Order within a period: sensors are sampled, the computer
computes, rounds and holds; wheels and body then move in Runge-Kutta steps over which the wheels' momentum is linear.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from service.core.arrays import FloatArray
from service.core.dynamics import orbital_frame_step
from service.core.dynamics.orbital_frame_model import (
    AxisWheels,
    Computer,
    OrbitalFrameSpacecraft,
    RateSensor,
    VerticalSensor,
)
from service.core.dynamics.orbital_frame_step import (
    Inverse,
    State,
    Triple,
    angles,
    blended,
    body_rate,
    derivative,
    inverse_inertia,
    moved,
    tilt,
    wanted_torque,
)

FLOWN, NO_YAW_ESTIMATE = 0, 1

Fly = Callable[[OrbitalFrameSpacecraft, State, FloatArray, FloatArray, FloatArray, FloatArray], tuple[int, int, State]]


def clipped(value: float, limit: float) -> float:
    """Return a value within a limit of either sign; NaN stays NaN."""
    if value > limit:
        return limit
    if value < -limit:
        return -limit
    return value


def rounded(value: float, quantum: float, rule: int) -> float:
    """Return a multiple of a quantum: nearest (0), to zero (1) or down (2)."""
    if rule == 1:
        return quantum * math.trunc(value / quantum)
    if rule == 2:
        return quantum * math.floor(value / quantum)
    return quantum * math.floor(value / quantum + 0.5)


def command(computer: Computer, wanted: Triple) -> Triple:
    """Return the torque that the computer asks the wheels for, N m."""
    quantum, rule, limit = computer.torque_quantum_n_m, computer.rounding, computer.torque_limit_n_m
    return (
        clipped(rounded(wanted[0], quantum, rule), limit),
        clipped(rounded(wanted[1], quantum, rule), limit),
        clipped(rounded(wanted[2], quantum, rule), limit),
    )


def lagged_tilt(
    sensor: VerticalSensor, shown: tuple[float, float], seen: tuple[float, float], period_s: float
) -> tuple[float, float]:
    """Return roll and pitch behind the sensor's limit and lag, rad."""
    share = 1.0 - math.exp(-period_s / sensor.lag_s)
    return (
        shown[0] + share * (clipped(seen[0], sensor.limit_rad) - shown[0]),
        shown[1] + share * (clipped(seen[1], sensor.limit_rad) - shown[1]),
    )


def bent_tilt(sensor: VerticalSensor, state: State, flexible: FloatArray, noise: FloatArray) -> tuple[float, float]:
    """Return roll and pitch that reach the sensor, rad: of the body, its tones, noise and bias."""
    roll, pitch = tilt(state)
    bend = flexible[0, 0] + flexible[1, 0] + flexible[2, 0]
    return (roll + bend + noise[0] + sensor.roll_bias_rad, pitch + noise[1] + sensor.pitch_bias_rad)


def bent_rate(rate: Triple, flexible: FloatArray) -> Triple:
    """Return rates that reach the sensors, rad/s: of the body and its tones."""
    return (
        rate[0] + flexible[0, 1] + flexible[1, 1] + flexible[2, 1],
        rate[1],
        rate[2] + flexible[3, 1] + flexible[4, 1] + flexible[5, 1],
    )


def sensed_rate(sensor: RateSensor, rate: Triple, noise: FloatArray) -> Triple:
    """Return rates with null and noise behind the sensor's limit and quantum, rad/s."""
    null, limit, quantum = sensor.null_rad_s, sensor.limit_rad_s, sensor.quantum_rad_s
    return (
        rounded(clipped(rate[0] + null[0] + noise[0], limit), quantum, 0),
        rounded(clipped(rate[1] + null[1] + noise[1], limit), quantum, 0),
        rounded(clipped(rate[2] + null[2] + noise[2], limit), quantum, 0),
    )


def rotor_torque(wheels: AxisWheels, asked: float, momentum: float, angle: float, step_s: float) -> float:
    """Return the mean torque on a rotor over a step, N m: motor, cogging, dry and viscous friction, stop and limit."""
    speed = momentum / wheels.inertia_kg_m2
    motor = -wheels.slope * asked * (1.0 + math.copysign(1.0, asked) * speed / wheels.no_load_rad_s)
    turned = wheels.cogging_periods * speed * step_s
    start = wheels.cogging_periods * angle
    # averaged over the step: at twelve periods a turn and eight turns a second it would alias
    cogging = (math.cos(start) - math.cos(start + turned)) / turned if abs(turned) > 1e-9 else math.sin(start)
    drive = motor - wheels.cogging_n_m * cogging - wheels.viscous_friction_n_m_s * speed
    if momentum == 0.0:
        if abs(drive) <= wheels.dry_friction_n_m:
            return 0.0
        torque = drive - math.copysign(wheels.dry_friction_n_m, drive)
    else:
        torque = drive - math.copysign(wheels.dry_friction_n_m, momentum)
        if momentum * (momentum + torque * step_s) < 0.0 and abs(drive) <= wheels.dry_friction_n_m:
            torque = -momentum / step_s
    limit = wheels.momentum_limit_n_m_s
    if abs(momentum + torque * step_s) > limit:
        torque = (math.copysign(limit, momentum + torque * step_s) - momentum) / step_s
    return torque


def given_torque(wheels: AxisWheels, asked: Triple, state: State, turns: FloatArray, step_s: float) -> Triple:
    """Return the torques that the wheels give the body over a step, N m, and turn the rotors."""
    if not wheels.is_real:
        return asked
    x = rotor_torque(wheels, asked[0], state[7], turns[0], step_s)
    y = rotor_torque(wheels, asked[1], state[8], turns[1], step_s)
    z = rotor_torque(wheels, asked[2], state[9], turns[2], step_s)
    turns[0] += (state[7] + 0.5 * x * step_s) / wheels.inertia_kg_m2 * step_s
    turns[1] += (state[8] + 0.5 * y * step_s) / wheels.inertia_kg_m2 * step_s
    turns[2] += (state[9] + 0.5 * z * step_s) / wheels.inertia_kg_m2 * step_s
    return (-x, -y, -z)


def swing(tones: FloatArray, flexible: FloatArray, torque: Triple) -> None:
    """Move the six tones through a step under a constant torque; three are of roll, three of yaw."""
    for k in range(6):
        drive = torque[0] if k < 3 else torque[2]
        angle, rate = flexible[k, 0], flexible[k, 1]
        flexible[k, 0] = tones[k, 0] * angle + tones[k, 1] * rate + tones[k, 4] * drive
        flexible[k, 1] = tones[k, 2] * angle + tones[k, 3] * rate + tones[k, 5] * drive


def held_step(state: State, body: tuple[Inverse, Inverse, float, float], torque: Triple, step_s: float) -> State:
    """Return the state after a step under a constant torque of the wheels."""
    inertia, inverse, gravity, w0 = body
    a = derivative(state, inertia, inverse, gravity, torque, w0)
    b = derivative(moved(state, a, 0.5 * step_s), inertia, inverse, gravity, torque, w0)
    c = derivative(moved(state, b, 0.5 * step_s), inertia, inverse, gravity, torque, w0)
    d = derivative(moved(state, c, step_s), inertia, inverse, gravity, torque, w0)
    return blended(state, (a, b, c, d), step_s)


def continuous_torque(spacecraft: OrbitalFrameSpacecraft, state: State, inverse: Inverse) -> Triple:
    """Return the torque of ideal sensors, a continuous computer and ideal wheels, N m."""
    roll, pitch = tilt(state)
    wanted = wanted_torque(spacecraft.law, roll, pitch, body_rate(state, inverse))
    limit = spacecraft.computer.torque_limit_n_m
    return (clipped(wanted[0], limit), clipped(wanted[1], limit), clipped(wanted[2], limit))


def continuous_step(
    spacecraft: OrbitalFrameSpacecraft, state: State, body: tuple[Inverse, Inverse, float, float], step_s: float
) -> State:
    """Return the state after a step in which the law follows the state."""
    inertia, inverse, gravity, w0 = body
    a = derivative(state, inertia, inverse, gravity, continuous_torque(spacecraft, state, inverse), w0)
    s = moved(state, a, 0.5 * step_s)
    b = derivative(s, inertia, inverse, gravity, continuous_torque(spacecraft, s, inverse), w0)
    s = moved(state, b, 0.5 * step_s)
    c = derivative(s, inertia, inverse, gravity, continuous_torque(spacecraft, s, inverse), w0)
    s = moved(state, c, step_s)
    d = derivative(s, inertia, inverse, gravity, continuous_torque(spacecraft, s, inverse), w0)
    return blended(state, (a, b, c, d), step_s)


def write_row(row: FloatArray, time_s: float, state: State, torque: Triple, c: float) -> None:
    """Write one line of the record."""
    roll, pitch, yaw = angles(state)
    row[0], row[1], row[2], row[3] = time_s, roll, pitch, yaw
    row[4], row[5], row[6] = torque[0], torque[1], torque[2]
    row[7], row[8], row[9] = state[7], state[8], state[9]
    row[10] = c


def fly(
    spacecraft: OrbitalFrameSpacecraft,
    state: State,
    tones: FloatArray,
    rate_noise_rad_s: FloatArray,
    tilt_noise_rad: FloatArray,
    record: FloatArray,
) -> tuple[int, int, State]:
    """Fly one period for each row of the noises and record it.

    Parameters
    ----------
    spacecraft : OrbitalFrameSpacecraft
        Bodies, wheels, sensors and law.
    state : State
        At the start.
    tones : ndarray, shape (6, 6)
        Exact step of each tone under a constant torque: four elements of the matrix, two of the input.
    rate_noise_rad_s, tilt_noise_rad : ndarray, shapes (T, 3) and (T, 2)
        Noise of the sensors.
    record : ndarray, shape (T + 1, 11)
        Written: time, s; roll, pitch, yaw, rad; torque of the wheels on the body in the same order, N m; their
        momentum, N m s; roll rate over orbital rate. Torque and rate are those of the period.

    Returns
    -------
    status, periods, state
        ``NO_YAW_ESTIMATE`` when the roll rate leaves the law without a yaw; what was flown until then, and the end.
    """
    j, computer, w0 = spacecraft.inertia, spacecraft.computer, spacecraft.law.orbital_rate_rad_s
    inertia = (j.xx, j.yy, j.zz, j.xy, j.xz, j.yz)
    inverse = inverse_inertia(j.xx, j.yy, j.zz, j.xy, j.xz, j.yz)
    body = (inertia, inverse, 3.0 * w0 * w0 if spacecraft.has_gravity_torque else 0.0, w0)
    step_s = computer.period_s / spacecraft.steps
    flexible = np.zeros((6, 2))
    turns = np.zeros(3)
    shown = tilt(state)
    delay = spacecraft.rate_sensor.delay_periods
    sensed = np.zeros((delay + 1, 3))
    torque = (0.0, 0.0, 0.0)
    write_row(record[0], 0.0, state, torque, body_rate(state, inverse)[0] / w0)
    for period in range(len(rate_noise_rad_s)):
        rate = body_rate(state, inverse)
        measured = tilt(state)
        if spacecraft.vertical_sensor.is_real:
            sensor = spacecraft.vertical_sensor
            seen = bent_tilt(sensor, state, flexible, tilt_noise_rad[period])
            shown = lagged_tilt(sensor, shown, seen, computer.period_s)
            measured = (rounded(shown[0], sensor.quantum_rad, 0), rounded(shown[1], sensor.quantum_rad, 0))
        used = rate
        if spacecraft.rate_sensor.is_real:
            fresh = sensed_rate(spacecraft.rate_sensor, bent_rate(rate, flexible), rate_noise_rad_s[period])
            sensed[period % (delay + 1)] = fresh
            old = sensed[max(period - delay, 0) % (delay + 1)]
            used = (old[0], old[1], old[2])
        used = (used[0], used[1], used[2] + computer.yaw_rate_correction_rad_s)
        wanted = wanted_torque(spacecraft.law, measured[0], measured[1], used)
        if math.isnan(wanted[0]) or math.isnan(wanted[1]) or math.isnan(wanted[2]):
            return NO_YAW_ESTIMATE, period, state
        asked = command(computer, wanted)
        for _ in range(spacecraft.steps):
            if computer.is_sampled:
                torque = given_torque(spacecraft.wheels, asked, state, turns, step_s)
                state = held_step(state, body, torque, step_s)
                if spacecraft.tones.is_real:
                    swing(tones, flexible, torque)
            else:
                torque = continuous_torque(spacecraft, state, inverse)
                state = continuous_step(spacecraft, state, body, step_s)
        write_row(record[period + 1], (period + 1) * computer.period_s, state, torque, used[0] / w0)
    return FLOWN, len(rate_noise_rad_s), state


#: what ``fly`` calls, for the compiler
_KERNEL_STAGES: tuple[Callable[..., Any], ...] = (
    *(orbital_frame_step.times, orbital_frame_step.vertical, orbital_frame_step.normal, orbital_frame_step.half_angles),
    *(inverse_inertia, body_rate, angles, tilt, wanted_torque, derivative, moved, blended),
    *(clipped, rounded, command, bent_tilt, bent_rate, lagged_tilt, sensed_rate, rotor_torque, given_torque, swing),
    *(held_step, continuous_torque, continuous_step, write_row),
)


@lru_cache(maxsize=1)
def compiled_fly() -> Fly:
    """Return ``fly`` compiled: 7 s, and .3 s where an earlier process has kept it."""
    from numba.extending import register_jitable

    from service.core.machine_code import compiled

    for chunk in _KERNEL_STAGES:
        register_jitable(chunk)
    flown: Fly = compiled(fly)
    return flown
