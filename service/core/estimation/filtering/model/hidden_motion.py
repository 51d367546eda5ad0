"""Hidden states: what moves the spacecraft without standing in any level, and what other sensors have wrong.

    h = [n shares | 3 constant torques | 3 cosines | 3 sines | sensors]         each triple yaw, roll, pitch
    m' = h_const + h_cos cos(p) + h_sin sin(p)       p = phase of the day, zero at midnight UTC, or of the period of
                                                     the profile that is fed forward, zero at the beginning of 1970

A share says how much of a released command was carried out: nobody knows until its report comes, so it begins at 0 with
a sigma of 1. Torques stand as angular accelerations in deg/h^2; they act on the rates of the body, which is where the
loop on board lets go what it does not feed forward, and roll and yaw exchange through the attitude as ever. They
forget so slowly that what was learned holds for weeks. How large they may be stands in `torque_prior`. The law of this
file: hidden states do not move one another.
"""

import cmath
import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray
from service.core.estimation.filtering.model.filter_model import (
    RATE,
    CarrierModel,
    FilterSettings,
    Gaussian,
    KnownMotion,
    common_states,
    core_size,
    hidden_count,
)
from service.core.estimation.filtering.model.polarimeter import POLARIMETER, polarimeter_noise
from service.core.estimation.filtering.model.torque_prior import (
    TORQUES,
    gathered_prior_deg_h2,
    has_torque,
    is_pushed,
    scale_covariance,
    torque_prior_deg_h2,
    torque_size_deg_h2,
    wave_period_us,
)

#: states of the momentum of the wheels, behind the torques: momentum, misalignment, scales
_MOMENTUM = 7
#: one standard deviation of the share of a command that nobody has reported
SHARE_SIGMA = 1.0
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(10)
_US_PER_H = 3.6e9
#: a torque that motion makes doubtful may be this many times what was stated, and have been so for this long, h
_DOUBT = 5.0
_DOUBTED_H = 2.0
#: chi-square of three degrees of freedom that chance exceeds once in a thousand
_SEEN_CHI_SQUARE = 16.27
#: longest span that ten nodes integrate, h
_PANEL_H = 6.0
#: and the longest share of a wave
_PANEL_TURN = 0.25


class Response(NamedTuple):
    """Response after a step to a constant, a cosine and a sine that begin at phase zero, (3,) each."""

    #: gained rate per acceleration, h
    rate_h: FloatArray
    #: turns of yaw and roll, h^2: the real part of yaw + j roll is the axis' own, the imaginary the other's
    turned_h2: tuple[complex, complex, complex]
    #: turn of pitch, h^2
    pitch_h2: FloatArray


@lru_cache(maxsize=64)
def response_over(step_us: int, coupling_per_h: float, period_us: int) -> Response:
    """Return the response to unit accelerations over a step, us, under an exchange of roll and yaw, 1/h."""
    hours, period_h = step_us / _US_PER_H, period_us / _US_PER_H
    angular_rate_per_h = 2.0 * math.pi / period_h
    panels = max(1, math.ceil(hours / min(_PANEL_H, _PANEL_TURN * period_h)))
    edge = hours / panels
    turned, pitch = np.zeros(3, dtype=np.complex128), np.zeros(3)
    for panel in range(panels):
        for node, weight in zip(_GAUSS_NODES.tolist(), _GAUSS_WEIGHTS.tolist(), strict=True):
            elapsed = edge * (panel + 0.5 * (1.0 + node))
            gained = 0.5 * edge * weight * _gained_h(elapsed, angular_rate_per_h)
            turned += cmath.exp(complex(0.0, coupling_per_h * (hours - elapsed))) * gained
            pitch += gained
    constant, cosine, sine = turned.tolist()
    return Response(_gained_h(hours, angular_rate_per_h), (constant, cosine, sine), pitch)


def _gained_h(hours: float, angular_rate_per_h: float) -> FloatArray:
    """Return the rate (3,) that a constant, a cosine and a sine of one have left after some hours."""
    angle = angular_rate_per_h * hours
    return np.array(
        [hours, math.sin(angle) / angular_rate_per_h, 2.0 * math.sin(0.5 * angle) ** 2 / angular_rate_per_h]
    )


