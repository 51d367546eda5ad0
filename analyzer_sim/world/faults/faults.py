"""Faults of carriers, transponders and the receiving chain: what the events do to the series."""

from collections.abc import Sequence

import numpy as np

from analyzer_sim.streams import stream
from analyzer_sim.world.faults.spells import SPELLS
from analyzer_sim.world.faults.station_weather import STATION_WEATHER
from analyzer_sim.world.faults.weather import rain_db
from analyzer_sim.world.orbit.orbit import EpochArray
from analyzer_sim.world.payload.carriers import CarrierPlan
from analyzer_sim.world.payload.effects import Effects, FaultFlag, apply_fault, draw
from analyzer_sim.world.scenario.events import (
    ChainStep,
    DownlinkRain,
    Fault,
    Gap,
    GroupStep,
    Interference,
    Step,
    SwitchOff,
    UplinkRain,
)

#: how long work on the receiving chain is declared, h
CHAIN_WORK_H = 0.25

for _spell in (*SPELLS, *STATION_WEATHER):
    apply_fault.register(_spell)


def effects_of(
    faults: Sequence[Fault], seed: int, plan: CarrierPlan, epochs_us: EpochArray, start_us: int, row_h: float
) -> Effects:
    """Return what the faults do at each epoch; `start_us` is the start of operation."""
    effects = Effects.none(plan, epochs_us, start_us, row_h)
    for fault in faults:
        apply_fault(fault, effects, stream(seed, "fault", fault.name))
    return effects


@apply_fault.register
def _(fault: UplinkRain, effects: Effects, rng: np.random.Generator) -> None:
    for shower in range(fault.count):
        carrier = _pick(rng, effects, fault.carriers, shower)
        fade_db = rain_db(fault, effects.hours, effects.row_h, rng)
        effects.uplink_fade_db[:, carrier] += effects.plan.rain_share[carrier] * fade_db
        effects.add_flag(fade_db > 0.0, [carrier], FaultFlag.UPLINK_RAIN)


@apply_fault.register
def _(fault: DownlinkRain, effects: Effects, rng: np.random.Generator) -> None:
    fade_db = rain_db(fault, effects.hours, effects.row_h, rng)
    np.add(effects.downlink_fade_db, fade_db, out=effects.downlink_fade_db)
    effects.add_flag(fade_db > 0.0, range(len(effects.ids)), FaultFlag.DOWNLINK_RAIN)


@apply_fault.register
def _(fault: SwitchOff, effects: Effects, rng: np.random.Generator) -> None:
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
def _(fault: Step, effects: Effects, rng: np.random.Generator) -> None:
    for number in range(fault.count):
        carrier = _pick(rng, effects, fault.carriers, number)
        after = effects.hours >= draw(rng, fault.start_h)
        effects.level_db[after, carrier] += draw(rng, fault.size_db) * rng.choice([-1.0, 1.0])
        effects.add_flag(after, [carrier], FaultFlag.STEP)


@apply_fault.register
def _(fault: GroupStep, effects: Effects, rng: np.random.Generator) -> None:
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
def _(fault: ChainStep, effects: Effects, rng: np.random.Generator) -> None:
    start_h = draw(rng, fault.start_h)
    after = effects.hours >= start_h
    effects.chain_db[after] += draw(rng, fault.size_db)
    effects.add_flag(after, range(len(effects.ids)), FaultFlag.CHAIN_STEP)
    if fault.is_announced:
        begin_h, end_h = start_h - 0.5 * CHAIN_WORK_H, start_h + 0.5 * CHAIN_WORK_H
        effects.declare("receive_chain_work", begin_h, end_h, inhibit_control=True)


@apply_fault.register
def _(fault: Interference, effects: Effects, rng: np.random.Generator) -> None:
    for number in range(fault.count):
        carrier = _pick(rng, effects, fault.carriers, number)
        start_h, duration_h = draw(rng, fault.start_h), draw(rng, fault.duration_min) / 60.0
        rows = (effects.hours >= start_h) & (effects.hours < start_h + duration_h)
        effects.interference_db[rows, carrier] = draw(rng, fault.level_db)
        effects.add_flag(rows, [carrier], FaultFlag.INTERFERENCE)


@apply_fault.register
def _(fault: Gap, effects: Effects, rng: np.random.Generator) -> None:
    for _number in range(fault.count):
        start_h, duration_h = draw(rng, fault.start_h), draw(rng, fault.duration_min) / 60.0
        rows = (effects.hours >= start_h) & (effects.hours < start_h + duration_h)
        effects.add_flag(rows, range(len(effects.ids)), FaultFlag.GAP)


def _pick(rng: np.random.Generator, effects: Effects, carriers: tuple[str, ...], number: int) -> int:
    """Return the number-th of the named carriers, or a drawn one where none is named."""
    drawn = effects.plan.users[int(rng.integers(len(effects.plan.users)))]
    return effects.ids.index(carriers[number % len(carriers)]) if carriers else drawn
