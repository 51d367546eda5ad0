"""Motion of the spacecraft over a step of time: what moves attitude, drift, rate and momentum, without the state.

    yaw' = -w roll + d_yaw + m_yaw      roll' = w yaw + d_roll + m_roll      pitch' = d_pitch + m_pitch
    d' = -d / tau + noise               m' = h_const + h_cos cos(p) + h_sin sin(p)
    Hx' = o Hz + Tx,  Hz' = -o Hx + Tz,  Hy' = Ty         H N m s along x roll, y pitch, z yaw of the orbital frame

w 1/h, rates in deg/h, torques h as accelerations in deg/h^2; p = phase of the day, zero at midnight UTC, or of the
period of the profile that is fed forward, zero at the beginning of 1970; o = orbital rate, whether roll and yaw
exchange or not. With z = yaw + j roll the transition is a closed form of complex exponentials, exact for steps of a
second and gaps of hours alike; noise of the drifts and waves of the torque are integrated by ten Gauss points.

    h = [n shares | 3 constant torques | 3 cosines | 3 sines | wheels | polarimeters]     each triple yaw, roll, pitch

These hidden states move the spacecraft and stand in no level. A share says how much of a released command was carried
out: nobody knows until its report comes, so it begins at 0 with a sigma of 1. Torques forget so slowly that what was
learned holds for weeks. The functions are compiled as they stand.
"""

import cmath
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray
from service.core.estimation.filtering.filter_model import ORBITAL_RATE_PER_H, RATE
from service.core.estimation.filtering.plant import POLARIMETER, TORQUES, WANDER, WHEEL_STATES, FilterModel

_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(10)
#: below this product of rate and time the quotients of exponentials lose digits
_SMALL = 1e-6
_S_PER_H = 3600.0
_US_PER_H = 3.6e9
#: longest span that ten nodes integrate, h, and the longest share of a wave
_PANEL_H, _PANEL_TURN = 6.0, 0.25
#: longest span over which a torque on the wheels counts as constant, h
_WHEEL_PANEL_H = 1.0 / 6.0
#: torque that gives 1 kg m^2 an acceleration of 1 deg/h^2, N m
_DEG_H2_N_M = math.radians(1.0) / 3600.0**2
#: attitude, drift and rate; the momentum of the wheels moves behind them
_MOVING = RATE.stop


class StepMotion(NamedTuple):
    """Motion over a step of a state with E hidden states."""

    #: (9, 9 + E), or (12, 9 + E) with the momentum of the wheels
    transition: FloatArray
    #: (12,) what commands and a known torque add to attitude, drift, rate and momentum
    push: FloatArray
    #: (9, 9) covariance that the drifts add, deg and deg/h squared
    noise: FloatArray
    #: (11,) variance of attitude, drift, rate, chain and rain beside it
    core_variance: FloatArray


def step_motion(
    model: FilterModel,
    hidden: int,
    unreported: FloatArray,
    from_us: int,
    step_us: int,
    correction_deg: FloatArray,
    late_correction_deg: FloatArray,
    rate_change_deg_h: FloatArray,
    drift_scale: float,
    scale_error: float,
    is_followed: NDArray[np.bool_],
    is_raining: bool,
) -> StepMotion:
    """Return the motion over a step from an epoch.

    Parameters
    ----------
    model : FilterModel
        The spacecraft.
    hidden : int
        Hidden states E of the filter, shares of commands among them.
    unreported : ndarray, shape (n, 2, 3)
        Turns of n unreported commands if executed, deg, and their rates at the end, deg/h.
    from_us, step_us : int, microseconds
        Epoch at which the step begins, and its length, > 0.
    correction_deg, late_correction_deg, rate_change_deg_h : ndarray, shape (3,)
        Commanded angles of the step, those that became known after their time, and rates that torques added.
    drift_scale : float
        Factor on the drift of the settings.
    scale_error : float
        Error of the effect of commands while it is doubted; NaN = as in the settings.
    is_followed : ndarray, shape (3,)
        Whether motion that nobody announced is suspected about each axis.
    is_raining : bool
        Whether rain is kept.
    """
    one = model.plant[0]
    hours, shares = step_us / 1e6 / _S_PER_H, len(unreported)
    rows = _MOVING + 3 if one["has_wheels"] else _MOVING
    transition = np.zeros((rows, _MOVING + hidden))
    write_motion(transition, one["coupling_per_h"], one["drift_tau_h"], hours)
    for number in range(shares):
        for axis in range(3):
            transition[axis, _MOVING + number] = unreported[number, 0, axis]
            transition[RATE.start + axis, _MOVING + number] = unreported[number, 1, axis]
    torques = hidden - shares - one["sensor_states"]
    # a torque that gathers in the wheels moves nothing
    if torques >= TORQUES and (one["is_pushed"] or not one["has_wheels"]):
        write_torques(transition, _MOVING + shares, from_us, step_us, one["coupling_per_h"], one["wave_period_us"])
    push = np.zeros(_MOVING + 3)
    for axis in range(3):
        push[axis] = correction_deg[axis] + late_correction_deg[axis] + 0.5 * hours * rate_change_deg_h[axis]
        push[RATE.start + axis] = rate_change_deg_h[axis]
    if one["has_wheels"]:
        push[_MOVING:] = write_momentum(transition[_MOVING:], model, hidden, from_us, step_us)
    variance = core_variance(
        model, hours, correction_deg, late_correction_deg, rate_change_deg_h, scale_error, is_followed, is_raining
    )
    return StepMotion(transition, push, drift_noise(model, hours, drift_scale), variance)


