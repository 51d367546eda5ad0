"""Weather over the users' stations with the statistics of 284 real links, levels as on a slant path at 14 GHz.

    loss = steady rain and film of the systems + showers + wet antennas       dB, one series a station

A system lasts hours and brings showers and steady rain; a few showers come outside. A shower of more than 0.7 dB leaves
a wet antenna. Each system and each shower draws from a generator of its own, so that a longer world begins like the
shorter one.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from analyzer_sim.streams import FloatArray
from analyzer_sim.world.noise import first_order
from analyzer_sim.world.payload.effects import Effects, FaultFlag, draw
from analyzer_sim.world.scenario.events import Showers, Weather, WeatherSystem

#: systems that began so long before the first row still matter
_BEFORE_H = 24.0
_SYSTEM_H = (5.0, 18.0)
#: sigma of the logarithm of a system's severity, and showers of a system of severity 1
_SEVERITY_SPREAD, _SYSTEM_SHOWERS = 0.5, 5.5
#: showers a day outside the systems
_OUTSIDE_PER_DAY = 0.25
#: steady rain and film of a system: median, sigma of the logarithm, share by which it wanders, and how fast
_STEADY_DB, _STEADY_SPREAD, _STEADY_WANDER, _STEADY_TAU_S = 0.16, 0.8, 0.5, 5400.0
#: showers: median, sigma of the logarithm and limits of length and peak, correlation of the two logarithms
_LENGTH_MIN, _LENGTH_SPREAD, _LENGTH_LIMITS_MIN = 30.0, 1.15, (4.0, 600.0)
_PEAK_DB, _PEAK_SPREAD, _PEAK_LIMITS_DB = 0.66, 1.12, (0.2, 14.0)
_LENGTH_PEAK_CORRELATION = 0.40
#: share of its length in which a shower rises, exponent of its shape, share by which it breathes, and how fast
_RISE_SHARE, _SHAPE_EXPONENT, _BREATH_SHARE, _BREATH_TAU_S = (0.1, 0.4), (0.8, 2.5), 0.35, 300.0
#: peak above which an antenna stays wet, its loss without and with the peak's share, time in which it dries
_WETTING_DB, _WET_DB, _WET_SHARE, _DRY_MIN = 0.7, (0.05, 0.20), 0.03, (25.0, 110.0)
#: a drying antenna is dry after so many time constants
_DRY_AFTER = 6.0
#: a station that loses more counts as one in rain
_RAIN_FLAG_DB = 0.05


class System(NamedTuple):
    """Time of one weather system over a station and its severity there."""

    start_h: float
    duration_h: float
    severity: float


def weather(fault: Weather, effects: Effects, rng: np.random.Generator) -> None:
    """Let systems pass over the stations, each station's own or shared by a share of them."""
    shared_rng, *station_rngs = rng.spawn(1 + len(effects.plan.columns_by_station))
    shared = _systems(fault, effects, shared_rng) if fault.shared > 0.0 else []
    for columns, own_rng in zip(effects.plan.columns_by_station.values(), station_rngs, strict=True):
        coming_rng, systems_rng, outside_rng = own_rng.spawn(3)
        systems = _arriving(fault, shared, coming_rng) if shared else _systems(fault, effects, coming_rng)
        loss_db = np.zeros(len(effects.hours))
        for system in systems:
            _add_system(loss_db, system, effects, systems_rng.spawn(1)[0])
        for start_h in _outside_h(systems, effects, outside_rng):
            _add_shower(loss_db, start_h, effects, outside_rng.spawn(1)[0])
        _add_fade(effects, columns, loss_db)


def weather_system(fault: WeatherSystem, effects: Effects, rng: np.random.Generator) -> None:
    """Let one system pass over a share of the stations."""
    for columns, own_rng in _chosen_stations(fault.share, effects, rng):
        loss_db = np.zeros(len(effects.hours))
        system = System(draw(own_rng, fault.start_h), draw(own_rng, fault.duration_h), _severity(own_rng))
        _add_system(loss_db, system, effects, own_rng)
        _add_fade(effects, columns, loss_db)


def showers(fault: Showers, effects: Effects, rng: np.random.Generator) -> None:
    """Let one shower pass over each station of a share."""
    for columns, own_rng in _chosen_stations(fault.share, effects, rng):
        loss_db = np.zeros(len(effects.hours))
        _add_shower(loss_db, draw(own_rng, fault.start_h), effects, own_rng)
        _add_fade(effects, columns, loss_db)


def _chosen_stations(
    share: float, effects: Effects, rng: np.random.Generator
) -> Iterator[tuple[list[int], np.random.Generator]]:
    """Yield the columns of a drawn share of the stations, each with a generator of its own."""
    stations = list(effects.plan.columns_by_station.values())
    chosen = rng.permutation(len(stations))[: round(share * len(stations))]
    for number, own_rng in zip(chosen.tolist(), rng.spawn(len(chosen)), strict=True):
        yield stations[number], own_rng


