"""Telemetry: on-board mode, wheel momentum, thrusters, body rates, and the disturbances behind them."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from analyzer_sim.epochs import US_PER_DAY, US_PER_H, US_PER_S
from analyzer_sim.streams import FloatArray, first_order, stream
from analyzer_sim.world.orbit import EARTH_RATE_RAD_S, EpochArray
from analyzer_sim.world.scenario.story import RateTelemetry, ResidualTorque, Scenario, WheelTelemetry
from analyzer_sim.world.spacecraft.body import AXES, ROTOR_KG_M2, orbit_normal_in_body

_AXES = ("yaw", "roll", "pitch")


def reported_rates(
    figures: RateTelemetry, seed: int, row_period_s: float, epochs_us: EpochArray, attitude_deg: FloatArray
) -> FloatArray:
    """Return the rates (T, 3) that are told at epochs (T,) of attitudes (T, 3); the first row repeats the second."""
    count, hours = len(epochs_us), row_period_s / 3600.0
    sigma = figures.bias_factor * figures.bias_deg_h
    tau_s = 3600.0 * figures.bias_tau_h
    bias = [first_order(stream(seed, "rate bias", axis), count, row_period_s, sigma, tau_s) for axis in _AXES]
    noise = figures.noise_deg_sqrt_h / math.sqrt(hours) * stream(seed, "rate noise").normal(size=(count, 3))
    error_deg_s = (np.stack(bias, axis=1) + noise) / 3600.0
    return np.asarray(np.round(true_rates(epochs_us, attitude_deg) + error_deg_s, 10))


def true_rates(epochs_us: EpochArray, attitude_deg: FloatArray) -> FloatArray:
    """Return the mean inertial rates (T, 3) of the body from each row to the next; the first row repeats the second."""
    attitude = np.radians(attitude_deg)
    seconds = np.diff(epochs_us) / US_PER_S
    gained, middle = np.diff(attitude, axis=0) / seconds[:, None], 0.5 * (attitude[1:] + attitude[:-1])
    rates = [_rate(*both) for both in zip(gained.tolist(), middle.tolist(), strict=True)]
    return np.asarray(np.degrees([rates[0], *rates]))


def _rate(gained: list[float], attitude: list[float]) -> tuple[float, float, float]:
    """Return the inertial rate about yaw, roll, pitch, rad/s, of angles yaw, roll, pitch that change."""
    (yaw_rate, roll_rate, pitch_rate), (yaw, roll, pitch) = gained, attitude
    x, y, z = orbit_normal_in_body(roll, pitch, yaw)
    cosine, sine = math.cos(roll), math.sin(roll)
    about_x = roll_rate - math.sin(pitch) * yaw_rate
    about_y = cosine * pitch_rate + math.cos(pitch) * sine * yaw_rate
    about_z = math.cos(pitch) * cosine * yaw_rate - sine * pitch_rate
    return about_z - EARTH_RATE_RAD_S * z, about_x - EARTH_RATE_RAD_S * x, about_y - EARTH_RATE_RAD_S * y


#: torque of the Sun's light, N m, order yaw, roll, pitch, and the share of it that is fed forward
SOLAR_TORQUE_N_M = (0.8e-5, 1.36e-5, 0.72e-5)
FED_FORWARD_SHARE = 0.95
#: middle of the shadow at 90 deg East, days UTC, and its length, h
SHADOW_DAY, SHADOW_H = 0.75, 1.2
#: constant torque that gathers in wheels, share of the daily wave
CONSTANT_SHARE = (0.5, 1.0)
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
        for axis, sigma in zip(_AXES, figures.drift_deg_h, strict=True)
    ]
    # of the middle of the step
    days = (epochs_us - scenario.start_us + 0.5 * scenario.row_period_us) / US_PER_DAY
    constant, cosine, sine = _acting_profile(scenario, seed)
    phase = 2.0 * np.pi * days[:, None]
    solar_n_m = np.asarray(constant + cosine * np.cos(phase) + sine * np.sin(phase))
    drift_deg_s = np.stack(drift_deg_h, axis=1) / 3600.0
    if figures.residual is None:
        return Disturbance(drift_deg_s, solar_n_m, (1.0 - FED_FORWARD_SHARE) * solar_n_m)
    unseen_n_m = residual_n_m(figures.residual, seed, days, step_s)
    return Disturbance(drift_deg_s, solar_n_m + unseen_n_m, unseen_n_m)


def residual_n_m(residual: ResidualTorque, seed: int, days: FloatArray, step_s: float) -> FloatArray:
    """Return the torque (T, 3) that nobody knows, at times (T,) in days; its size is drawn evenly by its logarithm."""
    rng = stream(seed, "residual torque")
    least, greatest = np.log(residual.size_n_m)
    size = np.exp(rng.uniform(least, greatest, 3)) * rng.choice([-1.0, 1.0], 3)
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    acts = {
        "constant": np.ones((len(days), 1)),
        "daily": np.cos(2.0 * np.pi * days[:, None] + phase),
        "eclipse": np.abs(days % 1.0 - SHADOW_DAY)[:, None] > SHADOW_H / 48.0,
    }
    # an impulse is the torque of the whole step in which it is given
    is_kicked = days[:, None] * 24.0 % UNLOADING_H < step_s / 3600.0
    kicks = rng.choice([-1.0, 1.0], (len(days), 3)) * is_kicked * residual.kick_n_m_s / step_s
    return np.asarray(size * acts[residual.shape] + kicks)


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


#: time between two records, h
PERIOD_H = 1
#: mode of the phases with sensors, and of operation
SENSOR_MODE = "sensor_pointing"
FORECAST_MODE = "inertial_forecast"


@dataclass(frozen=True, slots=True)
class TelemetryRecord:
    """One record; the ground has it at its epoch."""

    reported_us: int
    onboard_mode: str
    #: wheels along roll, pitch, yaw; None = not in this record
    wheel_momentum_n_m_s: tuple[float, float, float] | None
    thrusters_active: bool
    #: inertial rate of the body about yaw, roll, pitch, deg/s
    body_rate_deg_s: tuple[float, float, float] | None = None


def telemetry(
    scenario: Scenario,
    seed: int,
    burns_us: tuple[int, ...],
    inertia_kg_m2: tuple[float, float, float],
    rows_us: EpochArray,
    attitude_deg: FloatArray,
) -> tuple[TelemetryRecord, ...]:
    """Return the records from the first row to the last; nothing is sent in a pause.

    They are hourly, or of the attitudes (T, 3) of rows (T,) where the story has wheels or a rate sensor of its own.
    """
    if scenario.wheels is not None:
        reported = reported_momentum(scenario, scenario.wheels, seed, inertia_kg_m2, rows_us, attitude_deg)
        records = _records(scenario, scenario.wheels, rows_us, reported)
    else:
        records = _hourly(scenario, seed, burns_us)
    if scenario.rates is None:
        return records
    rates = reported_rates(scenario.rates, seed, scenario.row_period_s, rows_us, attitude_deg)
    return _with_rates(scenario, records, rows_us, rates)


def _with_rates(
    scenario: Scenario, records: tuple[TelemetryRecord, ...], rows_us: EpochArray, rates: FloatArray
) -> tuple[TelemetryRecord, ...]:
    """Return a record with every row: those there are, and new ones, with the rates (T, 3)."""
    own = {record.reported_us: record for record in records}
    made = []
    for epoch_us, (yaw, roll, pitch) in zip(rows_us.tolist(), rates.tolist(), strict=True):
        mode = FORECAST_MODE if epoch_us >= scenario.operation_start_us else SENSOR_MODE
        record = own.pop(epoch_us, None) or TelemetryRecord(epoch_us, mode, None, False)
        made.append(replace(record, body_rate_deg_s=(yaw, roll, pitch)))
    return tuple(sorted((*made, *own.values()), key=lambda record: record.reported_us))


def is_unloaded(scenario: Scenario, from_us: int, to_us: int) -> bool:
    """Return whether thrusters unload the wheels of a story after an epoch and not after another."""
    epochs_us = unloadings_us(scenario)
    return bool(((epochs_us > from_us) & (epochs_us <= to_us)).any())


def _records(
    scenario: Scenario, figures: WheelTelemetry, rows_us: EpochArray, reported: FloatArray
) -> tuple[TelemetryRecord, ...]:
    """Return the records of what is reported (T, 3) with the rows, one a period."""
    period_us = round(60.0 * figures.period_min * US_PER_S)
    records, before_us = [], scenario.start_us
    for row in np.flatnonzero((rows_us - scenario.start_us) % period_us == 0).tolist():
        epoch_us = int(rows_us[row])
        roll, pitch, yaw = reported[row].tolist()
        is_unloading = figures.is_unloading_marked and is_unloaded(scenario, before_us, epoch_us)
        mode = FORECAST_MODE if epoch_us >= scenario.operation_start_us else SENSOR_MODE
        records.append(TelemetryRecord(epoch_us, mode, (roll, pitch, yaw), is_unloading))
        before_us = epoch_us
    return tuple(records)


def _hourly(scenario: Scenario, seed: int, burns_us: tuple[int, ...]) -> tuple[TelemetryRecord, ...]:
    """Return one record an hour that follows from nothing."""
    epochs_us = np.arange(scenario.start_us, scenario.stop_us, PERIOD_H * US_PER_H, dtype=np.int64)
    pauses = [phase for phase in scenario.phases if phase.name == "pause"]
    hours = (epochs_us - scenario.start_us) / US_PER_H
    rng = stream(seed, "telemetry")
    swing, bias, rate, phase_rad = (float(rng.uniform(*r)) for r in ((1.0, 2.0), (-9.0, -7.0), (0.02, 0.05), (0, 6.28)))
    angle = EARTH_RATE_RAD_S * 3600.0 * hours + phase_rad
    momentum = np.stack(
        [swing * np.cos(angle), bias + rate * (hours % UNLOADING_H), swing * np.sin(angle)], axis=1
    ) + 0.01 * rng.normal(size=(len(hours), 3))
    half_us = 20 * 60 * US_PER_S
    return tuple(
        TelemetryRecord(
            epoch_us,
            FORECAST_MODE if epoch_us >= scenario.operation_start_us else SENSOR_MODE,
            (round(roll, 3), round(pitch, 3), round(yaw, 3)),
            (number > 0 and number % UNLOADING_H == 0)
            or any(abs(epoch_us - burn_us) <= half_us for burn_us in burns_us),
        )
        for number, (epoch_us, (roll, pitch, yaw)) in enumerate(zip(epochs_us.tolist(), momentum.tolist(), strict=True))
        if not any(pause.start_us <= epoch_us < pause.stop_us for pause in pauses)
    )