def write_motion(transition: FloatArray, coupling_per_h: float, tau_h: float, hours: float) -> None:
    """Write the transition (9, 9) of attitude, drift and rate over some hours."""
    turn = complex(0.0, coupling_per_h)
    _write_rotation(transition, 0, cmath.exp(turn * hours), 1.0)
    moved, pitch = _drift_to_attitude(hours, coupling_per_h, tau_h)
    _write_rotation(transition, 3, moved, pitch)
    _write_rotation(transition, 6, _quotient(turn, hours), hours)
    for axis in range(3):
        transition[3 + axis, 3 + axis] = math.exp(-hours / tau_h)
        transition[6 + axis, 6 + axis] = 1.0


def _write_rotation(matrix: FloatArray, first: int, value: complex, pitch: float) -> None:
    """Write a complex factor on yaw + j roll and a real one on pitch into columns of attitude."""
    matrix[0, first], matrix[0, first + 1] = value.real, -value.imag
    matrix[1, first], matrix[1, first + 1] = value.imag, value.real
    matrix[2, first + 2] = pitch


def _quotient(exponent: complex, hours: float) -> complex:
    """Return (exp(exponent * hours) - 1) / exponent, its limit where the exponent vanishes."""
    product = exponent * hours
    if abs(product) > _SMALL:
        return (cmath.exp(product) - 1.0) / exponent
    return hours * (1.0 + 0.5 * product)


def _drift_to_attitude(hours: float, coupling_per_h: float, tau_h: float) -> tuple[complex, float]:
    """Return the effect of a unit drift at the start after some hours, on yaw + j roll and on pitch."""
    decay, turn = complex(-1.0 / tau_h, 0.0), complex(0.0, coupling_per_h)
    # the difference of the two exponentials, written so that a gap of months does not overflow
    return cmath.exp(turn * hours) * _quotient(decay - turn, hours), _quotient(decay, hours).real


def drift_noise(model: FilterModel, hours: float, drift_scale: float) -> FloatArray:
    """Return the covariance (9, 9) that the drifts add over a step, symmetric."""
    one = model.plant[0]
    coupling, tau_h, drift_deg_h = one["coupling_per_h"], one["drift_tau_h"], one["drift_deg_h"]
    noise, response = np.zeros((9, 9)), np.zeros((6, 3))
    for node in range(len(_GAUSS_NODES)):
        elapsed = 0.5 * hours * (1.0 + _GAUSS_NODES[node])
        moved, pitch = _drift_to_attitude(elapsed, coupling, tau_h)
        _write_rotation(response, 0, moved, pitch)
        for axis in range(3):
            response[3 + axis, axis] = math.exp(-elapsed / tau_h)
        span = 0.5 * hours * _GAUSS_WEIGHTS[node]
        for axis in range(3):
            intensity = span * 2.0 * (drift_scale * drift_deg_h[axis]) ** 2 / tau_h
            for i in range(6):
                for j in range(i + 1):
                    noise[i, j] += intensity * response[i, axis] * response[j, axis]
    for i in range(6):
        for j in range(i):
            noise[j, i] = noise[i, j]
    return noise


