"""Noise of the users' levels and of the receiving chain: white, coloured, flicker, days of temperature, wander.

Flicker noise is a sum of first-order parts whose correlation times reach from minutes to a day; each part of each
carrier draws from a stream of its own, so that a part more or less moves no other.
"""

import numpy as np

from analyzer_sim.carriers import Carrier, CarrierPlan
from analyzer_sim.noise import daily_wave, first_order
from analyzer_sim.story import Part, Scenario
from analyzer_sim.streams import FloatArray, stream

#: the sweep for which the plan's white noise is split: RBW, duration
SWEEP_RBW_HZ = 30e3
SWEEP_TIME_S = 2.0
_MIN_WHITE_DB = 0.05


def sweep_sigma_db(plan: CarrierPlan) -> FloatArray:
    """Return the noise (N,) that the default sweep itself adds to each carrier's power, dB.

    `4.343 / sqrt(1.505 RBW T B / span)`, B = symbol rate.
    """
    span_hz = plan.span_hz[1] - plan.span_hz[0]
    rates = np.array([carrier.symbol_rate_hz for carrier in plan.carriers])
    return np.asarray(4.343 / np.sqrt(1.505 * SWEEP_RBW_HZ * SWEEP_TIME_S * rates / span_hz))


def world_white_db(plan: CarrierPlan) -> FloatArray:
    """Return the white noise (N,) that with the sweep's own share makes up the plan's figure, dB."""
    total = np.array([carrier.white_db for carrier in plan.carriers])
    return np.sqrt(np.maximum(total**2 - sweep_sigma_db(plan) ** 2, _MIN_WHITE_DB**2))


def chain_noise_db(scenario: Scenario, seed: int, seconds: FloatArray) -> FloatArray:
    """Return the drift (T,) of the receiving chain."""
    figures = scenario.noise
    rng = stream(seed, "chain")
    wave = daily_wave(rng, seconds, figures.chain_daily_db)
    slow = wave + first_order(rng, len(seconds), scenario.row_period_s, figures.chain_db, figures.chain_tau_s)
    return np.asarray(slow + _flicker_db(seed, "chain", figures.chain_flicker, scenario, len(seconds)))


def users_noise_db(plan: CarrierPlan, scenario: Scenario, seed: int, seconds: FloatArray) -> FloatArray:
    """Return the noise (T, N) of all users."""
    white_db = world_white_db(plan) * scenario.noise.white_scale
    columns = zip(plan.carriers, white_db.tolist(), strict=True)
    return np.stack([_user_noise_db(carrier, sigma, scenario, seed, seconds) for carrier, sigma in columns], axis=1)


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
