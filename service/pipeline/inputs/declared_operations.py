"""Declared operations as the attitude filter sees them: who is not to be believed, and what may have moved by how much.

| kind | while it lasts | when it begins and ends |
|---|---|---|
| station_keeping, momentum_unloading, other, calibration_turn | the attitude walks, to the stated uncertainty | - |
| eclipse, and an hour after | gains of the transponders and single levels walk, the attitude as far as stated | - |
| sun_outage | its carriers are not used | - |
| carrier_work | its carriers are not used | their references are free |
| gain_change | - | each transponder's references may have moved together |
| receive_chain_work | the chain walks | the chain may have moved |
"""

import numpy as np

from service.core.estimation.filtering.row_block import Declared, nothing_declared
from service.pipeline.config import OperationConfig
from service.records.epoch import US_PER_S
from service.records.inputs import TURNING_KINDS, Operation
from service.records.levels.attitude import BoolArray, FloatArray

_US_PER_H = 3600 * US_PER_S
#: an eclipse leaves its mark for this long, us
_WARMING_US = 3600 * US_PER_S
#: an operation without an end is spread over this, h
_OPEN_HOURS = 1.0


class _Effect:
    """Sum of the effects of the operations of one step."""

    def __init__(self, carriers: int, transponders: int) -> None:
        self.is_masked: BoolArray = np.zeros(carriers, dtype=np.bool_)
        self.reference_walk_db2 = np.zeros(carriers)
        self.reference_step_db2 = np.zeros(carriers)
        self.group_step_db2 = np.zeros(transponders)
        self.chain_walk_db2 = 0.0
        self.chain_step_db2 = 0.0
        self.attitude_walk_deg2 = np.zeros(3)
        self.attitude_step_deg2 = np.zeros(3)

    def declared(self) -> Declared:
        """Return the sums as standard deviations."""
        return Declared(
            self.is_masked,
            np.zeros(len(self.is_masked)),
            np.sqrt(self.reference_walk_db2),
            float(np.sqrt(self.chain_walk_db2)),
            np.sqrt(self.attitude_walk_deg2),
            np.sqrt(self.reference_step_db2),
            np.sqrt(self.group_step_db2),
            float(np.sqrt(self.chain_step_db2)),
            np.sqrt(self.attitude_step_deg2),
        )


class CarrierIndices:
    """Indices in the model of the carriers that an operation names."""

    def __init__(self, carrier_ids: tuple[str, ...], transponders: tuple[str, ...], transponder: FloatArray) -> None:
        self._carrier_ids = np.array(carrier_ids)
        self._transponders = transponders
        self._transponder = transponder

    @property
    def carriers(self) -> int:
        """Number of carriers."""
        return len(self._carrier_ids)

    @property
    def transponders(self) -> int:
        """Number of transponders."""
        return len(self._transponders)

    def named_carriers(self, operation: Operation) -> BoolArray:
        """Return which carriers (N,) an operation concerns: those it names, else all."""
        if operation.carriers is None and operation.transponders is None:
            return np.ones(self.carriers, dtype=np.bool_)
        by_name = np.isin(self._carrier_ids, list(operation.carriers or ()))
        return np.asarray(by_name | self.named_transponders(operation)[self._transponder])

    def named_transponders(self, operation: Operation) -> BoolArray:
        """Return which transponders (G,) an operation concerns: those it names, none where it names carriers only."""
        if operation.carriers is None and operation.transponders is None:
            return np.ones(self.transponders, dtype=np.bool_)
        return np.isin(np.array(self._transponders), list(operation.transponders or ()))


