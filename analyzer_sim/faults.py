"""Faults: what the events of a scenario do to the series.

Each event draws from the stream of its name and adds to `Effects`; none reads what another one did.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.carriers import CarrierPlan
from analyzer_sim.epochs import US_PER_H
from analyzer_sim.events import (
    ChainStep,
    DownlinkRain,
    Fault,
    Gap,
    GroupStep,
    Interference,
    Range,
    Step,
    SwitchOff,
    UplinkRain,
)
from analyzer_sim.orbit import EpochArray
from analyzer_sim.streams import FloatArray, stream

#: rain breathes by this share of its depth, with this correlation time
RAIN_BREATH_SHARE = 0.06
RAIN_BREATH_MIN = 6.0


class FaultFlag(IntFlag):
    """Truth about a carrier in a row."""

    UPLINK_RAIN = 1
    DOWNLINK_RAIN = 2
    OFF = 4
    STEP = 8
    GROUP_STEP = 16
    CHAIN_STEP = 32
    INTERFERENCE = 64
    GAP = 128


@dataclass(frozen=True, slots=True)
class Effects:
    """What the faults of a scenario add up to; T rows, N carriers."""

    #: (T,) hours from the start of operation
    hours: FloatArray
    row_h: float
    plan: CarrierPlan
    #: (T, N) loss by rain over the users' stations, dB
    uplink_fade_db: FloatArray
    #: (T,) loss by rain over the receiving site, dB
    downlink_fade_db: FloatArray
    #: (T, N) changes of level, dB
    level_db: FloatArray
    #: (T,) changes of the receiving chain, dB
    chain_db: FloatArray
    #: (T, N) power of an interfering signal relative to the carrier's level in the plan, dB; NaN = none
    interference_db: FloatArray
    #: (T, N) FaultFlag
    flags: NDArray[np.uint8]

    @property
    def ids(self) -> tuple[str, ...]:
        """Carriers of the plan."""
        return tuple(carrier.id for carrier in self.plan.carriers)

    def add_flag(self, rows: NDArray[np.bool_], carriers: Sequence[int], flag: FaultFlag) -> None:
        """Mark rows (T,) of some carriers."""
        for carrier in carriers:
            self.flags[rows, carrier] |= np.uint8(flag)

    @property
    def is_on(self) -> NDArray[np.bool_]:
        """(T, N) whether a carrier is on the air."""
        return np.asarray((self.flags & np.uint8(FaultFlag.OFF)) == 0)

    @property
    def is_gap(self) -> NDArray[np.bool_]:
        """(T,) whether nothing is measured."""
        return np.asarray((self.flags[:, 0] & np.uint8(FaultFlag.GAP)) != 0)


def effects_of(
    faults: Sequence[Fault], seed: int, plan: CarrierPlan, epochs_us: EpochArray, start_us: int, row_h: float
) -> Effects:
    """Return what the faults do at each epoch; `start_us` is the start of operation."""
    count, carriers = len(epochs_us), len(plan.carriers)
    hours = (epochs_us - start_us) / US_PER_H
    shape = (count, carriers)
    effects = Effects(
        hours,
        row_h,
        plan,
        np.zeros(shape),
        np.zeros(count),
        np.zeros(shape),
        np.zeros(count),
        np.full(shape, np.nan),
        np.zeros(shape, dtype=np.uint8),
    )
    for fault in faults:
        apply_fault(fault, effects, stream(seed, "fault", fault.name))
    return effects


@singledispatch
def apply_fault(
    fault: object,
    effects: Effects,  # noqa: ARG001 - the signature of every registered effect
    rng: np.random.Generator,  # noqa: ARG001 - the signature of every registered effect
) -> None:
    """Add one event to the effects."""
    raise TypeError(f"no effect is written for {type(fault).__name__}")


@apply_fault.register
def _(fault: UplinkRain, effects: Effects, rng: np.random.Generator) -> None:
    for shower in range(fault.count):
        carrier = _pick(rng, effects, fault.carriers, shower)
        fade_db = _rain_db(fault, effects, rng)
        effects.uplink_fade_db[:, carrier] += fade_db
        effects.add_flag(fade_db > 0.0, [carrier], FaultFlag.UPLINK_RAIN)


@apply_fault.register
def _(fault: DownlinkRain, effects: Effects, rng: np.random.Generator) -> None:
    fade_db = _rain_db(fault, effects, rng)
    np.add(effects.downlink_fade_db, fade_db, out=effects.downlink_fade_db)
    effects.add_flag(fade_db > 0.0, range(len(effects.ids)), FaultFlag.DOWNLINK_RAIN)


@apply_fault.register
def _(fault: SwitchOff, effects: Effects, rng: np.random.Generator) -> None:
    carriers = [_pick(rng, effects, fault.carriers, number) for number in range(max(1, len(fault.carriers)))]
    start_h, duration_h, after_db = (_draw(rng, r) for r in (fault.start_h, fault.duration_h, fault.level_after_db))
    stop_h = start_h + duration_h
    effects.add_flag((effects.hours >= start_h) & (effects.hours < stop_h), carriers, FaultFlag.OFF)
    if after_db != 0.0:
        after = effects.hours >= stop_h
        effects.level_db[np.ix_(after, np.array(carriers))] += after_db
        effects.add_flag(after, carriers, FaultFlag.STEP)


@apply_fault.register
def _(fault: Step, effects: Effects, rng: np.random.Generator) -> None:
    for number in range(fault.count):
        carrier = _pick(rng, effects, fault.carriers, number)
        after = effects.hours >= _draw(rng, fault.start_h)
        effects.level_db[after, carrier] += _draw(rng, fault.size_db) * rng.choice([-1.0, 1.0])
        effects.add_flag(after, [carrier], FaultFlag.STEP)


@apply_fault.register
def _(fault: GroupStep, effects: Effects, rng: np.random.Generator) -> None:
    transponder = fault.transponder or str(rng.choice(sorted(effects.plan.beams)))
    members = [k for k, carrier in enumerate(effects.plan.carriers) if carrier.transponder == transponder]
    start_h = _draw(rng, fault.start_h)
    stop_h = start_h + fault.duration_h if fault.duration_h > 0.0 else np.inf
    rows = (effects.hours >= start_h) & (effects.hours < stop_h)
    effects.level_db[np.ix_(rows, np.array(members))] += _draw(rng, fault.size_db) * rng.choice([-1.0, 1.0])
    effects.add_flag(rows, members, FaultFlag.GROUP_STEP)


@apply_fault.register
def _(fault: ChainStep, effects: Effects, rng: np.random.Generator) -> None:
    after = effects.hours >= _draw(rng, fault.start_h)
    effects.chain_db[after] += _draw(rng, fault.size_db)
    effects.add_flag(after, range(len(effects.ids)), FaultFlag.CHAIN_STEP)


@apply_fault.register
def _(fault: Interference, effects: Effects, rng: np.random.Generator) -> None:
    for number in range(fault.count):
        carrier = _pick(rng, effects, fault.carriers, number)
        start_h, duration_h = _draw(rng, fault.start_h), _draw(rng, fault.duration_min) / 60.0
        rows = (effects.hours >= start_h) & (effects.hours < start_h + duration_h)
        effects.interference_db[rows, carrier] = _draw(rng, fault.level_db)
        effects.add_flag(rows, [carrier], FaultFlag.INTERFERENCE)


@apply_fault.register
def _(fault: Gap, effects: Effects, rng: np.random.Generator) -> None:
    for _number in range(fault.count):
        start_h, duration_h = _draw(rng, fault.start_h), _draw(rng, fault.duration_min) / 60.0
        rows = (effects.hours >= start_h) & (effects.hours < start_h + duration_h)
        effects.add_flag(rows, range(len(effects.ids)), FaultFlag.GAP)


def _draw(rng: np.random.Generator, limits: Range) -> float:
    return float(rng.uniform(*limits))


def _pick(rng: np.random.Generator, effects: Effects, carriers: tuple[str, ...], number: int) -> int:
    """Return the number-th of the named carriers, or a drawn one where none is named."""
    drawn = int(rng.integers(len(effects.ids)))
    return effects.ids.index(carriers[number % len(carriers)]) if carriers else drawn


def _rain_db(fault: UplinkRain | DownlinkRain, effects: Effects, rng: np.random.Generator) -> FloatArray:
    """Return the fade (T,) of one rain: a trapezoid that breathes."""
    start_h, depth_db = _draw(rng, fault.start_h), _draw(rng, fault.depth_db)
    rise_h = depth_db / _draw(rng, fault.slope_db_min) / 60.0
    full_h = _draw(rng, fault.duration_min) / 60.0
    knots_h = start_h + np.array([0.0, rise_h, rise_h + full_h, 2.0 * rise_h + full_h])
    fade_db = np.interp(effects.hours, knots_h, [0.0, depth_db, depth_db, 0.0])
    wet = np.flatnonzero(fade_db > 0.0)
    breath = rng.normal(size=len(wet))
    keep = np.exp(-effects.row_h * 60.0 / RAIN_BREATH_MIN)
    for row in range(1, len(wet)):
        breath[row] = keep * breath[row - 1] + np.sqrt(1.0 - keep**2) * breath[row]
    fade_db[wet] *= np.maximum(0.0, 1.0 + RAIN_BREATH_SHARE * breath)
    return np.asarray(fade_db)