def momentum_count(settings: FilterSettings) -> int:
    """Return how many states the momentum of the wheels has.

    Where one torque pushes the body and another of unknown profile gathers in the wheels, the nine of that stand last.
    """
    wheels = settings.momentum
    if wheels is None:
        return 0
    return _MOMENTUM + TORQUES * (wheels.unknown_torque_deg_h2 is not None and is_pushed(settings))


def hidden_transition(
    hidden: int, from_us: int, step_us: int, settings: FilterSettings, known: KnownMotion
) -> FloatArray:
    """Return the effect of the hidden states on attitude, drift and rate over a step, (9, E).

    Parameters
    ----------
    hidden : int
        E of the state.
    from_us, step_us : int, microseconds
        Epoch at which the step begins, and its length.
    settings : FilterSettings
        The spacecraft.
    known : KnownMotion
        With what the commands would do that nobody has reported.

    Raises
    ------
    ValueError
        The state has other shares than there are commands.
    """
    shares = len(known.unreported)
    torques = hidden - shares - sensor_states(settings)
    if torques != TORQUES * has_torque(settings) and (settings.momentum is not None or torques not in (0, TORQUES)):
        message = f"{shares} commands are unreported, which does not fit {hidden} hidden states"
        raise ValueError(message)
    matrix = np.zeros((9, hidden))
    matrix[0:3, :shares], matrix[6:9, :shares] = known.unreported[:, 0].T, known.unreported[:, 1].T
    # a torque that gathers in the wheels moves nothing
    if torques < TORQUES or not (is_pushed(settings) or settings.momentum is None):
        return matrix
    period_us = wave_period_us(settings)
    phase = 2.0 * math.pi * (from_us % period_us) / period_us
    constant, by_cosine, by_sine = _torque_waves(step_us, settings.coupling_per_h, period_us)
    effect = constant + math.cos(phase) * by_cosine + math.sin(phase) * by_sine
    matrix[:, shares : shares + TORQUES] = effect
    return matrix


@lru_cache(maxsize=64)
def _torque_waves(step_us: int, coupling_per_h: float, period_us: int) -> FloatArray:
    """Return the parts (3, 9, 9) of the effect of the torques: constant, by cosine and by sine of the first phase.

    Nobody may write to them.
    """
    response, waves = response_over(step_us, coupling_per_h, period_us), np.zeros((3, 9, TORQUES))
    # a wave that begins at a phase: cos(p + t) = cos p cos t - sin p sin t, sin(p + t) = sin p cos t + cos p sin t
    for part, torque, of, sign in ((0, 0, 0, 1.0), (1, 1, 1, 1.0), (2, 1, 2, -1.0), (1, 2, 2, 1.0), (2, 2, 1, 1.0)):
        own, turned, first = waves[part], sign * response.turned_h2[of], 3 * torque
        own[0:2, first : first + 2] = [[turned.real, -turned.imag], [turned.imag, turned.real]]
        own[2, first + 2] = sign * response.pitch_h2[of]
        own[(6, 7, 8), (first, first + 1, first + 2)] = sign * response.rate_h[of]
    return waves


@lru_cache(maxsize=64)
def hidden_noise(hidden: int, shares: int, settings: FilterSettings) -> tuple[FloatArray, FloatArray]:
    """Return sigma (E,) and correlation time (E,), s, of the noise that keeps the hidden states alive.

    Nobody may write to the arrays, here and in what follows.
    """
    sensors = sensor_states(settings)
    sigma, tau_s = np.zeros(hidden), np.full(hidden, np.inf)
    if hidden - shares - sensors >= TORQUES:
        own = slice(shares, shares + TORQUES)
        sigma[own], tau_s[own] = torque_prior_deg_h2(settings), 3600.0 * settings.torque_tau_h
    behind = hidden - POLARIMETER * len(settings.polarimeters)
    if momentum_count(settings) > _MOMENTUM:
        own = slice(behind - TORQUES, behind)
        sigma[own], tau_s[own] = gathered_prior_deg_h2(settings), 3600.0 * settings.torque_tau_h
    sigma[behind:], tau_s[behind:] = polarimeter_noise(settings)
    return sigma, tau_s


