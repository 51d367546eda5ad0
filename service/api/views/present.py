"""The present as operators see it: newest rows, status, links, jobs, hand-over."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

from service.api.context import ApiContext
from service.api.schemas import shift as documents
from service.api.schemas.control import VerdictAnswer
from service.api.schemas.inputs import OperationAnswer
from service.errors import NotFoundError, StorageError
from service.pipeline.control.command.compute_command import ended_command
from service.pipeline.control.release.control_verdict import ControlVerdict, ControlView, control_verdict
from service.pipeline.control.situation import RATE_WINDOW_S, SpacecraftSituation, recent_rate, situation_of
from service.pipeline.estimation.robust.attitude_rows import ADVICE
from service.ports.archive import LIVE, ListPart
from service.ports.storage import ClockReading
from service.records.calibration import CalibrationState, Window
from service.records.catalogue import Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import Correction, Operation
from service.records.levels.attitude import NO_AXES, AttitudeRow, Axes, ReleasedCommand, Status, TorqueCommand
from service.records.levels.measurement import Whereabouts
from service.records.operations.alarms import Alarm, Cover
from service.records.operations.work import LinkState
from service.runtime.jobs.archive_maintenance import runnable_methods

_Found = TypeVar("_Found")

#: state of a link that has missed its reports
SILENT = "SILENT"


def link_answers(
    context: ApiContext, states: Iterable[LinkState], known: Iterable["SpacecraftNow"] = ()
) -> list[documents.LinkAnswer]:
    """Return links as they are told; spacecraft that are known already are not looked up."""
    by_id: dict[str, SpacecraftNow | None] = {each.spacecraft.id: each for each in known}
    answers = []
    for state in states:
        spacecraft_id = state.report.spacecraft_id
        if spacecraft_id is not None and spacecraft_id not in by_id:
            by_id[spacecraft_id] = _now_of(context, spacecraft_id)
        answers.append(_link_answer(context, state, by_id.get(spacecraft_id or "")))
    return answers


def _now_of(context: ApiContext, spacecraft_id: str) -> "SpacecraftNow | None":
    """Return a spacecraft as it stands now; None for one that the catalogue lacks."""
    try:
        return SpacecraftNow(context, spacecraft_id)
    except NotFoundError:
        return None


def _link_answer(context: ApiContext, state: LinkState, now: "SpacecraftNow | None") -> documents.LinkAnswer:
    """Return a link as it is told; the age of its newest good row is by the clock of its epoch."""
    report, now_us = state.report, context.clock.system_us()
    present_us = None if now is None else now.clock.now_us
    rows_missing = {} if now is None else {source.id: source.rows_missing for source in now.at.sources}
    good_us = now_us if present_us is None else present_us
    return documents.LinkAnswer.of(
        report,
        state=SILENT if state.is_silent(now_us) else report.state,
        reported_state=report.state,
        enabled=state.enabled,
        reported_at=state.reported_at_us,
        age_s=_age_s(now_us, state.reported_at_us),
        period_s=state.period_s,
        last_good_age_s=None if report.last_good_us is None else _age_s(good_us, report.last_good_us),
        reset_pending=state.resets > report.reset_seen,
        rows_missing=rows_missing.get(report.source or ""),
    )


def _age_s(now_us: int, then_us: int) -> float:
    """Return the time since an instant; none where clocks disagree."""
    return max(now_us - then_us, 0) / US_PER_S


#: the reason of an answer that outlived its row
EXPIRED = "expired"
#: the reason of an answer while the chain is brought back after a restart
CATCH_UP = "catch_up"


class SpacecraftNow:
    """A spacecraft as it stands now: one statement asks where it stands, and only what has moved is read.

    The process that runs its chain has rows, commands and their count from the chain; another one reads them after each
    row.

    Parameters
    ----------
    context : ApiContext
        Archive, clock, supervisor, and what was read before.
    spacecraft_id : str
        NotFoundError ``spacecraft.unknown`` where it does not exist.
    """

    def __init__(self, context: ApiContext, spacecraft_id: str) -> None:
        self._context, self._id, self._storage = context, spacecraft_id, context.storage
        self.at: Whereabouts = context.storage.catalogue.whereabouts(spacecraft_id)
        head, self._kept_from_us = self.at.head, self.at.kept_from_us
        self._newest = context.supervisor.newest_results(spacecraft_id, head)
        self._results = (head.consumed_number, head.result_sequence, self._kept_from_us)

    @property
    def spacecraft(self) -> Spacecraft:
        """Entry of the catalogue."""
        return self._part("spacecraft", self.at.digest, lambda: self._storage.catalogue.spacecraft(self._id))

    @property
    def clock(self) -> ClockReading:
        """Reading of its clock."""
        return self._context.clock.reading(self.spacecraft, self.at.head.newest_epoch_us)

    @property
    def alignment_id(self) -> int | None:
        """Alignment that holds; None before the first, and where it cannot be read."""
        return self._alignment[0]

    @property
    def calibration_id(self) -> int | None:
        """Newest calibration in force; None without, and where it cannot be read."""
        read = self._storage.results.calibrations
        active = self._part(
            "calibrations",
            self.at.calibration_id,
            lambda: _readable(lambda: read(self._id, CalibrationState.ACTIVE)),
        )
        return active[0].id if active else None

    @property
    def links(self) -> tuple[LinkState, ...]:
        """Links of front ends."""
        return self._part("links", self.at.links, lambda: self._storage.links.links(self._id))

    @property
    def pending(self) -> int:
        """Rows that wait for a result; none where the chain has consumed all."""
        head = self.at.head
        if head.consumed_number == head.newest_number:
            return 0
        place = head, self._alignment, self._kept_from_us
        return self._part("pending", place, self._count_pending)

    def _count_pending(self) -> int:
        """Return how many rows lack a result at the head that is told, or one where they got it meanwhile."""
        count = self._storage.results.pending(self._id, self._alignment[1])
        return count or int(self._storage.archive.head(self._id).consumed_number > self.at.head.consumed_number)

    def row(self, method: Method) -> AttitudeRow | None:
        """Return the newest live row of a method as it holds now; None before the first."""
        row = self._stored_row(method)
        if row is None:
            return None
        if self._context.supervisor.is_catching_up(self._id):
            row = _not_present(row, row.status, CATCH_UP)
        is_data, now_us = self.clock
        limit_us = self._context.limits.expired_after_s * US_PER_S
        is_expired = not is_data and now_us is not None and now_us - row.epoch_us > limit_us
        return _not_present(row, Status.EXPIRED, EXPIRED) if is_expired else row

    def command(self) -> TorqueCommand | None:
        """Return the newest command as it is stored; asked for after the row it is as new as that or newer."""
        if self._newest is not None:
            return self._newest.command
        return self._part("command", self._results, lambda: self._storage.results.newest_command(self._id, LIVE))

    def advice(self) -> tuple[str, ...]:
        """Return the advice of the newest row of the robust method."""
        if self._newest is not None and Method.ROBUST not in self._alignment[1]:
            # it gives rows without anything yet
            return ()
        row = self._stored_row(Method.ROBUST)
        return () if row is None else row.advice

    def rate(self, row: AttitudeRow) -> Axes | None:
        """Return the rate of the angles up to the newest row, deg/s."""
        start_us = self._unmoved_since_us(row.epoch_us)
        place = (row.method, row.epoch_us, row.number, start_us)
        return self._part("rate", place, lambda: recent_rate(self._rows_up_to(row, start_us)))

    def _part(self, name: str, numbers: object, read: Callable[[], _Found]) -> _Found:
        return self._context.memory.part(self._id, name, numbers, read)

    @property
    def _alignment(self) -> tuple[int | None, tuple[Method, ...]]:
        """Newest alignment, and the methods that give every row since a result."""

        def newest() -> tuple[int | None, tuple[Method, ...]]:
            alignments = _readable(lambda: self._storage.results.alignments(self._id))
            return (alignments[0].id if alignments else None), runnable_methods(alignments)

        return self._part("alignment", self.at.alignment_id, newest)

    def _tail(self, method: Method) -> tuple[AttitudeRow, ...]:
        """Return the newest rows of a method that the chain of this process has made."""
        return () if self._newest is None else self._newest.rows.get(method, ())

    def _stored_row(self, method: Method) -> AttitudeRow | None:
        tail = self._tail(method)
        oldest_us = max(self.at.head.consumed_epoch_us or 0, self._kept_from_us or 0)
        if tail and tail[-1].epoch_us >= oldest_us:
            return tail[-1]
        read = self._storage.results.newest_attitude
        return self._part(f"row of {method}", self._results, lambda: read(self._id, LIVE, method))

    def _rows_up_to(self, row: AttitudeRow, start_us: int) -> tuple[AttitudeRow, ...]:
        """Return the rows from an epoch to the newest row, in order, at most so many as a rate is taken from."""
        name, read = f"rows of {row.method}", self._storage.results.attitude_rows
        tail = self._tail(row.method)
        before = self._context.memory.known(self._id, name)
        rows: tuple[AttitudeRow, ...] = () if before is None or before[0] > start_us else before[1]
        last = (rows[-1].epoch_us, rows[-1].number) if rows else None
        if last in [(each.epoch_us, each.number) for each in tail]:
            rows = (*rows, *(each for each in tail if (each.epoch_us, each.number) > last))
        else:
            window = Window(start_us, row.epoch_us + 1)
            newest_first = ListPart(window, _RATE_ROWS, newest_first=True)
            rows = _readable(lambda: tuple(read(self._id, LIVE, row.method, newest_first)))[::-1]
        rows = tuple(each for each in rows[-_RATE_ROWS:] if each.epoch_us >= start_us)
        self._context.memory.put(self._id, name, start_us, rows)
        return rows

    def _unmoved_since_us(self, until_us: int) -> int:
        """Return from where on the newest rows tell a rate: the slope of a commanded motion goes on no more."""
        start_us = until_us - round(RATE_WINDOW_S * US_PER_S)

        def commanded() -> tuple[Correction | ReleasedCommand, ...]:
            later = ListPart(Window(start_us, _EVER_US), _MOTIONS, newest_first=True)
            read, kinds = self._storage.archive.inputs, ("correction", "released_command")
            contents = (entry.content for kind in kinds for entry in read(self._id, kind, later))
            return tuple(each for each in contents if isinstance(each, Correction | ReleasedCommand))

        # applied commands are inputs too: the chain, which tells them apart, spares a look after each
        chain = None if self._newest is None else self._newest.motion_number
        motions = self._part("motions", chain or self.at.input_number, commanded)
        ends_us = [each.stop_us for each in motions if _start_of(each) <= until_us]
        return min(max([start_us, *ends_us]), until_us)


def _start_of(motion: Correction | ReleasedCommand) -> int:
    return motion.start_us if isinstance(motion, Correction) else motion.released_us


def newest_command(now: SpacecraftNow, row: AttitudeRow | None, *, is_withheld: bool) -> TorqueCommand | None:
    """Return the newest command as it holds now, given the newest row of the method that drives control.

    A row from which nothing was computed stores no command, yet it ends the one before, and so does a trip: the answer
    is then the zero command that follows from that row, with its reasons. None before the first command.
    """
    command = now.command()
    if command is None or row is None:
        return command
    is_ended = command.attitude_epoch_us < row.epoch_us and bool(row.inhibitions)
    is_present = {EXPIRED, CATCH_UP}.isdisjoint(row.inhibitions)
    if is_present and not is_ended and not (is_withheld and command.is_permitted):
        return command
    return ended_command(row, now.spacecraft, command.command_period_s, is_withheld=is_withheld)


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


def present_of(context: ApiContext, now: SpacecraftNow, view: ControlView | None = None) -> Present:
    """Return the present; a view that an order has just given stands for the interlock."""
    spacecraft = now.spacecraft
    row = now.row(spacecraft.control.method)
    if view is None:
        try:
            view = context.release_service.control(spacecraft.id)
        except StorageError:
            # estimation can be read while nothing can be stored
            view = None
    command = newest_command(now, row, is_withheld=view is not None and view.is_withheld)
    failing = context.supervisor.failures.lasting(spacecraft.id)
    failure = failing[0].error if failing else None
    now_us = now.clock.now_us
    age_s = None if row is None or now_us is None else _age_s(now_us, row.epoch_us)
    verdict = control_verdict(view, row if command is None else command, failure, age_s)
    rate = None if row is None else now.rate(row)
    return Present(row, command, verdict, situation_of(row, verdict, context.interlock.validity_limit_deg, rate))


#: rows that a rate is taken from; the newest half hour of them where they come each ten seconds
_RATE_ROWS = 180
#: commanded motions that are looked at, of each kind
_MOTIONS = 100
_EVER_US = 1 << 62


def status_of(context: ApiContext, spacecraft_id: str) -> documents.StatusAnswer:
    """Return the present state; NotFoundError ``spacecraft.unknown``."""
    # with nothing pending, the newest attitude is that of the newest measurement told, or of a later one
    now = SpacecraftNow(context, spacecraft_id)
    present, pending = present_of(context, now), now.pending
    row, verdict, advice = present.row, present.verdict, now.advice()
    is_data, now_us = now.clock
    return documents.StatusAnswer.model_validate(
        {
            "newest_measurement": now.at.head.newest_epoch_us,
            "newest_attitude": None if row is None else row.epoch_us,
            "pending": pending,
            "aligned": now.alignment_id is not None,
            "realignment_advised": "realign" in advice,
            "advice": [{"code": code, "text": ADVICE[code]} for code in advice if code in ADVICE],
            "methods_disagree": context.supervisor.is_disagreeing(spacecraft_id),
            "clock": "data" if is_data else "system",
            "now": now_us,
            "links": _links_of_sources(context, now),
            "control": present.control,
            "interlock": {"state": verdict.state, "reasons": [reason.code for reason in verdict.reasons]},
            "method": now.spacecraft.control.method,
            "calibration_id": now.calibration_id,
            "alignment_id": now.alignment_id,
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


def _links_of_sources(context: ApiContext, now: SpacecraftNow) -> list[dict[str, Any]]:
    """Return every source with the links that carry it, then links that have brought nothing yet."""
    reported = link_answers(context, now.links, [now])
    found = []
    for source in now.at.sources:
        seen = {
            "source": source.id,
            "role": source.role,
            "newest_epoch": source.newest_epoch_us,
            "rows": source.rows,
            "rows_missing": source.rows_missing,
        }
        carrying: list[documents.LinkAnswer | None] = [link for link in reported if link.source == source.id]
        found += [{**seen, **_report_members(link)} for link in carrying or [None]]
    known = {entry["source"] for entry in found}
    unseen = {"role": None, "newest_epoch": None, "rows": None, "rows_missing": None}
    found += [
        {"source": link.source, **unseen, **_report_members(link)} for link in reported if link.source not in known
    ]
    return found


def _report_members(link: documents.LinkAnswer | None) -> dict[str, Any]:
    """Return the report of a link; nulls where there is none."""
    names = ("id", "kind", "state", "enabled", "age_s", "last_good_age_s")
    warnings = [] if link is None else link.warnings
    return {**{name: getattr(link, name, None) for name in names}, "warnings": warnings}


_HOUR_US = 3600 * US_PER_S
_DAY_US = 24 * _HOUR_US
#: keys that end within this are told, us
_KEYS_US = 30 * _DAY_US
#: newest notes that are told
_NEWEST_NOTES = ListPart(Window(-_EVER_US, _EVER_US), 20, newest_first=True)
_OPERATIONS = 200


def handover_of(context: ApiContext, spacecraft_id: str) -> documents.HandoverAnswer:
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
    notes = context.storage.notes.notes(_NEWEST_NOTES, spacecraft_id)
    return documents.HandoverAnswer.model_validate(
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
            "notes": [documents.NoteAnswer.of(note) for note in notes],
            "notices": _notices(context),
        }
    )


def _alarm_answers(context: ApiContext, alarms: tuple[Alarm, ...], cover: Cover) -> list[documents.AlarmAnswer]:
    """Return the alarms under a cover that no other explains, worst first, then oldest first."""
    causes = {alarm.key for alarm in alarms}
    chosen = [one for one in alarms if one.cover is cover and one.cause not in causes]
    return [alarm_answer(context, alarm, alarms) for alarm in sorted(chosen, key=_worst_first)]


def alarm_answer(context: ApiContext, alarm: Alarm, alarms: tuple[Alarm, ...]) -> documents.AlarmAnswer:
    """Return an alarm with its newest value and with those among open alarms that follow from it."""
    following = sorted((one for one in alarms if one.cause == alarm.key), key=_worst_first)
    children = [documents.AlarmChildAnswer.of(one, context.alarms.present_value(one)) for one in following]
    return documents.AlarmAnswer.of(alarm, context.alarms.present_value(alarm), children=children)


def _worst_first(alarm: Alarm) -> tuple[int, int]:
    """Return the order of alarms: worst first, then oldest first."""
    return -alarm.severity, alarm.raised_at_us


def _foundations(context: ApiContext, spacecraft_id: str, now_us: int) -> dict[str, Any]:
    """Return age and validity of what the estimate rests on."""
    results, catalogue = context.storage.results, context.storage.catalogue
    calibrations = []
    for one in results.calibrations(spacecraft_id, CalibrationState.ACTIVE):
        age = {"created_at": one.created_at_us, "age_days": (now_us - one.request.data_until_us) / _DAY_US}
        calibrations.append(documents.HandoverCalibrationAnswer.of(one.request, id=one.id, **age))
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


def _ending_keys(context: ApiContext) -> list[documents.HandoverKeyAnswer]:
    """Return the keys in force that end soon, the first to end first."""
    now_us = context.clock.system_us()
    ending = []
    for stored in context.storage.keys.all():
        key = stored.key
        if key.expires_at_us is not None and key.is_valid(now_us) and key.expires_at_us - now_us <= _KEYS_US:
            days_left = (key.expires_at_us - now_us) / _DAY_US
            ending.append(documents.HandoverKeyAnswer.of(key, role=key.role.value, days_left=days_left))
    return sorted(ending, key=lambda one: one.days_left)


def _link_members(context: ApiContext, spacecraft_id: str) -> list[Any]:
    now_us = context.clock.system_us()
    states = context.storage.links.links(spacecraft_id)
    chosen = [state for state in states if state.is_down(now_us) or not state.enabled or state.report.warnings]
    return list(link_answers(context, chosen))


def _sources(context: ApiContext, spacecraft_id: str) -> list[documents.HandoverSourceAnswer]:
    return [
        documents.HandoverSourceAnswer.of(one, source=one.id) for one in context.storage.archive.sources(spacecraft_id)
    ]


def _operations(context: ApiContext, spacecraft_id: str, now_us: int) -> list[OperationAnswer]:
    """Return the operations in force or near."""
    window = Window(now_us, now_us + _DAY_US)
    entries = context.storage.archive.inputs(spacecraft_id, "operation", ListPart(window, _OPERATIONS))
    return [OperationAnswer.of(entry.content) for entry in entries if isinstance(entry.content, Operation)]


def _notices(context: ApiContext) -> list[documents.HandoverNoticesAnswer]:
    return [
        documents.HandoverNoticesAnswer.of(channel.counts, channel=channel.name, waiting=channel.waiting)
        for channel in context.alarms.channels
    ]
