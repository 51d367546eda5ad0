"""Limit sets: which are in force, whom a declared operation keeps quiet, and the limits that follow.

| set | in force while |
|---|---|
| normal | always; the others change single figures of it |
| eclipse | an operation `eclipse` lasts |
| manoeuvre | `station_keeping`, `momentum_unloading` or `calibration_turn` lasts |

`carrier_work`, `gain_change`, `receive_chain_work` and `sun_outage` suppress the alarms of the carriers that they
name, of all carriers where they name none.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from service.errors import FieldError
from service.pipeline.alarms.states import AlarmCondition, Kind
from service.records.catalogue import CarrierPlan
from service.records.inputs import Operation
from service.records.operations.alarms import AlarmLimits, ConditionLimits, Statement

NORMAL, ECLIPSE, MANOEUVRE = "normal", "eclipse", "manoeuvre"
#: later ones prevail
SETS = (NORMAL, ECLIPSE, MANOEUVRE)
_SET_OF_KIND = {
    "eclipse": ECLIPSE,
    "station_keeping": MANOEUVRE,
    "momentum_unloading": MANOEUVRE,
    "calibration_turn": MANOEUVRE,
}
_QUIETING_KINDS = ("carrier_work", "gain_change", "receive_chain_work", "sun_outage")
_CARRIER_CONDITIONS = ("carrier_level", "carrier_absent", "carrier_c_n0", "carrier_residual")

#: what the sets change by default
DEFAULT_SETS: dict[str, dict[str, Statement]] = {
    NORMAL: {},
    ECLIPSE: {
        "carrier_level": {"warning": 5.0, "distress": 8.0},
        "carrier_residual": {"watch": 3.0, "warning": 6.0},
    },
    MANOEUVRE: {
        "attitude_angle": {"warning": 0.5, "critical": 0.8},
        "carrier_level": {"warning": 5.0, "distress": 10.0},
        "carrier_residual": {"suppressed": True},
        "methods_disagree": {"suppressed": True},
        "sensor_disagreement": {"suppressed": True},
    },
}


class AlarmContext(NamedTuple):
    """Context of alarms at an instant: limit sets in force and suppressed carriers."""

    #: sets in force, in the order of ``SETS``
    sets: tuple[str, ...] = (NORMAL,)
    #: carriers whose alarms are suppressed
    quiet_carriers: frozenset[str] = frozenset()
    #: the instants between which this is so
    since_us: int = -(1 << 62)
    until_us: int = 1 << 62

    def is_quiet(self, condition: str, thing: str) -> bool:
        """Return whether a declared operation keeps an alarm quiet."""
        return condition in _CARRIER_CONDITIONS and thing in self.quiet_carriers


def context(operations: Iterable[Operation], plan: CarrierPlan | None, epoch_us: int) -> AlarmContext:
    """Return the context of alarms at an epoch, and its span if no operation changes."""
    wanted = {NORMAL}
    quiet: set[str] = set()
    since_us, until_us = AlarmContext().since_us, AlarmContext().until_us
    for operation in operations:
        edges_us = [operation.start_us] if operation.stop_us is None else [operation.start_us, operation.stop_us]
        since_us = max([since_us, *(edge for edge in edges_us if edge <= epoch_us)])
        until_us = min([until_us, *(edge for edge in edges_us if edge > epoch_us)])
        if operation.start_us > epoch_us or (operation.stop_us is not None and operation.stop_us <= epoch_us):
            continue
        if operation.kind in _SET_OF_KIND:
            wanted.add(_SET_OF_KIND[operation.kind])
        if operation.kind in _QUIETING_KINDS and plan is not None:
            quiet.update(_named(operation, plan))
    return AlarmContext(tuple(name for name in SETS if name in wanted), frozenset(quiet), since_us, until_us)


def _named(operation: Operation, plan: CarrierPlan) -> Iterable[str]:
    """Return the carriers that an operation names, all where it names none."""
    if operation.carriers is None and operation.transponders is None:
        return plan.carrier_ids
    transponders = operation.transponders or ()
    return (*(operation.carriers or ()), *(one.id for one in plan.carriers if one.transponder in transponders))


def limits_in_force(
    conditions: Mapping[str, AlarmCondition], stated: AlarmLimits, sets: Sequence[str]
) -> dict[str, ConditionLimits]:
    """Return the limits of every condition under some sets: defaults, changed by what each set states."""
    return {name: _changed(row.limits, name, stated, sets) for name, row in conditions.items()}


def _changed(limits: ConditionLimits, name: str, stated: AlarmLimits, sets: Sequence[str]) -> ConditionLimits:
    """Return the limits of one condition."""
    for chosen in sets:
        changes: dict[str, Any] = {**DEFAULT_SETS[chosen].get(name, {}), **stated.sets.get(chosen, {}).get(name, {})}
        limits = replace(limits, **changes) if changes else limits
    return limits


def faults_of(conditions: Mapping[str, AlarmCondition], stated: AlarmLimits) -> tuple[FieldError, ...]:
    """Return the faults of stated limits: unknown conditions, severities out of order."""
    faults = []
    for chosen, statements in stated.sets.items():
        for name in statements:
            pointer = f"/sets/{chosen}/{name}"
            if name not in conditions:
                detail = f"there is no condition {name[:64]!r}"
                faults.append(FieldError(pointer, "alarm_limits.condition", detail))
            elif not _is_ordered(
                conditions[name].kind, _changed(conditions[name].limits, name, stated, _up_to(chosen))
            ):
                detail = "a higher severity must not be reached before a lower one"
                faults.append(FieldError(pointer, "alarm_limits.order", detail))
    return tuple(faults)


def _up_to(chosen: str) -> tuple[str, ...]:
    """Return the sets that hold when one is in force alone."""
    return (NORMAL,) if chosen == NORMAL else (NORMAL, chosen)


def _is_ordered(kind: Kind, limits: ConditionLimits) -> bool:
    """Return whether limits of rising severity lie ever farther out."""
    stated = [threshold for threshold in limits.thresholds if threshold is not None]
    return stated == sorted(stated, reverse=kind is Kind.BELOW)