def _systems(fault: Weather, effects: Effects, rng: np.random.Generator) -> list[System]:
    """Draw the systems of one place in order of time."""
    systems: list[System] = []
    start_h = float(effects.hours[0]) - _BEFORE_H
    while (start_h := start_h + 24.0 * float(rng.exponential(fault.interval_days))) <= effects.hours[-1]:
        systems.append(System(start_h, draw(rng, _SYSTEM_H), _severity(rng)))
    return systems


def _arriving(fault: Weather, shared: list[System], rng: np.random.Generator) -> list[System]:
    """Draw which shared systems come to a station, when, and how severe they are there."""
    arriving = []
    for system in shared:
        is_coming, shift_h = rng.uniform() < fault.shared, fault.shift_min / 60.0 * float(rng.normal())
        severity = _severity(rng)
        if is_coming:
            arriving.append(System(system.start_h + shift_h, system.duration_h, severity))
    return arriving


def _severity(rng: np.random.Generator) -> float:
    """Draw the severity of a system over one station."""
    return float(np.exp(_SEVERITY_SPREAD * rng.normal()))


def _outside_h(systems: list[System], effects: Effects, rng: np.random.Generator) -> Iterator[float]:
    """Yield the starts of the showers outside the systems."""
    start_h = float(effects.hours[0]) - _BEFORE_H
    while (start_h := start_h + 24.0 * float(rng.exponential(1.0 / _OUTSIDE_PER_DAY))) <= effects.hours[-1]:
        if not any(system.start_h <= start_h < system.start_h + system.duration_h for system in systems):
            yield start_h


def _add_system(loss_db: FloatArray, system: System, effects: Effects, rng: np.random.Generator) -> None:
    """Add steady rain and showers of a system to the loss (T,) of a station."""
    steady_db = _STEADY_DB * float(np.exp(_STEADY_SPREAD * rng.normal()))
    for start_h in rng.uniform(0.0, system.duration_h, rng.poisson(_SYSTEM_SHOWERS * system.severity)).tolist():
        _add_shower(loss_db, system.start_h + start_h, effects, rng.spawn(1)[0])
    rows = _rows(effects, system.start_h, system.duration_h)
    since = (effects.hours[rows] - system.start_h) / system.duration_h
    wander = first_order(rng, len(since), 3600.0 * effects.row_h, _STEADY_WANDER, _STEADY_TAU_S)
    loss_db[rows] += steady_db * np.sin(np.pi * since) * np.maximum(0.0, 1.0 + wander)


def _add_shower(loss_db: FloatArray, start_h: float, effects: Effects, rng: np.random.Generator) -> None:
    """Add one shower and the wet antenna that it leaves to the loss (T,) of a station."""
    of_length, of_peak = rng.normal(size=2).tolist()
    of_peak = _LENGTH_PEAK_CORRELATION * of_length + np.sqrt(1.0 - _LENGTH_PEAK_CORRELATION**2) * of_peak
    length_min = float(np.clip(_LENGTH_MIN * np.exp(_LENGTH_SPREAD * of_length), *_LENGTH_LIMITS_MIN))
    peak_db = float(np.clip(_PEAK_DB * np.exp(_PEAK_SPREAD * of_peak), *_PEAK_LIMITS_DB))
    rise_min, exponent = length_min * draw(rng, _RISE_SHARE), draw(rng, _SHAPE_EXPONENT)
    wet_db, dry_min = draw(rng, _WET_DB) + _WET_SHARE * peak_db, draw(rng, _DRY_MIN)
    rows = _rows(effects, start_h, (length_min + _DRY_AFTER * dry_min) / 60.0)
    since_min = 60.0 * (effects.hours[rows] - start_h)
    rising = np.minimum(1.0, since_min / rise_min)
    falling = np.clip((length_min - since_min) / (length_min - rise_min), 0.0, 1.0)
    breath = first_order(rng, len(since_min), 3600.0 * effects.row_h, _BREATH_SHARE, _BREATH_TAU_S)
    loss_db[rows] += peak_db * np.minimum(rising, falling) ** exponent * np.maximum(0.0, 1.0 + breath)
    if peak_db > _WETTING_DB:
        loss_db[rows] += wet_db * rising * np.exp(-np.maximum(0.0, since_min - length_min) / dry_min)


def _rows(effects: Effects, start_h: float, duration_h: float) -> slice:
    """Return the rows of a span."""
    first, last = np.searchsorted(effects.hours, [start_h, start_h + duration_h]).tolist()
    return slice(first, last)


def _add_fade(effects: Effects, columns: list[int], loss_db: FloatArray) -> None:
    """Let all carriers of a station fade, each by the share that its band feels."""
    for column in columns:
        effects.uplink_fade_db[:, column] += effects.plan.rain_share[column] * loss_db
    effects.add_flag(loss_db > _RAIN_FLAG_DB, columns, FaultFlag.UPLINK_RAIN)


#: every effect of this module
STATION_WEATHER = (weather, weather_system, showers)
