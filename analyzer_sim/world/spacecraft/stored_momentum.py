"""Stored momentum: what wheels hold while the spacecraft has an attitude and a torque acts from outside.

    Hx' = w0 Hz + Tx,  Hz' = -w0 Hx + Tz,  Hy' = Ty      H of the whole spacecraft, orbital frame, x roll, z yaw
    h = C H - J w                                        of the wheels, in the body; C, w as in `body_dynamics`
    reported = round_q((1 + s) (h + e x h) + noise)      s scale, e misalignment, q the momentum of one rpm

With z = Hx + i Hz the first two are z' = -i w0 z + T. Twice a day thrusters take away what has gathered. Vectors about
x roll, y pitch, z yaw; N m s.
"""

import numpy as np

from analyzer_sim.epochs import US_PER_H, US_PER_S
from analyzer_sim.streams import FloatArray, stream
from analyzer_sim.world.noise import first_order
from analyzer_sim.world.orbit.orbit import EARTH_RATE_RAD_S, EpochArray
from analyzer_sim.world.scenario.story import Scenario, WheelTelemetry
from analyzer_sim.world.spacecraft.body_dynamics import orbit_normal_in_body
from analyzer_sim.world.spacecraft.disturbance import gathered_profile, wave_size_n_m
from analyzer_sim.world.spacecraft.wheels import AXES, ROTOR_KG_M2

#: time between two unloadings, h
UNLOADING_H = 12
#: momentum of one rpm of a rotor
QUANTUM_N_M_S = ROTOR_KG_M2 * np.pi / 30.0
#: greatest momentum along roll and yaw after an unloading, share of its size
UNLOADED_SHARE = 0.3
_DAY_RAD_US = 2.0 * np.pi / (24 * US_PER_H)


def unloadings_us(scenario: Scenario) -> EpochArray:
    """Return the epochs of the unloadings."""
    first_us = scenario.start_us + UNLOADING_H * US_PER_H
    return np.arange(first_us, scenario.stop_us, UNLOADING_H * US_PER_H, dtype=np.int64)


def reported_momentum(
    scenario: Scenario,
    figures: WheelTelemetry,
    seed: int,
    inertia_kg_m2: tuple[float, float, float],
    epochs_us: EpochArray,
    attitude_deg: FloatArray,
) -> FloatArray:
    """Return what the wheels are reported to hold (T, 3) at epochs (T,) of attitudes (T, 3), yaw, roll, pitch."""
    whole = _whole_momentum(scenario, figures, seed, epochs_us)
    attitude = np.radians(attitude_deg)
    rate = np.gradient(attitude, epochs_us / US_PER_S, axis=0)[:, [1, 2, 0]]
    stored = np.empty((len(epochs_us), 3))
    for row, (yaw, roll, pitch) in enumerate(attitude.tolist()):
        turn = rate[row] - EARTH_RATE_RAD_S * np.array(orbit_normal_in_body(roll, pitch, yaw))
        stored[row] = _orbital_to_body(roll, pitch, yaw) @ whole[row] - np.array(inertia_kg_m2) * turn
    return with_errors(figures, seed, stored, stream(seed, "wheel noise").normal(size=stored.shape))


def with_errors(figures: WheelTelemetry, seed: int, stored: FloatArray, noise: FloatArray) -> FloatArray:
    """Return what is reported of stored momentum (.., 3); noise (.., 3) of unit variance."""
    rng = stream(seed, "wheel errors")
    skew = np.radians(rng.normal(0.0, figures.misalignment_deg, 3))
    scale = 1.0 + rng.normal(0.0, figures.scale_error, 3)
    exact = scale * (stored + np.cross(skew, stored)) + figures.noise_n_m_s * noise
    return np.asarray(np.round(QUANTUM_N_M_S * np.round(exact / QUANTUM_N_M_S), 6))


def unloaded(figures: WheelTelemetry, seed: int, number: int) -> FloatArray:
    """Return the momentum (3,) that an unloading leaves."""
    rng = stream(seed, "unloading", str(number))
    x, z = rng.uniform(-UNLOADED_SHARE, UNLOADED_SHARE, 2) * figures.unloading_n_m_s
    return np.array([x, figures.bias_n_m_s, z])


def _whole_momentum(scenario: Scenario, figures: WheelTelemetry, seed: int, epochs_us: EpochArray) -> FloatArray:
    """Return the momentum (T, 3) of the whole spacecraft in the orbital frame."""
    torque = _torque_n_m(scenario, figures, seed, epochs_us)
    steps_s = np.diff(epochs_us) / US_PER_S
    middle = 0.5 * (torque[1:] + torque[:-1])
    turned = np.exp(-1j * EARTH_RATE_RAD_S * steps_s)
    pushed = (middle[:, 0] + 1j * middle[:, 2]) * np.exp(-0.5j * EARTH_RATE_RAD_S * steps_s) * steps_s
    along = middle[:, 1] * steps_s
    number = np.searchsorted(unloadings_us(scenario), epochs_us, side="right")
    whole = np.empty((len(epochs_us), 3))
    whole[0] = unloaded(figures, seed, 0)
    across, pitch = complex(whole[0, 0], whole[0, 2]), float(whole[0, 1])
    for row in range(1, len(epochs_us)):
        across, pitch = turned[row - 1] * across + pushed[row - 1], pitch + along[row - 1]
        if number[row] > number[row - 1]:
            x, pitch, z = unloaded(figures, seed, int(number[row])).tolist()
            across = complex(x, z)
        whole[row] = across.real, pitch, across.imag
    return whole


def _torque_n_m(scenario: Scenario, figures: WheelTelemetry, seed: int, epochs_us: EpochArray) -> FloatArray:
    """Return the torque (T, 3) that acts."""
    profile = gathered_profile(figures, seed)
    angle = _DAY_RAD_US * (epochs_us - scenario.start_us)[:, None]
    known = profile.constant_n_m + profile.cosine_n_m * np.cos(angle) + profile.sine_n_m * np.sin(angle)
    phase = stream(seed, "wheel torque half day").uniform(0.0, 2.0 * np.pi, 3)
    half = figures.half_day_share * wave_size_n_m(figures) * np.cos(2.0 * angle + phase)
    unknown = [
        first_order(
            stream(seed, "wheel torque unknown", axis),
            len(epochs_us),
            scenario.row_period_s,
            figures.unknown_n_m,
            figures.unknown_tau_s,
        )
        for axis in AXES
    ]
    return np.asarray(known + half + np.stack(unknown, axis=1))


def _orbital_to_body(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Return the matrix from the orbital frame to the body, sequence yaw, pitch, roll."""
    about_z = np.array([[np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[np.cos(pitch), 0.0, -np.sin(pitch)], [0.0, 1.0, 0.0], [np.sin(pitch), 0.0, np.cos(pitch)]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(roll), np.sin(roll)], [0.0, -np.sin(roll), np.cos(roll)]])
    return np.asarray(about_x @ about_y @ about_z)
