"""Conditions that alarm: what each looks at, its limits by default, and what to do about it.

The page docs/reference/alarms.md is made from this table.
"""

from service.pipeline.alarms.states import AlarmCondition, Kind, Origin
from service.pipeline.config import AlarmConfig, RobustConfig
from service.records.operations.alarms import ConditionLimits

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
    """Return the conditions of single carriers."""
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
    """Return the conditions of sources and links."""
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
    """Return the conditions of the release of torques."""
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
