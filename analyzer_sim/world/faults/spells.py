"""Spells that come over many carriers at once: storms, eclipses, the Sun, new plans, new levels, another analyzer."""

import numpy as np

from analyzer_sim.epochs import US_PER_H
from analyzer_sim.streams import FloatArray
from analyzer_sim.world.faults.weather import shower_db, wet_antenna_db
from analyzer_sim.world.payload.effects import SOURCES, Effects, FaultFlag, draw
from analyzer_sim.world.scenario.events import Eclipse, PatternWave, PlanChange, Relevel, SourceSwitch, Storm, SunOutage

#: a change of gain or pattern below this share of its size no longer counts as one
_OVER_SHARE = 0.05


def storm(fault: Storm, effects: Effects, rng: np.random.Generator) -> None:
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


def relevel(fault: Relevel, effects: Effects, rng: np.random.Generator) -> None:
    """Set every user's level again."""
    after, users = effects.hours >= fault.start_h, effects.plan.users
    effects.level_db[np.ix_(after, np.array(users))] += fault.sigma_db * rng.normal(size=len(users))
    effects.add_flag(after, users, FaultFlag.STEP)


def change_plan(fault: PlanChange, effects: Effects, rng: np.random.Generator) -> None:  # noqa: ARG001 - nothing is left open
    """Take carriers off the air for good and put others on."""
    after = effects.hours >= fault.start_h
    effects.add_flag(after, [effects.ids.index(name) for name in fault.gone], FaultFlag.OFF)
    effects.add_flag(~after, [effects.ids.index(name) for name in fault.new], FaultFlag.OFF)


def eclipse(fault: Eclipse, effects: Effects, rng: np.random.Generator) -> None:
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


def pattern_wave(fault: PatternWave, effects: Effects, rng: np.random.Generator) -> None:
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


def sun_outage(fault: SunOutage, effects: Effects, rng: np.random.Generator) -> None:
    """Raise the noise while the Sun crosses the beam of the receiving site."""
    start_h, duration_h = draw(rng, fault.start_h), draw(rng, fault.duration_min) / 60.0
    inside = (effects.hours - start_h) / duration_h
    is_inside = (inside > 0.0) & (inside < 1.0)
    rise_db = draw(rng, fault.rise_db) * np.sin(np.pi * np.clip(inside, 0.0, 1.0)) * is_inside
    np.add(effects.sun_noise_db, rise_db, out=effects.sun_noise_db)
    effects.add_flag(is_inside, range(len(effects.ids)), FaultFlag.SUN_OUTAGE)
    margin_h = 1.0 / 60.0
    effects.declare("sun_outage", start_h - margin_h, start_h + duration_h + margin_h, comment="Sun in the beam")


def switch_source(fault: SourceSwitch, effects: Effects, rng: np.random.Generator) -> None:
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
