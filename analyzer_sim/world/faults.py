"""Faults of a scenario: weather over the stations, and spells of other faults."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from analyzer_sim.epochs import US_PER_H
from analyzer_sim.streams import FloatArray, first_order, stream
from analyzer_sim.world.orbit import EpochArray
from analyzer_sim.world.payload.carriers import CarrierPlan
from analyzer_sim.world.payload.effects import SOURCES, Effects, FaultFlag, apply_fault, draw
from analyzer_sim.world.scenario import events

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


def weather(fault: events.Weather, effects: Effects, rng: np.random.Generator) -> None:
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


def weather_system(fault: events.WeatherSystem, effects: Effects, rng: np.random.Generator) -> None:
    """Let one system pass over a share of the stations."""
    for columns, own_rng in _chosen_stations(fault.share, effects, rng):
        loss_db = np.zeros(len(effects.hours))
        system = System(draw(own_rng, fault.start_h), draw(own_rng, fault.duration_h), _severity(own_rng))
        _add_system(loss_db, system, effects, own_rng)
        _add_fade(effects, columns, loss_db)


def showers(fault: events.Showers, effects: Effects, rng: np.random.Generator) -> None:
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


def _systems(fault: events.Weather, effects: Effects, rng: np.random.Generator) -> list[System]:
    """Draw the systems of one place in order of time."""
    systems: list[System] = []
    start_h = float(effects.hours[0]) - _BEFORE_H
    while (start_h := start_h + 24.0 * float(rng.exponential(fault.interval_days))) <= effects.hours[-1]:
        systems.append(System(start_h, draw(rng, _SYSTEM_H), _severity(rng)))
    return systems


def _arriving(fault: events.Weather, shared: list[System], rng: np.random.Generator) -> list[System]:
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
    first, last = np.searchsorted(effects.hours, [start_h, start_h + duration_h]).tolist()
    return slice(first, last)


def _add_fade(effects: Effects, columns: list[int], loss_db: FloatArray) -> None:
    """Let all carriers of a station fade, each by the share that its band feels."""
    for column in columns:
        effects.uplink_fade_db[:, column] += effects.plan.rain_share[column] * loss_db
    effects.add_flag(loss_db > _RAIN_FLAG_DB, columns, FaultFlag.UPLINK_RAIN)


#: every effect of this module
STATION_WEATHER = (weather, weather_system, showers)


#: rain breathes by this share of its depth, with this correlation time
RAIN_BREATH_SHARE = 0.06
RAIN_BREATH_MIN = 6.0


def rain_db(
    rain: events.UplinkRain | events.DownlinkRain, hours: FloatArray, row_h: float, rng: np.random.Generator
) -> FloatArray:
    """Return the fade (T,) of one rain at hours from the start of operation; what it leaves open is drawn here."""
    return shower_db(rain, draw(rng, rain.start_h), hours, row_h, rng)


def shower_db(
    rain: events.UplinkRain | events.DownlinkRain | events.Storm,
    start_h: float,
    hours: FloatArray,
    row_h: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return the fade (T,) of a rain that begins at a given hour: a trapezoid that breathes."""
    depth_db = draw(rng, rain.depth_db)
    rise_h = depth_db / draw(rng, rain.slope_db_min) / 60.0
    full_h = draw(rng, rain.duration_min) / 60.0
    knots_h = start_h + np.array([0.0, rise_h, rise_h + full_h, 2.0 * rise_h + full_h])
    fade_db = np.interp(hours, knots_h, [0.0, depth_db, depth_db, 0.0])
    wet = np.flatnonzero(fade_db > 0.0)
    breath = rng.normal(size=len(wet))
    keep = np.exp(-row_h * 60.0 / RAIN_BREATH_MIN)
    for row in range(1, len(wet)):
        breath[row] = keep * breath[row - 1] + np.sqrt(1.0 - keep**2) * breath[row]
    fade_db[wet] *= np.maximum(0.0, 1.0 + RAIN_BREATH_SHARE * breath)
    return np.asarray(fade_db)


