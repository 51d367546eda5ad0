"""Disturbance: what moves the body in closed loop beside the commanded torques.

The light of the Sun turns the spacecraft by some 1e-5 N m that go round once a day; 95 % of it is known on board and
fed forward, the rest acts. Roll and pitch are a quarter of a day apart, so that one of them is always pushed:
left alone from rest the spacecraft leaves 0.3 deg in one to two hours. A story may have another torque in place of this
rest: a constant or a daily wave of which nobody knows. The drift of the inertial model is that of the story.
"""

from typing import NamedTuple

import numpy as np

from analyzer_sim.epochs import US_PER_DAY, US_PER_S
from analyzer_sim.streams import FloatArray, stream
from analyzer_sim.world.noise import first_order
from analyzer_sim.world.orbit.orbit import EpochArray
from analyzer_sim.world.scenario.story import ResidualTorque, Scenario, WheelTelemetry

#: torque of the Sun's light, N m, order yaw, roll, pitch, and the share of it that is fed forward
SOLAR_TORQUE_N_M = (0.8e-5, 1.36e-5, 0.72e-5)
FED_FORWARD_SHARE = 0.95
#: constant torque that gathers in wheels, share of the daily wave
CONSTANT_SHARE = (0.5, 1.0)
AXES = ("yaw", "roll", "pitch")
#: positions of yaw, roll, pitch among roll, pitch, yaw, and the other way round
_YAW_FIRST, _ROLL_FIRST = [2, 0, 1], [1, 2, 0]


class Disturbance(NamedTuple):
    """Disturbances in the step after each row of operation; (T, 3), order yaw, roll, pitch."""

    drift_deg_s: FloatArray
    #: whole external torque, before any of it is fed forward, and the part that is not
    external_n_m: FloatArray
    unseen_n_m: FloatArray


class TorqueProfile(NamedTuple):
    """Torque of (3,) N m: constant + cosine cos(p) + sine sin(p), p zero where the story begins, once round a day."""

    constant_n_m: FloatArray
    cosine_n_m: FloatArray
    sine_n_m: FloatArray


class FedForward(NamedTuple):
    """Torque that the loop on board feeds forward, N m, yaw, roll, pitch: constant + cosine cos(p) + sine sin(p)."""

    #: where p is zero
    epoch_us: int
    period_s: float
    constant_n_m: FloatArray
    cosine_n_m: FloatArray
    sine_n_m: FloatArray


def fed_forward(scenario: Scenario, seed: int) -> FedForward:
    """Return what the loop on board feeds forward; the ground wrote it, so it is known there."""
    profile = (FED_FORWARD_SHARE * part for part in _acting_profile(scenario, seed))
    return FedForward(scenario.start_us, US_PER_DAY / US_PER_S, *profile)


def _acting_profile(scenario: Scenario, seed: int) -> TorqueProfile:
    """Return the torque about yaw, roll, pitch; in a story with wheels it is what gathers in them."""
    if scenario.wheels is None:
        return _solar_profile(seed)
    return TorqueProfile(*(part[_YAW_FIRST] for part in gathered_profile(scenario.wheels, seed)))


def _solar_profile(seed: int) -> TorqueProfile:
    """Return the Sun's torque about yaw, roll, pitch."""
    size, phase = np.array(SOLAR_TORQUE_N_M), _solar_phase_rad(seed)
    return TorqueProfile(np.zeros(3), size * np.cos(phase), -size * np.sin(phase))


def wave_size_n_m(figures: WheelTelemetry) -> FloatArray:
    """Return the size (3,) of the daily wave that gathers in wheels along roll, pitch, yaw."""
    if figures.torque_n_m is None:
        return np.array(SOLAR_TORQUE_N_M)[_ROLL_FIRST]
    return np.full(3, figures.torque_n_m)


def gathered_profile(figures: WheelTelemetry, seed: int) -> TorqueProfile:
    """Return the torque about roll, pitch, yaw that gathers in wheels, without what no profile states."""
    if figures.torque_n_m is None:
        return TorqueProfile(*(part[_ROLL_FIRST] for part in _solar_profile(seed)))
    rng = stream(seed, "wheel torque")
    constant = figures.torque_n_m * rng.uniform(*CONSTANT_SHARE, 3) * rng.choice([-1.0, 1.0], 3)
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    return TorqueProfile(constant, figures.torque_n_m * np.cos(phase), figures.torque_n_m * np.sin(phase))


def stated_profile(figures: WheelTelemetry, seed: int) -> TorqueProfile:
    """Return the torque about roll, pitch, yaw that the ground believes to gather in wheels."""
    rng = stream(seed, "wheel torque stated")
    share = 1.0 + figures.profile_error * rng.normal() + figures.axis_profile_error * rng.normal(size=3)
    return TorqueProfile(*(part / share for part in gathered_profile(figures, seed)))


def _solar_phase_rad(seed: int) -> FloatArray:
    """Return the phase (3,) of the Sun's torque where the story begins."""
    rng = stream(seed, "solar torque")
    first = rng.uniform(0.0, 2.0 * np.pi)
    apart = np.array([rng.uniform(0.0, 2.0 * np.pi), 0.0, rng.choice([-0.5, 0.5]) * np.pi])
    return np.asarray(first + apart)


def disturbance(scenario: Scenario, seed: int, epochs_us: EpochArray) -> Disturbance:
    """Return drift and the torque of the Sun for the epochs (T,) of the operation phase."""
    figures, count, step_s = scenario.keeping, len(epochs_us), scenario.row_period_s
    drift_deg_h = [
        first_order(stream(seed, "drift", axis), count, step_s, sigma, figures.drift_tau_s)
        for axis, sigma in zip(AXES, figures.drift_deg_h, strict=True)
    ]
    # of the middle of the step
    days = (epochs_us - scenario.start_us + 0.5 * scenario.row_period_us) / US_PER_DAY
    constant, cosine, sine = _acting_profile(scenario, seed)
    phase = 2.0 * np.pi * days[:, None]
    solar_n_m = np.asarray(constant + cosine * np.cos(phase) + sine * np.sin(phase))
    drift_deg_s = np.stack(drift_deg_h, axis=1) / 3600.0
    if figures.residual is None:
        return Disturbance(drift_deg_s, solar_n_m, (1.0 - FED_FORWARD_SHARE) * solar_n_m)
    unseen_n_m = residual_n_m(figures.residual, seed, days)
    return Disturbance(drift_deg_s, solar_n_m + unseen_n_m, unseen_n_m)


def residual_n_m(residual: ResidualTorque, seed: int, days: FloatArray) -> FloatArray:
    """Return the torque (T, 3) that nobody knows, at times (T,) in days; its size is drawn evenly by its logarithm."""
    rng = stream(seed, "residual torque")
    least, greatest = np.log(residual.size_n_m)
    size = np.exp(rng.uniform(least, greatest, 3)) * rng.choice([-1.0, 1.0], 3)
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    wave = np.cos(2.0 * np.pi * days[:, None] + phase) if residual.is_daily else np.ones((len(days), 1))
    return np.asarray(size * wave)