def sensor_states(settings: FilterSettings) -> int:
    """Return the number of hidden states of other sensors, the last ones: the wheels, then each polarimeter."""
    return momentum_count(settings) + POLARIMETER * len(settings.polarimeters)


def sensors_first(model: CarrierModel, gaussian: Gaussian, settings: FilterSettings) -> int:
    """Return the place of the first state of the other sensors."""
    return core_size(model, hidden_count(model, len(gaussian.mean))) - sensor_states(settings)


@lru_cache(maxsize=64)
def scale_noise(settings: FilterSettings, hours: float) -> FloatArray:
    """Return the covariance that a step adds to the torque states to keep the shares of a known profile alive.

    Empty, (0, 0), where the loop on board feeds no profile forward.
    """
    if settings.fed_forward is None:
        return np.zeros((0, 0))
    return -math.expm1(-2.0 * hours / settings.torque_tau_h) * scale_covariance(settings.fed_forward)


def torque_states(model: CarrierModel, state: Gaussian, shares: int, sensors: int = 0) -> slice | None:
    """Return the places of the torque states, None where there are none; `sensors` as `sensor_states` counts them."""
    hidden = hidden_count(model, len(state.mean)) - sensors
    first = common_states(model).stop + shares
    return slice(first, first + TORQUES) if hidden - shares >= TORQUES else None


def inserted(state: Gaussian, position: int, new_covariance: FloatArray) -> Gaussian:
    """Return the state with new ones of a covariance (n, n) at a place, zero and correlated with nothing before."""
    added = len(new_covariance)
    size = len(state.mean) + added
    kept = np.concatenate([np.arange(position), np.arange(position + added, size)])
    mean, covariance = np.zeros(size), np.zeros((size, size))
    mean[kept] = state.mean
    covariance[np.ix_(kept, kept)] = state.covariance
    new = np.arange(position, position + added)
    covariance[np.ix_(new, new)] = new_covariance
    return Gaussian(mean, covariance)


def dropped(state: Gaussian, positions: slice) -> Gaussian:
    """Return the state without some: what the others owe to them stays their uncertainty."""
    covariance = np.delete(np.delete(state.covariance, positions, axis=0), positions, axis=1)
    return Gaussian(np.delete(state.mean, positions), covariance)


def with_wider_torque(gaussian: Gaussian, positions: slice, variance: FloatArray) -> Gaussian:
    """Return the state whose torques are known less by a variance (9,), (deg/h^2)^2."""
    covariance = gaussian.covariance.copy()
    at = np.arange(positions.start, positions.start + TORQUES)
    covariance[at, at] += variance
    return Gaussian(gaussian.mean, covariance)


def with_doubted_torque(model: CarrierModel, gaussian: Gaussian, settings: FilterSettings, axes: BoolArray) -> Gaussian:
    """Return the state whose torque about some axes (3,) may be greater than was stated."""
    # shares stand before the torques, other sensors behind them
    sensors = sensor_states(settings)
    shares = max(0, hidden_count(model, len(gaussian.mean)) - TORQUES - sensors)
    positions = torque_states(model, gaussian, shares, sensors)
    if positions is None:
        return gaussian
    covariance = gaussian.covariance.copy()
    size = np.maximum(_DOUBT * torque_size_deg_h2(settings), settings.unknown_torque_deg_h2)
    for axis in np.flatnonzero(axes).tolist():
        together = np.array([RATE.start + axis, positions.start + axis])
        gained = size[axis] * np.array([_DOUBTED_H, 1.0])
        covariance[np.ix_(together, together)] += np.multiply.outer(gained, gained)
        wave = positions.start + 3 + axis, positions.start + 6 + axis
        covariance[wave, wave] = np.maximum(covariance[wave, wave], 0.5 * settings.unknown_torque_deg_h2[axis] ** 2)
    return Gaussian(gaussian.mean, covariance)


def is_torque_seen(gaussian: Gaussian, positions: slice) -> bool:
    """Return whether the torque about any axis, constant and wave together, differs from none beyond chance."""
    for axis in range(3):
        own = np.arange(positions.start + axis, positions.stop, 3)
        mean = gaussian.mean[own]
        if float(mean @ np.linalg.solve(gaussian.covariance[np.ix_(own, own)], mean)) > _SEEN_CHI_SQUARE:
            return True
    return False
