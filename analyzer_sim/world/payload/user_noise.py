"""Noise of the levels and of the receiving chain: white, coloured, flicker, days of temperature, wander.

Flicker noise is a sum of first-order parts whose correlation times reach from minutes to a day; each part of each
carrier draws from a stream of its own, so that a part more or less moves no other.
"""

from typing import NamedTuple

import numpy as np

from analyzer_sim.instrument.spectrum import ENBW_PER_RBW
from analyzer_sim.streams import FloatArray, stream
from analyzer_sim.world.noise import daily_wave, first_order
from analyzer_sim.world.payload.carriers import Carrier, CarrierPlan
from analyzer_sim.world.scenario.story import Part, Scenario, StationNoise

#: the sweep for which the plan's white noise is split: RBW, duration
SWEEP_RBW_HZ = 30e3
SWEEP_TIME_S = 2.0
_MIN_WHITE_DB = 0.05
#: what the temperature of the satellite does to a beacon: a typical change from day to day, dB
BEACON_DRIFT_DB_DAY = 0.05
BEACON_TAU_S = 86_400.0


def sweep_sigma_db(plan: CarrierPlan) -> FloatArray:
    """Return the noise (N,) that the default sweep itself adds to each carrier's power, dB.

    `4.343 / sqrt(1.505 RBW T B / span)`, B = symbol rate; of a beacon `4.343 sqrt(2 / (C/N0 t))`, t = the dwell of one
    noise bandwidth.
    """
    dwell_s_hz = SWEEP_TIME_S / (plan.span_hz[1] - plan.span_hz[0])
    sigma = []
    for carrier in plan.carriers:
        c_n0 = 10.0 ** (carrier.c_n0_db_hz / 10.0)
        line = 0.5 * c_n0 * dwell_s_hz * ENBW_PER_RBW * SWEEP_RBW_HZ
        sigma.append(line if carrier.is_beacon else 1.505 * SWEEP_RBW_HZ * dwell_s_hz * carrier.symbol_rate_hz)
    return np.asarray(4.343 / np.sqrt(sigma))


def world_white_db(plan: CarrierPlan) -> FloatArray:
    """Return the white noise (N,) that with the sweep's own share makes up the plan's figure, dB."""
    total = np.array([carrier.white_db for carrier in plan.carriers])
    least = np.array([0.0 if carrier.is_beacon else _MIN_WHITE_DB for carrier in plan.carriers])
    return np.asarray(np.sqrt(np.maximum(total**2 - sweep_sigma_db(plan) ** 2, least**2)))


def chain_noise_db(scenario: Scenario, seed: int, seconds: FloatArray) -> FloatArray:
    """Return the drift (T,) of the receiving chain."""
    figures = scenario.noise
    rng = stream(seed, "chain")
    wave = daily_wave(rng, seconds, figures.chain_daily_db)
    slow = wave + first_order(rng, len(seconds), scenario.row_period_s, figures.chain_db, figures.chain_tau_s)
    return np.asarray(slow + _flicker_db(seed, "chain", figures.chain_flicker, scenario, len(seconds)))


def users_noise_db(plan: CarrierPlan, scenario: Scenario, seed: int, seconds: FloatArray) -> FloatArray:
    """Return the noise (T, N) of all users, and of the beacons."""
    white_db = world_white_db(plan) * scenario.noise.white_scale
    columns = [
        (_beacon_noise_db if carrier.is_beacon else _user_noise_db)(carrier, sigma_db, scenario, seed, seconds)
        for carrier, sigma_db in zip(plan.carriers, white_db.tolist(), strict=True)
    ]
    noise_db = np.stack(columns, axis=1)
    if scenario.noise.station is not None:
        for station, members in plan.columns_by_station.items():
            noise_db[:, members] += _station_noise_db(station, scenario.noise.station, scenario, seed, seconds)[:, None]
    return noise_db


def _station_noise_db(
    name: str, figures: StationNoise, scenario: Scenario, seed: int, seconds: FloatArray
) -> FloatArray:
    """Return the level (T,) of a station in the dry: first-order parts, white noise, wave of the solar day."""
    rng = stream(seed, "station", name)
    drawn = _drawn_station(figures, rng)
    solar = daily_wave(rng, seconds, drawn.daily_db)
    slow = drawn.scale * _flicker_db(seed, f"station {name}", figures.parts, scenario, len(seconds))
    return np.asarray(slow + solar + drawn.white_db * stream(seed, "station white", name).normal(size=len(seconds)))


class _DrawnStation(NamedTuple):
    """Scale of the parts, white noise and amplitude of the solar day of one station."""

    scale: float
    white_db: float
    daily_db: float