def wet_antenna_db(fade_db: FloatArray, wet_db: float, dry_tau_min: float, row_h: float) -> FloatArray:
    """Return the loss (T,) of a wet antenna: at most `wet_db` while it rains, then drying with a time constant.

    Examples
    --------
    >>> wet_antenna_db(np.array([0.0, 3.0, 0.0]), 1.0, 20.0, 20.0 / 60.0).round(3).tolist()
    [0.0, 1.0, 0.368]
    """
    keep = float(np.exp(-row_h * 60.0 / dry_tau_min))
    wet = np.minimum(fade_db, wet_db)
    for row in range(int(np.argmax(wet > 0.0)), len(wet)):
        wet[row] = max(wet[row], keep * wet[row - 1] if row else 0.0)
    return np.where(wet > 1e-3, wet, 0.0)


#: a change of gain or pattern below this share of its size no longer counts as one
_OVER_SHARE = 0.05


def storm(fault: events.Storm, effects: Effects, rng: np.random.Generator) -> None:
    """Let rain cells take neighbouring stations one after another; wet antennas dry slowly."""
    carriers = effects.plan.carriers
    along = sorted(effects.plan.users, key=lambda k: carriers[k].station.longitude_deg)
    for _cell in range(fault.count):
        count = int(rng.integers(fault.stations[0], fault.stations[1] + 1))
        first = int(rng.integers(len(along) - count + 1))
        path = along[first : first + count][:: int(rng.choice([-1, 1]))]
        start_h = draw(rng, fault.start_h)
        for carrier in path:
            fade_db = shower_db(fault, start_h, effects.hours, effects.row_h, rng)
            wet_db = wet_antenna_db(fade_db, draw(rng, fault.wet_db), fault.dry_tau_min, effects.row_h)
            effects.uplink_fade_db[:, carrier] += effects.plan.rain_share[carrier] * (fade_db + wet_db)
            effects.add_flag(fade_db > 0.0, [carrier], FaultFlag.UPLINK_RAIN)
            effects.add_flag((wet_db > 0.0) & (fade_db == 0.0), [carrier], FaultFlag.WET_ANTENNA)
            start_h += draw(rng, fault.between_min) / 60.0


def relevel(fault: events.Relevel, effects: Effects, rng: np.random.Generator) -> None:
    """Set every user's level again."""
    after, users = effects.hours >= fault.start_h, effects.plan.users
    effects.level_db[np.ix_(after, np.array(users))] += fault.sigma_db * rng.normal(size=len(users))
    effects.add_flag(after, users, FaultFlag.STEP)


def change_plan(fault: events.PlanChange, effects: Effects, rng: np.random.Generator) -> None:  # noqa: ARG001 - nothing is left open
    """Take carriers off the air for good and put others on."""
    after = effects.hours >= fault.start_h
    effects.add_flag(after, [effects.ids.index(name) for name in fault.gone], FaultFlag.OFF)
    effects.add_flag(~after, [effects.ids.index(name) for name in fault.new], FaultFlag.OFF)


def eclipse(fault: events.Eclipse, effects: Effects, rng: np.random.Generator) -> None:
    """Cool gains and reflector in the shadow, warm them after it."""
    start_h, duration_h = draw(rng, fault.start_h), draw(rng, fault.duration_min) / 60.0
    share = cooling(effects.hours, start_h, duration_h, fault.tau_min / 60.0)
    for transponder in sorted(effects.plan.beams):
        members = effects.members(transponder)
        effects.level_db[:, members] -= draw(rng, fault.gain_db) * share[:, None]
    size_deg, angle = draw(rng, fault.shift_deg), rng.uniform(0.0, 2.0 * np.pi)
    np.add(
        effects.pattern_shift_deg,
        size_deg * share[:, None] * np.array([np.cos(angle), np.sin(angle)]),
        out=effects.pattern_shift_deg,
    )
    effects.add_flag(share > _OVER_SHARE, range(len(effects.ids)), FaultFlag.ECLIPSE)
    effects.declare("eclipse", start_h, start_h + duration_h, comment="Earth's shadow")


def pattern_wave(fault: events.PatternWave, effects: Effects, rng: np.random.Generator) -> None:
    """Move the uplink patterns once a solar day."""
    phase = rng.uniform(0.0, 2.0 * np.pi, 2)
    wave = np.array(fault.size_deg) * np.cos(2.0 * np.pi * effects.hours[:, None] / 24.0 - phase)
    np.add(effects.pattern_shift_deg, np.where(effects.hours[:, None] >= 0.0, wave, 0.0), out=effects.pattern_shift_deg)