def core_variance(
    model: FilterModel,
    hours: float,
    correction_deg: FloatArray,
    late_correction_deg: FloatArray,
    rate_change_deg_h: FloatArray,
    scale_error: float,
    is_followed: NDArray[np.bool_],
    is_raining: bool,
) -> FloatArray:
    """Return the variance (11,) that a step adds beside what the drifts do.

    Commanded angles have an error of scale that lasts for a whole command; late ones may be wrong altogether.
    """
    one, variance = model.plant[0], np.zeros(11)
    rows = max(1.0, one["correction_span_s"] / (hours * _S_PER_H))
    angle_error = one["correction_scale"] if math.isnan(scale_error) else scale_error
    rate_error = one["torque_scale"] if math.isnan(scale_error) else scale_error
    for axis in range(3):
        rate = rate_error * rate_change_deg_h[axis]
        walk = one["unannounced_walk_deg"][axis] if is_followed[axis] else 0.0
        variance[axis] = (
            angle_error**2 * rows * correction_deg[axis] ** 2
            + late_correction_deg[axis] ** 2
            + (0.5 * hours * rate) ** 2
            + (walk**2 + one["rate_noise_deg_sqrt_h"] ** 2) * hours
        )
        variance[6 + axis] = rate**2
    rain_db = one["rain_wet_db"] if is_raining else one["rain_dry_db"]
    variance[9], variance[10] = one["chain_walk_db"] ** 2 * hours, rain_db**2 * 60.0 * hours
    return variance


def write_torques(
    transition: FloatArray, first: int, from_us: int, step_us: int, coupling_per_h: float, period_us: int
) -> None:
    """Write the effect of unit torques, nine columns from a place on, on attitude and rate over a step.

    A wave that begins at phase p: cos(p + t) = cos p cos t - sin p sin t, sin(p + t) = sin p cos t + cos p sin t.
    """
    hours, period_h = step_us / _US_PER_H, period_us / _US_PER_H
    turn_per_h = 2.0 * math.pi / period_h
    phase = 2.0 * math.pi * (from_us % period_us) / period_us
    cosine, sine = math.cos(phase), math.sin(phase)
    panels = max(1, math.ceil(hours / min(_PANEL_H, _PANEL_TURN * period_h)))
    edge = hours / panels
    turned, pitch = np.zeros(3, dtype=np.complex128), np.zeros(3)
    for panel in range(panels):
        for node in range(len(_GAUSS_NODES)):
            elapsed = edge * (panel + 0.5 * (1.0 + _GAUSS_NODES[node]))
            exchange = cmath.exp(complex(0.0, coupling_per_h * (hours - elapsed)))
            span = 0.5 * edge * _GAUSS_WEIGHTS[node]
            for part in range(3):
                gained = span * _gained_h(part, elapsed, turn_per_h)
                turned[part] += exchange * gained
                pitch[part] += gained
    for torque in range(3):
        for part in range(3):
            # share of the responses to a constant, a cosine and a sine of phase zero
            share = 1.0 if torque == 0 and part == 0 else 0.0
            if torque == 1 and part > 0:
                share = cosine if part == 1 else -sine
            if torque == 2 and part > 0:
                share = sine if part == 1 else cosine
            column = first + 3 * torque
            transition[0, column] += share * turned[part].real
            transition[0, column + 1] -= share * turned[part].imag
            transition[1, column] += share * turned[part].imag
            transition[1, column + 1] += share * turned[part].real
            transition[2, column + 2] += share * pitch[part]
            for axis in range(3):
                transition[6 + axis, column + axis] += share * _gained_h(part, hours, turn_per_h)


def write_wave(
    wave: FloatArray, mean: FloatArray, covariance: FloatArray, first: int, epoch_us: int, period_us: int
) -> None:
    """Write the torque of the nine states from a place on (4, 3): constant, cosine and sine since an epoch, its sigma.

    What was a cosine since phase zero is a cosine and a sine since the epoch.
    """
    phase = 2.0 * math.pi * (epoch_us % period_us) / period_us
    cos, sin = math.cos(phase), math.sin(phase)
    for axis in range(3):
        one, two, three = first + axis, first + axis + 3, first + axis + 6
        wave[0, axis] = mean[one]
        wave[1, axis], wave[2, axis] = cos * mean[two] + sin * mean[three], cos * mean[three] - sin * mean[two]
        variance = covariance[one, one] + 2.0 * (cos * covariance[one, two] + sin * covariance[one, three])
        variance += cos**2 * covariance[two, two] + 2.0 * cos * sin * covariance[two, three]
        # the covariance of a profile has no full rank: rounding may leave less than nothing
        wave[3, axis] = math.sqrt(max(0.0, variance + sin**2 * covariance[three, three]))