def _drawn_station(figures: StationNoise, rng: np.random.Generator) -> _DrawnStation:
    """Draw the statistics of one station."""
    scale = float(np.exp(figures.parts_spread * rng.normal()))
    white_db = figures.white_db * float(np.exp(figures.white_spread * rng.normal()))
    return _DrawnStation(scale, white_db, 0.5 * float(rng.uniform(*figures.solar_db)))


class CarrierNoise(NamedTuple):
    """True statistics of one carrier's noise, dB."""

    #: of a row, without the noise of the sweep
    white_db: float
    parts: tuple[Part, ...]
    #: amplitudes of the waves of the solar day, added in squares
    daily_db: float


def carrier_noise(plan: CarrierPlan, column: int, scenario: Scenario, seed: int) -> CarrierNoise:
    """Return the statistics from which `users_noise_db` draws the noise of a carrier."""
    figures, carrier = scenario.noise, plan.carriers[column]
    white_db = float(world_white_db(plan)[column]) * figures.white_scale
    if carrier.is_beacon:
        return CarrierNoise(white_db, ((_beacon_sigma_db(), BEACON_TAU_S),), 0.0)
    coloured_db = float(stream(seed, "coloured", carrier.id).uniform(*figures.coloured_db))
    scale = float(stream(seed, "flicker scale", carrier.id).uniform(*figures.flicker_scale))
    parts = [(coloured_db, figures.coloured_tau_s), (carrier.wander_db * figures.wander_scale, figures.wander_tau_s)]
    parts += [(scale * sigma_db, tau_s) for sigma_db, tau_s in figures.flicker]
    white2, daily2 = white_db**2 + figures.quantum_db**2 / 12.0, figures.thermal_db**2
    if figures.station is not None:
        drawn = _drawn_station(figures.station, stream(seed, "station", carrier.station.name))
        parts += [(drawn.scale * sigma_db, tau_s) for sigma_db, tau_s in figures.station.parts]
        white2 += drawn.white_db**2 + figures.station.quantum_db**2 / 12.0
        daily2 += drawn.daily_db**2
    return CarrierNoise(white2**0.5, tuple(part for part in parts if part[0] > 0.0), daily2**0.5)


def _beacon_noise_db(
    carrier: Carrier, white_db: float, scenario: Scenario, seed: int, seconds: FloatArray
) -> FloatArray:
    """Return the noise (T,) of a beacon: white, and the drift of the satellite's own transmitter."""
    white = white_db * stream(seed, "white", carrier.id).normal(size=len(seconds))
    rng, step_s = stream(seed, "beacon", carrier.id), scenario.row_period_s
    return np.asarray(white + first_order(rng, len(seconds), step_s, _beacon_sigma_db(), BEACON_TAU_S))


def _beacon_sigma_db() -> float:
    """Return the sigma of a beacon's drift: two values a correlation time apart differ by sigma sqrt(2 - 2 / e)."""
    return BEACON_DRIFT_DB_DAY / float(np.sqrt(2.0 - 2.0 / np.e))


def _user_noise_db(carrier: Carrier, white_db: float, scenario: Scenario, seed: int, seconds: FloatArray) -> FloatArray:
    """Return the noise (T,) of one user: white, coloured, day of temperature, wander, flicker."""
    figures, count, step_s = scenario.noise, len(seconds), scenario.row_period_s
    white = white_db * stream(seed, "white", carrier.id).normal(size=count)
    coloured_rng = stream(seed, "coloured", carrier.id)
    sigma_db = float(coloured_rng.uniform(*figures.coloured_db))
    coloured = first_order(coloured_rng, count, step_s, sigma_db, figures.coloured_tau_s)
    thermal = daily_wave(stream(seed, "thermal", carrier.id), seconds, figures.thermal_db)
    wander_db = carrier.wander_db * figures.wander_scale
    wander = first_order(stream(seed, "wander", carrier.id), count, step_s, wander_db, figures.wander_tau_s)
    scale = float(stream(seed, "flicker scale", carrier.id).uniform(*figures.flicker_scale))
    flicker = scale * _flicker_db(seed, carrier.id, figures.flicker, scenario, count)
    return np.asarray(white + coloured + thermal + wander + flicker)


def _flicker_db(seed: int, name: str, parts: tuple[Part, ...], scenario: Scenario, count: int) -> FloatArray:
    """Return the sum (count,) of first-order parts."""
    total = np.zeros(count)
    for sigma_db, tau_s in parts:
        rng = stream(seed, "flicker", name, f"{tau_s:g} s")
        total += first_order(rng, count, scenario.row_period_s, sigma_db, tau_s)
    return total
