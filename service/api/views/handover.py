"""Hand-over of a shift, put together from what is known elsewhere; nothing is stored for it."""

from typing import Any

from service.api.context.dependencies import ApiContext
from service.api.schemas.alarms import AlarmAnswer
from service.api.schemas.handover import (
    HandoverAnswer,
    HandoverCalibrationAnswer,
    HandoverKeyAnswer,
    HandoverNoticesAnswer,
    HandoverSourceAnswer,
)
from service.api.schemas.notes import NoteAnswer
from service.api.schemas.operations import OperationAnswer
from service.api.views.links import link_answers
from service.api.views.status import status_of
from service.errors import NotFoundError
from service.records.calibration import CalibrationState, Window
from service.records.epoch import US_PER_S
from service.records.inputs import Operation
from service.records.operations.alarm import Alarm, Cover

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
            "alarms": _reported(context, alarms, Cover.NONE),
            "shelved": _reported(context, alarms, Cover.SHELVED),
            "suppressed": _reported(context, alarms, Cover.SUPPRESSED),
            "control": control,
            "status": status,
            **_foundations(context, spacecraft_id, now_us),
            "keys": _ending_keys(context),
            "links": _links(context, spacecraft_id),
            "sources": _sources(context, spacecraft_id),
            "operations": _operations(context, spacecraft_id, now_us),
            "notes": [NoteAnswer.of(note) for note in context.storage.notes.newest(_NOTES, spacecraft_id)],
            "notices": _notices(context),
        }
    )


def _reported(context: ApiContext, alarms: tuple[Alarm, ...], cover: Cover) -> list[AlarmAnswer]:
    """Return the alarms under a cover, worst first, then oldest first."""
    chosen = sorted((one for one in alarms if one.cover is cover), key=lambda one: (-one.severity, one.raised_at_us))
    return [AlarmAnswer.of(alarm, context.alarms.present_value(alarm)) for alarm in chosen]


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


def _links(context: ApiContext, spacecraft_id: str) -> list[Any]:
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
