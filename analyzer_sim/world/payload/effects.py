"""Effects: what the faults of a scenario add up to, and what the ground is told about them.

Each event draws from the stream of its name and adds to `Effects`; none reads what another one did.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntFlag
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.epochs import US_PER_H
from analyzer_sim.streams import FloatArray
from analyzer_sim.world.orbit import EpochArray
from analyzer_sim.world.payload.carriers import CarrierPlan
from analyzer_sim.world.scenario.events import Range

#: an operation is declared this long before it begins
NOTICE_H = 2.0
#: names of the analyzers: prime, backup
SOURCES = ("sa-1", "sa-2")


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
    WET_ANTENNA = 256
    ECLIPSE = 512
    SUN_OUTAGE = 1024
    LEVEL_CONTROL = 2048
    POWER_CONTROL = 4096
    BACKUP_CHAIN = 8192


@dataclass(frozen=True, slots=True)
class Operation:
    """Operation that the ground declares; fields as in the body of the REST request."""

    kind: str
    start_us: int
    stop_us: int
    #: epoch from which the ground knows
    reported_us: int
    carriers: tuple[str, ...] | None = None
    transponders: tuple[str, ...] | None = None
    inhibit_control: bool = False
    #: yaw, roll, pitch
    attitude_uncertainty_deg: tuple[float, float, float] | None = None
    comment: str = ""


@dataclass(frozen=True, slots=True)
class Effects:
    """Sum of the effects of a scenario's faults; T rows, N carriers."""

    #: (T,) hours from the start of operation
    hours: FloatArray
    row_h: float
    plan: CarrierPlan
    #: start of operation, microseconds
    start_us: int
    #: (T, N) loss by rain over the users' stations, dB
    uplink_fade_db: FloatArray
    #: (T,) loss by rain over the receiving site in the band that feels it in full, dB
    downlink_fade_db: FloatArray
    #: (T, N) changes of level, dB
    level_db: FloatArray
    #: (T,) changes of the receiving chain, dB
    chain_db: FloatArray
    #: (T, N) power of an interfering signal relative to the carrier's level in the plan, dB; NaN = none
    interference_db: FloatArray
    #: (T,) rise of the noise density by the Sun, dB
    sun_noise_db: FloatArray
    #: (T, 2) shift of the uplink patterns against the body, azimuth and elevation, deg
    pattern_shift_deg: FloatArray
    #: (T,) number of the analyzer in SOURCES
    source: NDArray[np.uint8]
    #: (T, N) FaultFlag
    flags: NDArray[np.uint16]
    #: what is declared, in the order of the events
    operations: list[Operation] = field(default_factory=list)
    #: epochs at which another analyzer takes over, and its name
    source_switches: list[tuple[int, str]] = field(default_factory=list)

    @classmethod
    def none(cls, plan: CarrierPlan, epochs_us: EpochArray, start_us: int, row_h: float) -> "Effects":
        """Return effects (T rows) of nothing, to which events add."""
        count, shape = len(epochs_us), (len(epochs_us), len(plan.carriers))
        return cls(
            hours=(epochs_us - start_us) / US_PER_H,
            row_h=row_h,
            plan=plan,
            start_us=start_us,
            uplink_fade_db=np.zeros(shape),
            downlink_fade_db=np.zeros(count),
            level_db=np.zeros(shape),
            chain_db=np.zeros(count),
            interference_db=np.full(shape, np.nan),
            sun_noise_db=np.zeros(count),
            pattern_shift_deg=np.zeros((count, 2)),
            source=np.zeros(count, dtype=np.uint8),
            flags=np.zeros(shape, dtype=np.uint16),
        )

    @property
    def ids(self) -> tuple[str, ...]:
        """Carriers of the plan."""
        return tuple(carrier.id for carrier in self.plan.carriers)

    def add_flag(self, rows: NDArray[np.bool_], carriers: Sequence[int], flag: FaultFlag) -> None:
        """Mark rows (T,) of some carriers."""
        for carrier in carriers:
            self.flags[rows, carrier] |= np.uint16(flag)

    def members(self, transponder: str) -> list[int]:
        """Return the columns of a transponder's carriers."""
        return [k for k, carrier in enumerate(self.plan.carriers) if carrier.transponder == transponder]

    def epoch_us(self, hours: float) -> int:
        """Return the epoch of hours from the start of operation, to the second."""
        return self.start_us + round(hours * 3600.0) * (US_PER_H // 3600)

    def declare(
        self,
        kind: str,
        start_h: float,
        stop_h: float,
        *,
        carriers: tuple[str, ...] | None = None,
        transponders: tuple[str, ...] | None = None,
        inhibit_control: bool = False,
        comment: str = "",
    ) -> None:
        """Add what the ground declares, two hours before it begins."""
        start_us, stop_us, reported_us = (self.epoch_us(hours) for hours in (start_h, stop_h, start_h - NOTICE_H))
        self.operations.append(
            Operation(kind, start_us, stop_us, reported_us, carriers, transponders, inhibit_control, None, comment)
        )

    @property
    def is_on(self) -> NDArray[np.bool_]:
        """(T, N) whether a carrier is on the air."""
        return np.asarray((self.flags & np.uint16(FaultFlag.OFF)) == 0)

    @property
    def is_gap(self) -> NDArray[np.bool_]:
        """(T,) whether nothing is measured."""
        return np.asarray((self.flags[:, 0] & np.uint16(FaultFlag.GAP)) != 0)


@singledispatch
def apply_fault(
    fault: object,
    effects: Effects,  # noqa: ARG001 - the signature of every registered effect
    rng: np.random.Generator,  # noqa: ARG001 - the signature of every registered effect
) -> None:
    """Add one event to the effects."""
    raise TypeError(f"no effect is written for {type(fault).__name__}")


def draw(rng: np.random.Generator, limits: Range) -> float:
    """Draw from a range; equal ends fix the value."""
    return float(rng.uniform(*limits))
