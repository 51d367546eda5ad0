"""Conditions that alarm: what each looks at, its limits by default, and what to do about it.

The page docs/reference/alarms.md is made from this table.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from service.errors import FieldError
from service.pipeline.alarms.states import AlarmCondition, Kind, Origin
from service.pipeline.config import AlarmConfig, RobustConfig
from service.records.catalogue import CarrierPlan
from service.records.inputs import Operation
from service.records.operations.alarms import AlarmLimits, ConditionLimits, Statement

_HOUR_S = 3600.0
#: next step of an alarm that another one explains, whatever its condition
FOLLOWS = "act on the alarm that explains this one; nothing else is to be done while it does"


def _condition(
    subject: tuple[str, Kind, str, str, Origin], says: str, next_step: str, limits: ConditionLimits
) -> AlarmCondition:
    """Return a condition; its subject is name, kind, unit, thing and origin."""
    return AlarmCondition(*subject, says, next_step, limits)


def condition_table(alarms: AlarmConfig, robust: RobustConfig) -> dict[str, AlarmCondition]:
    """Return every condition by name."""
    estimate = (*_of_attitude(alarms), *_of_agreement(robust))
    rows = (*_of_carriers(), *estimate, *_of_inputs(alarms), *_of_release(), *_of_service(alarms))
    return {row.name: row for row in rows}


def _of_carriers() -> tuple[AlarmCondition, ...]:
    return (
        _condition(
            ("carrier_level", Kind.ABOVE, "dB", "carrier", Origin.ROW),
            "level of carrier {thing} differs from the expected level by {value}",
            "look at the carrier's trace; ask its user whether power or traffic was changed and declare carrier_work "
            "if so; the estimate excludes a single changed carrier automatically",
            ConditionLimits(warning=3.0, distress=6.0, deadband=0.5, on_s=300.0, off_s=300.0),
        ),
        _condition(
            ("carrier_absent", Kind.LASTING, "s", "carrier", Origin.ROW),
            "carrier {thing} has been absent for {value}",
            "look at the trace; ask the user whether the carrier was switched off; declare carrier_work while it is",
            ConditionLimits(warning=120.0, distress=_HOUR_S, off_s=120.0),
        ),
        _condition(
            ("carrier_c_n0", Kind.BELOW, "dB", "carrier", Origin.ROW),
            "carrier to noise ratio of carrier {thing} is {value}",
            "compare with the other carriers: all low means rain or the receiving chain, one low its uplink",
            ConditionLimits(warning=6.0, distress=3.0, deadband=0.5, on_s=300.0, off_s=300.0),
        ),
        _condition(
            ("carrier_residual", Kind.ABOVE, "dB", "carrier", Origin.ROW),
            "residual of carrier {thing} is {value}",
            "see whether its uplink fades or its traffic changed; a carrier that stays so needs a new calibration",
            ConditionLimits(watch=1.5, warning=3.0, deadband=0.3, on_s=600.0, off_s=600.0, repeat_s=None),
        ),
    )


def _of_attitude(alarms: AlarmConfig) -> tuple[AlarmCondition, ...]:
    """Return the conditions of the attitude rows of the method that drives control."""
    return (
        _condition(
            ("attitude_angle", Kind.ABOVE, "deg", "axis", Origin.ROW),
            "{thing} angle is {value}",
            "check with another sensor; see GET .../control and the newest torque; beyond 0.4 deg a person "
            "releases single commands, beyond 2 deg control is withheld",
            ConditionLimits(
                warning=alarms.attitude_warning_deg,
                critical=alarms.attitude_critical_deg,
                deadband=0.02,
                on_s=120.0,
                off_s=300.0,
                repeat_s=600.0,
            ),
        ),
        _condition(
            ("protection_level", Kind.ABOVE, "deg", "axis", Origin.ROW),
            "protection level of {thing} is {value}: two answers are possible",
            "control waits by itself; see the carriers' hypotheses in GET .../measurements; in rain wait, in the dry "
            "align again",
            ConditionLimits(warning=alarms.protection_warning_deg, deadband=0.02, on_s=600.0, off_s=600.0),
        ),
        _condition(
            ("attitude_lost", Kind.LASTING, "s", "method", Origin.ROW),
            "method {thing} has given no attitude for {value}",
            "see the inhibitions and the excluded carriers of GET .../attitude",
            ConditionLimits(warning=300.0, critical=1800.0, off_s=120.0),
        ),
    )


def _of_agreement(robust: RobustConfig) -> tuple[AlarmCondition, ...]:
    """Return the conditions between methods, sensors and carriers."""
    return (
        _condition(
            ("methods_disagree", Kind.ABOVE, "deg", "methods", Origin.ROW),
            "methods {thing} disagree in roll or pitch by {value}",
            "compare both with another sensor and with the residuals; align again if both are wrong",
            ConditionLimits(
                # the chain has waited for them to be apart for long
                warning=robust.disagreement_deg,
                off_s=0.0,
                latching=True,
            ),
        ),
        _condition(
            ("chain_lost", Kind.LASTING, "s", "receiving site", Origin.ROW),
            "no carrier has been received at the {thing} for {value}",
            "check antenna, receiving chain and analyzer; the users need not be asked",
            ConditionLimits(warning=120.0, critical=1800.0, off_s=120.0, repeat_s=600.0),
        ),
        _condition(
            ("chain_level", Kind.ABOVE, "dB", "receiving site", Origin.ROW),
            "level of all carriers at the {thing} differs from the expected level by {value}",
            "check the gain of the receiving chain and of the analyzer; declare gain_change or align again",
            # below the least limit of carrier_level, which must not alarm for every carrier first
            ConditionLimits(watch=2.0, warning=3.0, distress=6.0, deadband=0.5, on_s=300.0, off_s=300.0),
        ),
        _condition(
            ("downlink_fade", Kind.ABOVE, "dB", "receiving site", Origin.ROW),
            "downlink fade at the {thing} is {value}",
            "wait for the rain to end; control resumes automatically; without rain check the receiving chain",
            ConditionLimits(watch=0.0, warning=6.0, deadband=0.0, on_s=300.0, off_s=600.0, repeat_s=None),
        ),
        _condition(
            ("sensor_disagreement", Kind.ABOVE, "deg", "sensor", Origin.REFERENCE),
            "sensor {thing} differs from the estimate, beyond three sigma of both, by {value}",
            "compare both with a third sensor; align again if the estimate is wrong",
            ConditionLimits(warning=0.15, distress=0.3, deadband=0.03, on_s=600.0, off_s=600.0, latching=True),
        ),
        _condition(
            ("measured_motion", Kind.LASTING, "s", "advice", Origin.ROW),
            "wheels, rates or polarimeter are not used as stated: {thing} for {value}",
            "see the text of this advice in GET .../status; correct the telemetry, the instrument or the catalogue",
            ConditionLimits(warning=60.0, off_s=600.0),
        ),
        _condition(
            ("undeclared_operation", Kind.LASTING, "s", "actuators", Origin.ROW),
            "{thing} have acted for {value} by telemetry, and no operation is declared",
            "declare it with POST .../operations; if nobody ordered it, find out what fires",
            ConditionLimits(warning=0.0, off_s=0.0),
        ),
    )


def _of_inputs(alarms: AlarmConfig) -> tuple[AlarmCondition, ...]:
    return (
        _condition(
            ("data_stale", Kind.ABOVE, "row periods", "source", Origin.CLOCK),
            "newest row of source {thing} is {value} old",
            "see GET /links and the front end; select the other source if there is one",
            ConditionLimits(
                warning=alarms.stale_periods, distress=10.0 * alarms.stale_periods, off_s=0.0, repeat_s=600.0
            ),
        ),
        _condition(
            ("link_down", Kind.ABOVE, "s", "link", Origin.CLOCK),
            "link {thing} has been down for {value}",
            "see its detail in GET /links; check front end, analyzer and line; POST /links/{id}:reset opens a session",
            # only 0 s lies a deadband inside 30 s: a link is back when it works, not when it has just failed again
            ConditionLimits(distress=30.0, critical=_HOUR_S, deadband=30.0, off_s=10.0, repeat_s=600.0),
        ),
        _condition(
            ("link_warning", Kind.ABOVE, "s", "link/warning", Origin.CLOCK),
            "warning {thing} of the front end has been active for {value}",
            "see the warning in GET /links; for a full spool restore the line to the service or add disk space",
            ConditionLimits(warning=0.0, distress=_HOUR_S),
        ),
        _condition(
            ("rows_missing", Kind.ABOVE, "rows", "source", Origin.CLOCK),
            "missing from source {thing} in the last hour: {value}",
            "see GET .../archive/gaps; `soo put powers` brings what the front end's spool still holds",
            ConditionLimits(warning=0.0, distress=100.0, on_s=120.0, off_s=60.0, repeat_s=None),
        ),
        _condition(
            ("telemetry_refused", Kind.ABOVE, "records", "quantity", Origin.CLOCK),
            "telemetry of {thing} beyond its limit, refused one after another: {value}",
            "check unit and scale of the telemetry; correct wheels.momentum_limit_n_m_s if the wheels can store more",
            ConditionLimits(warning=2.0),
        ),
    )


def _of_release() -> tuple[AlarmCondition, ...]:
    return (
        _condition(
            ("control_tripped", Kind.ABOVE, "s", "reason", Origin.CLOCK),
            "control has tripped: {thing}",
            "find the cause in GET .../control, POST .../control:reset; ten good minutes later POST .../control:arm",
            ConditionLimits(distress=0.0, repeat_s=_HOUR_S),
        ),
        _condition(
            ("control_balance", Kind.ABOVE, "s", "control", Origin.CLOCK),
            "control is inhibited, and only the known {thing} has been balanced for {value}",
            "see the reasons in GET .../control; bring the angles back by another sensor before balance ends",
            # an hour is left of hold_s
            ConditionLimits(warning=0.0, distress=2.0 * _HOUR_S, repeat_s=None),
        ),
        _condition(
            ("report_late", Kind.ABOVE, "s", "command", Origin.CLOCK),
            "time without a report since the end of {thing} is {value}",
            "ask the centre what was executed; POST .../torques/{id}:executed or :failed; no torque is released before",
            ConditionLimits(distress=600.0, repeat_s=600.0),
        ),
    )


def _of_service(alarms: AlarmConfig) -> tuple[AlarmCondition, ...]:
    """Return the conditions of estimator, calibration, ephemeris, keys and disk."""
    return (
        _condition(
            ("estimator_failed", Kind.ABOVE, "s", "failure", Origin.CLOCK),
            "no attitude is computed, every {thing} has failed for {value}",
            "read the service log; `soo doctor` finds what is stored wrong; rows are kept meanwhile and computed later",
            ConditionLimits(critical=0.0, repeat_s=600.0),
        ),
        _condition(
            ("document_corrupt", Kind.ABOVE, "s", "document", Origin.CLOCK),
            "{thing} has differed from its digest for {value}: it was changed in the database",
            "control has tripped; restore the document from a backup, or make it again; `soo doctor` names all of them",
            ConditionLimits(critical=0.0, repeat_s=_HOUR_S),
        ),
        _condition(
            ("calibration_old", Kind.ABOVE, "d", "calibration", Origin.CLOCK),
            "data of calibration {thing} ended {value} ago",
            "plan a quiet day and turns, calibrate, activate",
            ConditionLimits(watch=90.0, warning=180.0, repeat_s=None),
        ),
        _condition(
            ("ephemeris_ending", Kind.BELOW, "h", "ephemeris", Origin.CLOCK),
            "remaining validity of the {thing} ephemeris is {value}",
            "PUT .../ephemeris with the newest orbit of the ballistics centre",
            ConditionLimits(watch=48.0, warning=12.0, distress=0.0, repeat_s=6 * _HOUR_S),
        ),
        _condition(
            ("key_ending", Kind.BELOW, "d", "key", Origin.CLOCK),
            "remaining validity of key {thing} is {value}",
            "make a new key (`soo keys create`), hand it to its user, remove the old one",
            ConditionLimits(watch=14.0, warning=3.0, repeat_s=24 * _HOUR_S),
        ),
        _condition(
            ("disk_full", Kind.BELOW, "MB", "disk", Origin.CLOCK),
            "free space of the {thing} is {value}",
            "free space or shorten the retention; a full disk refuses rows, which wait in the spools of the front ends",
            ConditionLimits(
                warning=alarms.disk_warning_mb, critical=alarms.disk_critical_mb, deadband=64.0, off_s=60.0
            ),
        ),
    )


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
