"""The present as operators see it: newest rows, status, links, jobs, hand-over."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple, TypeVar

from service.api.context import ApiContext
from service.api.schemas.control import VerdictAnswer
from service.api.schemas.inputs import OperationAnswer
from service.api.schemas.shift import (
    AlarmAnswer,
    AlarmChildAnswer,
    HandoverAnswer,
    HandoverCalibrationAnswer,
    HandoverKeyAnswer,
    HandoverNoticesAnswer,
    HandoverSourceAnswer,
    LinkAnswer,
    NoteAnswer,
    StatusAnswer,
)
from service.errors import NotFoundError, StorageError
from service.pipeline.control.command.compute_command import ended_command
from service.pipeline.control.release.control_verdict import ControlVerdict, ControlView, control_verdict
from service.pipeline.control.situation import RATE_WINDOW_S, SpacecraftSituation, recent_rate, situation_of
from service.pipeline.estimation.robust.attitude_rows import ADVICE
from service.ports.archive import LIVE
from service.records.calibration import CalibrationState, Window
from service.records.catalogue import Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import Correction, Operation
from service.records.levels.attitude import NO_AXES, AttitudeRow, Axes, ReleasedCommand, Status, TorqueCommand
from service.records.operations.alarms import Alarm, Cover
from service.records.operations.work import LinkReport, LinkState
from service.runtime.jobs.archive_maintenance import newest_advice, runnable_methods

_Found = TypeVar("_Found")

#: state of a link that has missed its reports
SILENT = "SILENT"


def link_answers(context: ApiContext, states: Iterable[LinkState]) -> list[LinkAnswer]:
    """Return links as they are told."""
    missing: dict[str, dict[str, int | None]] = {}
    reported = []
    for state in states:
        spacecraft_id, source = state.report.spacecraft_id, state.report.source
        if spacecraft_id is not None and spacecraft_id not in missing:
            missing[spacecraft_id] = _rows_missing(context, spacecraft_id)
        reported.append(_link_answer(context, state, missing.get(spacecraft_id or "", {}).get(source or "")))
    return reported


def _rows_missing(context: ApiContext, spacecraft_id: str) -> dict[str, int | None]:
    """Return the missing rows of each source; none for a spacecraft that the catalogue lacks."""
    try:
        return {source.id: source.rows_missing for source in context.storage.archive.sources(spacecraft_id)}
    except NotFoundError:
        return {}


def _last_good_age_s(context: ApiContext, report: LinkReport) -> float | None:
    """Return the age of the newest good row by the clock of its epoch; None before the first."""
    try:
        now_us = None if report.spacecraft_id is None else context.clock.now_us(report.spacecraft_id)
    except NotFoundError:
        now_us = None
    if report.last_good_us is None:
        return None
    return _age_s(context.clock.system_us() if now_us is None else now_us, report.last_good_us)


def _link_answer(context: ApiContext, state: LinkState, rows_missing: int | None) -> LinkAnswer:
    """Return a link as it is told."""
    report, now_us = state.report, context.clock.system_us()
    return LinkAnswer.of(
        report,
        state=SILENT if state.is_silent(now_us) else report.state,
        reported_state=report.state,
        enabled=state.enabled,
        reported_at=state.reported_at_us,
        age_s=_age_s(now_us, state.reported_at_us),
        period_s=state.period_s,
        last_good_age_s=_last_good_age_s(context, report),
        reset_pending=state.resets > report.reset_seen,
        rows_missing=rows_missing,
    )


def _age_s(now_us: int, then_us: int) -> float:
    """Return the time since an instant; none where clocks disagree."""
    return max(now_us - then_us, 0) / US_PER_S


#: the reason of an answer that outlived its row
EXPIRED = "expired"
#: the reason of an answer while the chain is brought back after a restart
CATCH_UP = "catch_up"


def newest_attitude(context: ApiContext, spacecraft_id: str, method: Method) -> AttitudeRow | None:
    """Return the newest live row of a method as it holds now; None before the first."""
    row = context.storage.results.newest_attitude(spacecraft_id, LIVE, method)
    if row is None:
        return None
    if context.supervisor.is_catching_up(spacecraft_id):
        row = _not_present(row, row.status, CATCH_UP)
    return _not_present(row, Status.EXPIRED, EXPIRED) if _is_expired(context, spacecraft_id, row) else row


def newest_command(
    context: ApiContext, spacecraft: Spacecraft, row: AttitudeRow | None, *, is_withheld: bool
) -> TorqueCommand | None:
    """Return the newest command as it holds now, given the newest row of the method that drives control.

    A row from which nothing was computed stores no command, yet it ends the one before, and so does a trip: the answer
    is then the zero command that follows from that row, with its reasons. None before the first command.
    """
    # read after the row: a row and its command are stored together, so this one is as new as the row or newer
    command = context.storage.results.newest_command(spacecraft.id, LIVE)
    if command is None or row is None:
        return command
    is_ended = command.attitude_epoch_us < row.epoch_us and bool(row.inhibitions)
    is_present = {EXPIRED, CATCH_UP}.isdisjoint(row.inhibitions)
    if is_present and not is_ended and not (is_withheld and command.is_permitted):
        return command
    return ended_command(row, spacecraft, command.command_period_s, is_withheld=is_withheld)


def _is_expired(context: ApiContext, spacecraft_id: str, row: AttitudeRow) -> bool:
    """Return whether a row is too old to be the present."""
    if context.clock.is_data(spacecraft_id):
        return False
    now_us = context.clock.now_us(spacecraft_id)
    return now_us is not None and now_us - row.epoch_us > context.limits.expired_after_s * US_PER_S


def _not_present(row: AttitudeRow, status: Status, reason: str) -> AttitudeRow:
    """Return a row as it holds when it is not the present."""
    return replace(
        row,
        status=status,
        control_allowed=False,
        control_allowed_axes=NO_AXES,
        inhibitions=tuple(dict.fromkeys((*row.inhibitions, reason))),
    )


class Present(NamedTuple):
    """State of the present that every answer about it shares."""

    #: of the method that drives control
    row: AttitudeRow | None
    command: TorqueCommand | None
    verdict: ControlVerdict
    situation: SpacecraftSituation

    @property
    def control(self) -> VerdictAnswer:
        """The verdict as every answer about the present has it."""
        return VerdictAnswer.of(self.verdict, situation=self.situation)


def present_of(context: ApiContext, spacecraft: Spacecraft, view: ControlView | None = None) -> Present:
    """Return the present; a view that an order has just given stands for the interlock."""
    row = newest_attitude(context, spacecraft.id, spacecraft.control.method)
    if view is None:
        try:
            view = context.release_service.control(spacecraft.id)
        except StorageError:
            # estimation can be read while nothing can be stored
            view = None
    command = newest_command(context, spacecraft, row, is_withheld=view is not None and view.is_withheld)
    failing = context.supervisor.failures.lasting(spacecraft.id)
    failure = failing[0].error if failing else None
    now_us = context.clock.now_us(spacecraft.id)
    age_s = None if row is None or now_us is None else _age_s(now_us, row.epoch_us)
    verdict = control_verdict(view, row if command is None else command, failure, age_s)
    rate = None if row is None else _recent_rate(context, spacecraft.id, row)
    return Present(row, command, verdict, situation_of(row, verdict, context.interlock.validity_limit_deg, rate))


#: rows that a rate is taken from; the newest half hour of them where they come each ten seconds
_RATE_ROWS = 180


def _recent_rate(context: ApiContext, spacecraft_id: str, row: AttitudeRow) -> Axes | None:
    """Return the rate of the angles up to a row; the rows before it are read once for all requests."""
    place = (row.method, row.epoch_us, row.number)
    known = context.recent_rates.get(spacecraft_id)
    if known is None or known[0] != place:
        window = Window(row.epoch_us - round(RATE_WINDOW_S * US_PER_S), row.epoch_us + 1)
        read = context.storage.results.attitude_rows
        rows = _readable(
            lambda: tuple(
                read(
                    *(spacecraft_id, LIVE, row.method, _since_commanded(context, spacecraft_id, window)),
                    *(_RATE_ROWS, None),
                    newest_first=True,
                )
            )
        )
        known = context.recent_rates[spacecraft_id] = (place, recent_rate(rows[::-1]))
    return known[1]


def _since_commanded(context: ApiContext, spacecraft_id: str, window: Window) -> Window:
    """Return the part of a window after the newest motion that was commanded: the slope of that goes on no more."""
    asked = ((spacecraft_id, kind, window, 1, None) for kind in ("correction", "released_command"))
    entries = chain.from_iterable(context.storage.archive.inputs(*each, newest_first=True) for each in asked)
    ends_us = [each.content.stop_us for each in entries if isinstance(each.content, Correction | ReleasedCommand)]
    return Window(min(max(ends_us, default=window.start_us), window.stop_us - 1), window.stop_us)


def status_of(context: ApiContext, spacecraft_id: str) -> StatusAnswer:
    """Return the present state; NotFoundError ``spacecraft.unknown``."""
    storage, clock = context.storage, context.clock
    spacecraft = storage.catalogue.spacecraft(spacecraft_id)
    # in this order: with nothing pending, the newest attitude is that of the newest measurement told, or of a later one
    newest_us = storage.archive.head(spacecraft_id).newest_epoch_us
    methods = _readable(lambda: runnable_methods(storage, spacecraft_id))
    pending = storage.results.pending(spacecraft_id, methods)
    present = present_of(context, spacecraft)
    row, verdict = present.row, present.verdict
    alignments = _readable(lambda: storage.results.alignments(spacecraft_id))
    active = _readable(lambda: storage.results.calibrations(spacecraft_id, CalibrationState.ACTIVE))
    advice = newest_advice(storage, spacecraft_id)
    return StatusAnswer.model_validate(
        {
            "newest_measurement": newest_us,
            "newest_attitude": None if row is None else row.epoch_us,
            "pending": pending,
            "aligned": bool(alignments),
            "realignment_advised": "realign" in advice,
            "advice": [{"code": code, "text": ADVICE[code]} for code in advice if code in ADVICE],
            "methods_disagree": context.supervisor.is_disagreeing(spacecraft_id),
            "clock": "data" if clock.is_data(spacecraft_id) else "system",
            "now": clock.now_us(spacecraft_id),
            "links": _links_of_sources(context, spacecraft_id),
            "control": present.control,
            "interlock": {"state": verdict.state, "reasons": [reason.code for reason in verdict.reasons]},
            "method": spacecraft.control.method,
            "calibration_id": active[0].id if active else None,
            "alignment_id": alignments[0].id if alignments else None,
        }
    )


def _readable(read: Callable[[], tuple[_Found, ...]]) -> tuple[_Found, ...]:
    """Return what is stored, nothing where it cannot be read: the verdict says why nothing is computed."""
    try:
        return read()
    except StorageError as error:
        if error.code != "storage.corrupt":
            raise
        return ()


def _links_of_sources(context: ApiContext, spacecraft_id: str) -> list[dict[str, Any]]:
    """Return every source with the links that carry it, then links that have brought nothing yet."""
    reported = link_answers(context, context.storage.links.links(spacecraft_id))
    found = []
    for source in context.storage.archive.sources(spacecraft_id):
        seen = {
            "source": source.id,
            "role": source.role,
            "newest_epoch": source.newest_epoch_us,
            "rows": source.rows,
            "rows_missing": source.rows_missing,
        }
        carrying: list[LinkAnswer | None] = [link for link in reported if link.source == source.id]
        found += [{**seen, **_report_members(link)} for link in carrying or [None]]
    known = {entry["source"] for entry in found}
    unseen = {"role": None, "newest_epoch": None, "rows": None, "rows_missing": None}
    found += [
        {"source": link.source, **unseen, **_report_members(link)} for link in reported if link.source not in known
    ]
    return found


def _report_members(link: LinkAnswer | None) -> dict[str, Any]:
    """Return the report of a link; nulls where there is none."""
    names = ("id", "kind", "state", "enabled", "age_s", "last_good_age_s")
    warnings = [] if link is None else link.warnings
    return {**{name: getattr(link, name, None) for name in names}, "warnings": warnings}


_HOUR_US = 3600 * US_PER_S
_DAY_US = 24 * _HOUR_US
#: keys that end within this are told, us
_KEYS_US = 30 * _DAY_US
_NOTES = 20
_OPERATIONS = 200


def handover_of(context: ApiContext, spacecraft_id: str) -> HandoverAnswer:
    """Return the handover of a spacecraft; NotFoundError ``spacecraft.unknown``."""
    spacecraft = context.storage.catalogue.spacecraft(spacecraft_id)
    present_us = context.clock.now_us(spacecraft_id)
    now_us = context.clock.system_us() if present_us is None else present_us
    status = status_of(context, spacecraft_id)
    alarms = (*context.storage.alarms.open_alarms(spacecraft_id), *context.storage.alarms.open_alarms(None))
    control = {
        "mode": spacecraft.control.mode,
        "release": spacecraft.control.release,
        "method": spacecraft.control.method,
        **dict(status.control),
        "authorised_until": None,
    }
    return HandoverAnswer.model_validate(
        {
            "spacecraft_id": spacecraft_id,
            "at": now_us,
            "alarms": _alarm_answers(context, alarms, Cover.NONE),
            "shelved": _alarm_answers(context, alarms, Cover.SHELVED),
            "suppressed": _alarm_answers(context, alarms, Cover.SUPPRESSED),
            "control": control,
            "status": status,
            **_foundations(context, spacecraft_id, now_us),
            "keys": _ending_keys(context),
            "links": _link_members(context, spacecraft_id),
            "sources": _sources(context, spacecraft_id),
            "operations": _operations(context, spacecraft_id, now_us),
            "notes": [NoteAnswer.of(note) for note in context.storage.notes.newest(_NOTES, spacecraft_id)],
            "notices": _notices(context),
        }
    )


def _alarm_answers(context: ApiContext, alarms: tuple[Alarm, ...], cover: Cover) -> list[AlarmAnswer]:
    """Return the alarms under a cover that no other explains, worst first, then oldest first."""
    causes = {alarm.key for alarm in alarms}
    chosen = [one for one in alarms if one.cover is cover and one.cause not in causes]
    return [alarm_answer(context, alarm, alarms) for alarm in sorted(chosen, key=_worst_first)]


def alarm_answer(context: ApiContext, alarm: Alarm, alarms: tuple[Alarm, ...]) -> AlarmAnswer:
    """Return an alarm with its newest value and with those among open alarms that follow from it."""
    following = sorted((one for one in alarms if one.cause == alarm.key), key=_worst_first)
    children = [AlarmChildAnswer.of(one, context.alarms.present_value(one)) for one in following]
    return AlarmAnswer.of(alarm, context.alarms.present_value(alarm), children=children)


def _worst_first(alarm: Alarm) -> tuple[int, int]:
    """Return the order of alarms: worst first, then oldest first."""
    return -alarm.severity, alarm.raised_at_us


def _foundations(context: ApiContext, spacecraft_id: str, now_us: int) -> dict[str, Any]:
    """Return age and validity of what the estimate rests on."""
    results, catalogue = context.storage.results, context.storage.catalogue
    calibrations = []
    for one in results.calibrations(spacecraft_id, CalibrationState.ACTIVE):
        age = {"created_at": one.created_at_us, "age_days": (now_us - one.request.data_until_us) / _DAY_US}
        calibrations.append(HandoverCalibrationAnswer.of(one.request, id=one.id, **age))
    alignments = results.alignments(spacecraft_id)
    alignment = None
    if alignments:
        age_hours = (now_us - alignments[0].epoch_us) / _HOUR_US
        alignment = {"id": alignments[0].id, "epoch": alignments[0].epoch_us, "age_hours": age_hours}
    try:
        orbit = catalogue.ephemeris(spacecraft_id)
    except NotFoundError:
        ephemeris = None
    else:
        span = {"valid_start": orbit.valid_start_us, "valid_stop": orbit.valid_stop_us}
        ephemeris = {"id": orbit.id, **span, "hours_left": (orbit.valid_stop_us - now_us) / _HOUR_US}
    return {"calibrations": calibrations, "alignment": alignment, "ephemeris": ephemeris}


def _ending_keys(context: ApiContext) -> list[HandoverKeyAnswer]:
    """Return the keys in force that end soon, the first to end first."""
    now_us = context.clock.system_us()
    ending = []
    for stored in context.storage.keys.all():
        key = stored.key
        if key.expires_at_us is not None and key.is_valid(now_us) and key.expires_at_us - now_us <= _KEYS_US:
            days_left = (key.expires_at_us - now_us) / _DAY_US
            ending.append(HandoverKeyAnswer.of(key, role=key.role.value, days_left=days_left))
    return sorted(ending, key=lambda one: one.days_left)


def _link_members(context: ApiContext, spacecraft_id: str) -> list[Any]:
    """Return the links that want attention."""
    now_us = context.clock.system_us()
    states = context.storage.links.links(spacecraft_id)
    chosen = [state for state in states if state.is_down(now_us) or not state.enabled or state.report.warnings]
    return list(link_answers(context, chosen))


def _sources(context: ApiContext, spacecraft_id: str) -> list[HandoverSourceAnswer]:
    """Return the sources with what they miss."""
    return [HandoverSourceAnswer.of(one, source=one.id) for one in context.storage.archive.sources(spacecraft_id)]


def _operations(context: ApiContext, spacecraft_id: str, now_us: int) -> list[OperationAnswer]:
    """Return the operations in force or near."""
    window = Window(now_us, now_us + _DAY_US)
    entries = context.storage.archive.inputs(spacecraft_id, "operation", window, _OPERATIONS, None)
    return [OperationAnswer.of(entry.content) for entry in entries if isinstance(entry.content, Operation)]


def _notices(context: ApiContext) -> list[HandoverNoticesAnswer]:
    """Return the counts of notices by channel."""
    return [
        HandoverNoticesAnswer.of(channel.counts, channel=channel.name, waiting=channel.waiting)
        for channel in context.alarms.notices.channels
    ]