def cooling(hours: FloatArray, start_h: float, duration_h: float, tau_h: float) -> FloatArray:
    """Return how far (T,) the spacecraft has cooled: 0 in sunlight, towards 1 in shadow, back with the same time."""
    inside_h = np.clip(hours - start_h, 0.0, duration_h)
    after_h = np.maximum(0.0, hours - start_h - duration_h)
    share = -np.expm1(-inside_h / tau_h) * np.exp(-after_h / tau_h)
    return np.asarray(np.where(share > 1e-4, share, 0.0))


def sun_outage(fault: events.SunOutage, effects: Effects, rng: np.random.Generator) -> None:
    """Raise the noise while the Sun crosses the beam of the receiving site."""
    start_h, duration_h = draw(rng, fault.start_h), draw(rng, fault.duration_min) / 60.0
    inside = (effects.hours - start_h) / duration_h
    is_inside = (inside > 0.0) & (inside < 1.0)
    rise_db = draw(rng, fault.rise_db) * np.sin(np.pi * np.clip(inside, 0.0, 1.0)) * is_inside
    np.add(effects.sun_noise_db, rise_db, out=effects.sun_noise_db)
    effects.add_flag(is_inside, range(len(effects.ids)), FaultFlag.SUN_OUTAGE)
    margin_h = 1.0 / 60.0
    effects.declare("sun_outage", start_h - margin_h, start_h + duration_h + margin_h, comment="Sun in the beam")


def switch_source(fault: events.SourceSwitch, effects: Effects, rng: np.random.Generator) -> None:
    """Let the second analyzer measure for some hours; its chain has another gain."""
    start_h = draw(rng, fault.start_h)
    edges_us = [effects.epoch_us(hours) for hours in (start_h, start_h + draw(rng, fault.duration_h))]
    begin_h, end_h = ((edge_us - effects.start_us) / US_PER_H for edge_us in edges_us)
    is_backup = (effects.hours >= begin_h) & (effects.hours < end_h)
    effects.chain_db[is_backup] += draw(rng, fault.gain_db)
    effects.source[is_backup] = 1
    effects.add_flag(is_backup, range(len(effects.ids)), FaultFlag.BACKUP_CHAIN)
    effects.source_switches.extend(zip(edges_us, SOURCES[::-1], strict=True))


#: every effect of this module
SPELLS = (storm, relevel, change_plan, eclipse, pattern_wave, sun_outage, switch_source)


#: how long work on the receiving chain is declared, h
CHAIN_WORK_H = 0.25

for _spell in (*SPELLS, *STATION_WEATHER):
    apply_fault.register(_spell)


def effects_of(
    faults: Sequence[events.Fault], seed: int, plan: CarrierPlan, epochs_us: EpochArray, start_us: int, row_h: float
) -> Effects:
    """Return what the faults do at each epoch; `start_us` is the start of operation."""
    effects = Effects.none(plan, epochs_us, start_us, row_h)
    for fault in faults:
        apply_fault(fault, effects, stream(seed, "fault", fault.name))
    return effects


@apply_fault.register
def _(fault: events.UplinkRain, effects: Effects, rng: np.random.Generator) -> None:
    for shower in range(fault.count):
        carrier = _pick(rng, effects, fault.carriers, shower)
        fade_db = rain_db(fault, effects.hours, effects.row_h, rng)
        effects.uplink_fade_db[:, carrier] += effects.plan.rain_share[carrier] * fade_db
        effects.add_flag(fade_db > 0.0, [carrier], FaultFlag.UPLINK_RAIN)


@apply_fault.register
def _(fault: events.DownlinkRain, effects: Effects, rng: np.random.Generator) -> None:
    fade_db = rain_db(fault, effects.hours, effects.row_h, rng)
    np.add(effects.downlink_fade_db, fade_db, out=effects.downlink_fade_db)
    effects.add_flag(fade_db > 0.0, range(len(effects.ids)), FaultFlag.DOWNLINK_RAIN)