def _gained_h(part: int, hours: float, turn_per_h: float) -> float:
    """Return the rate that a constant (0), a cosine (1) or a sine (2) of one has left after some hours."""
    angle = turn_per_h * hours
    if part == 0:
        return hours
    if part == 1:
        return math.sin(angle) / turn_per_h
    return 2.0 * math.sin(0.5 * angle) ** 2 / turn_per_h


def write_momentum(rows: FloatArray, model: FilterModel, hidden: int, from_us: int, step_us: int) -> FloatArray:
    """Write the effect of the states on the momentum of the wheels over a step, and return what is added (3,), N m s.

    Rows (3, 9 + E) of roll, pitch, yaw begin with zeros.
    """
    one = model.plant[0]
    hours, period_h = step_us / _US_PER_H, one["wave_period_us"] / _US_PER_H
    phase = 2.0 * math.pi * (from_us % one["wave_period_us"]) / one["wave_period_us"]
    own = _MOVING + hidden - one["sensor_states"]
    torque = torque_of_wheels(model, own)
    panels = max(1, math.ceil(hours / _WHEEL_PANEL_H))
    span_h, push, effect = hours / panels, np.zeros(3), np.zeros((3, TORQUES))
    for panel in range(panels):
        elapsed_h = (panel + 0.5) * span_h
        wave = phase + 2.0 * math.pi * elapsed_h / period_h
        turn = momentum_turn(hours - elapsed_h)
        for body in range(3):
            # roll, pitch, yaw among yaw, roll, pitch
            axis = (body + 1) % 3
            unit = one["inertia_kg_m2"][axis] * _DEG_H2_N_M * 3600.0 * span_h
            for row in range(3):
                pushed = turn[row, body] * unit
                effect[row, axis] += pushed
                effect[row, 3 + axis] += math.cos(wave) * pushed
                effect[row, 6 + axis] += math.sin(wave) * pushed
    turn = momentum_turn(hours)
    for row in range(3):
        if one["has_gathered_torque"] or one["has_torque"]:
            rows[row, torque : torque + TORQUES] = effect[row]
        rows[row, own : own + 3] = turn[row]
        for number in range(TORQUES):
            push[row] += effect[row, number] * one["profile_deg_h2"][number]
    return push


def torque_of_wheels(model: FilterModel, first: int) -> int:
    """Return the place of the torque that gathers in the wheels, whose momentum stands at `first`.

    One of its own stands behind momentum, misalignment and scales; that which also pushes the body before them.
    """
    if model.plant[0]["has_gathered_torque"]:
        return first + WHEEL_STATES
    return first - TORQUES


def momentum_turn(hours: float) -> FloatArray:
    """Return the turn (3, 3) of the momentum over some hours."""
    cosine, sine = math.cos(ORBITAL_RATE_PER_H * hours), math.sin(ORBITAL_RATE_PER_H * hours)
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])


def walked_variance(model: FilterModel, step_us: int) -> float:
    """Return the variance that a step adds to the momentum by torques of which nobody knows, (N m s)^2."""
    return float(model.plant[0]["walk_n_m_s_sqrt_s"] ** 2 * step_us / 1e6)


def hidden_decay(model: FilterModel, hidden: int, shares: int, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Return the factor (E,) by which hidden states decay over a step, and the variance (E,) that keeps them alive."""
    one, feeds = model.plant[0], model.feeds
    factor, variance = np.ones(hidden), np.zeros(hidden)
    kept = math.exp(-seconds / (_S_PER_H * one["torque_tau_h"]))
    if hidden - shares - one["sensor_states"] >= TORQUES:
        for number in range(TORQUES):
            factor[shares + number] = kept
            variance[shares + number] = one["torque_prior_deg_h2"][number] ** 2 * (1.0 - kept**2)
    behind = hidden - POLARIMETER * len(feeds)
    if one["has_gathered_torque"]:
        for number in range(TORQUES):
            factor[behind - TORQUES + number] = kept
            variance[behind - TORQUES + number] = one["gathered_prior_deg_h2"][number] ** 2 * (1.0 - kept**2)
    for number in range(len(feeds)):
        place = behind + POLARIMETER * number + WANDER
        factor[place] = math.exp(-seconds / (_S_PER_H * feeds["wander_h"][number]))
        variance[place] = feeds["wander_deg"][number] ** 2 * (1.0 - factor[place] ** 2)
    return factor, variance