def declared_between(
    operations: tuple[Operation, ...], names: CarrierIndices, from_us: int, to_us: int, config: OperationConfig
) -> Declared | None:
    """Return the effect of the operations on the step between two epochs, None where there is none."""
    if not operations:
        return None
    effect, is_any = _Effect(names.carriers, names.transponders), False
    for operation in operations:
        stop_us = operation.stop_us if operation.stop_us is not None else to_us + 1
        lasting_us = stop_us + (_WARMING_US if operation.kind == "eclipse" else 0)
        if operation.start_us <= to_us and lasting_us > from_us:
            is_any = True
            overlap_us = min(to_us, lasting_us) - max(from_us, operation.start_us)
            _add_lasting(effect, operation, names, overlap_us, is_now=to_us < stop_us, config=config)
        edges = int(from_us < operation.start_us <= to_us) + int(from_us < stop_us <= to_us)
        if edges:
            is_any = True
            _add_edges(effect, operation, names, edges, config)
    if not is_any:
        return None
    hours = (to_us - from_us) / _US_PER_H
    # a walk acts for the whole step, an operation perhaps only for a part of it
    effect.attitude_walk_deg2 /= hours
    effect.chain_walk_db2 /= hours
    effect.reference_walk_db2 /= hours
    return effect.declared()


def with_chain_step(declared: Declared | None, names: CarrierIndices, step_db: float) -> Declared:
    """Return the effect with a step of the receiving chain, as a change of the measuring source makes one."""
    base = declared or nothing_declared(names.carriers, names.transponders)
    return base._replace(chain_step_db=float(np.hypot(base.chain_step_db, step_db)))


def _add_lasting(
    effect: _Effect,
    operation: Operation,
    names: CarrierIndices,
    overlap_us: int,
    *,
    is_now: bool,
    config: OperationConfig,
) -> None:
    """Add what an operation does in the part of a step in which it lasts; walks as variance of the whole step."""
    hours = max(0, overlap_us) / _US_PER_H
    if operation.kind in ("sun_outage", "carrier_work"):
        if is_now:
            effect.is_masked |= names.named_carriers(operation)
    elif operation.kind == "eclipse":
        effect.group_step_db2 += names.named_transponders(operation) * config.eclipse_gain_db_sqrt_h**2 * hours
        effect.reference_walk_db2 += names.named_carriers(operation) * config.eclipse_level_db_sqrt_h**2 * hours
        effect.attitude_walk_deg2 += _turned_deg2(operation, 0.0) * (hours / _length_h(operation))
    elif operation.kind == "receive_chain_work":
        effect.chain_walk_db2 += config.gain_step_db**2 * hours
    elif operation.kind in TURNING_KINDS:
        effect.attitude_walk_deg2 += _turned_deg2(operation, _usual_deg(operation.kind, config)) * (
            hours / _length_h(operation)
        )


def _add_edges(
    effect: _Effect, operation: Operation, names: CarrierIndices, edges: int, config: OperationConfig
) -> None:
    """Add what the beginning or the end of an operation does."""
    if operation.kind == "carrier_work":
        effect.reference_step_db2 += names.named_carriers(operation) * config.carrier_step_db**2 * edges
    elif operation.kind == "gain_change":
        effect.group_step_db2 += names.named_transponders(operation) * config.gain_step_db**2 * edges
    elif operation.kind == "receive_chain_work":
        effect.chain_step_db2 += config.gain_step_db**2 * edges


def _usual_deg(kind: str, config: OperationConfig) -> float:
    """Return the uncertainty of an operation that states none, deg."""
    usual = {
        "station_keeping": config.station_keeping_deg,
        "momentum_unloading": config.momentum_unloading_deg,
        "calibration_turn": 0.5,
    }
    return usual.get(kind, 0.0)


def _turned_deg2(operation: Operation, usual_deg: float) -> FloatArray:
    """Return the variance (3,) of each angle that an operation leaves, deg^2."""
    if operation.attitude_uncertainty_deg is None:
        return np.full(3, usual_deg**2)
    stated = np.array(operation.attitude_uncertainty_deg, dtype=np.float64)
    return np.where(np.isfinite(stated), stated, 0.0) ** 2


def _length_h(operation: Operation) -> float:
    """Return how long an operation lasts, h."""
    if operation.stop_us is None:
        return _OPEN_HOURS
    return max(operation.stop_us - operation.start_us, US_PER_S) / _US_PER_H