@apply_fault.register
def _(fault: events.SwitchOff, effects: Effects, rng: np.random.Generator) -> None:
    carriers = [_pick(rng, effects, fault.carriers, number) for number in range(max(1, len(fault.carriers)))]
    start_h, duration_h, after_db = (draw(rng, r) for r in (fault.start_h, fault.duration_h, fault.level_after_db))
    stop_h = start_h + duration_h
    effects.add_flag((effects.hours >= start_h) & (effects.hours < stop_h), carriers, FaultFlag.OFF)
    if after_db != 0.0:
        after = effects.hours >= stop_h
        effects.level_db[np.ix_(after, np.array(carriers))] += after_db
        effects.add_flag(after, carriers, FaultFlag.STEP)
    if fault.is_announced:
        names = tuple(effects.ids[carrier] for carrier in carriers)
        effects.declare("carrier_work", start_h, stop_h, carriers=names, comment="carriers off the air")


@apply_fault.register
def _(fault: events.Step, effects: Effects, rng: np.random.Generator) -> None:
    for number in range(fault.count):
        carrier = _pick(rng, effects, fault.carriers, number)
        after = effects.hours >= draw(rng, fault.start_h)
        effects.level_db[after, carrier] += draw(rng, fault.size_db) * rng.choice([-1.0, 1.0])
        effects.add_flag(after, [carrier], FaultFlag.STEP)


@apply_fault.register
def _(fault: events.GroupStep, effects: Effects, rng: np.random.Generator) -> None:
    transponder = fault.transponder or str(rng.choice(sorted(effects.plan.beams)))
    members = effects.members(transponder)
    start_h = draw(rng, fault.start_h)
    stop_h = start_h + fault.duration_h if fault.duration_h > 0.0 else np.inf
    rows = (effects.hours >= start_h) & (effects.hours < stop_h)
    effects.level_db[np.ix_(rows, np.array(members))] += draw(rng, fault.size_db) * rng.choice([-1.0, 1.0])
    effects.add_flag(rows, members, FaultFlag.GROUP_STEP)
    if fault.is_announced:
        declared_h = fault.duration_h if fault.duration_h > 0.0 else CHAIN_WORK_H
        effects.declare("gain_change", start_h, start_h + declared_h, transponders=(transponder,))


@apply_fault.register
def _(fault: events.ChainStep, effects: Effects, rng: np.random.Generator) -> None:
    start_h = draw(rng, fault.start_h)
    after = effects.hours >= start_h
    effects.chain_db[after] += draw(rng, fault.size_db)
    effects.add_flag(after, range(len(effects.ids)), FaultFlag.CHAIN_STEP)
    if fault.is_announced:
        begin_h, end_h = start_h - 0.5 * CHAIN_WORK_H, start_h + 0.5 * CHAIN_WORK_H
        effects.declare("receive_chain_work", begin_h, end_h, inhibit_control=True)


@apply_fault.register
def _(fault: events.Interference, effects: Effects, rng: np.random.Generator) -> None:
    for number in range(fault.count):
        carrier = _pick(rng, effects, fault.carriers, number)
        start_h, duration_h = draw(rng, fault.start_h), draw(rng, fault.duration_min) / 60.0
        rows = (effects.hours >= start_h) & (effects.hours < start_h + duration_h)
        effects.interference_db[rows, carrier] = draw(rng, fault.level_db)
        effects.add_flag(rows, [carrier], FaultFlag.INTERFERENCE)


@apply_fault.register
def _(fault: events.Gap, effects: Effects, rng: np.random.Generator) -> None:
    for _number in range(fault.count):
        start_h, duration_h = draw(rng, fault.start_h), draw(rng, fault.duration_min) / 60.0
        rows = (effects.hours >= start_h) & (effects.hours < start_h + duration_h)
        effects.add_flag(rows, range(len(effects.ids)), FaultFlag.GAP)


def _pick(rng: np.random.Generator, effects: Effects, carriers: tuple[str, ...], number: int) -> int:
    """Return the number-th of the named carriers, or a drawn one where none is named."""
    drawn = effects.plan.users[int(rng.integers(len(effects.plan.users)))]
    return effects.ids.index(carriers[number % len(carriers)]) if carriers else drawn
