"""State of one spacecraft, put together from what archive, results and clock say; the stream tells the same."""

from typing import Any

from service.api.deps import ApiContext
from service.api.links import links_told
from service.api.schemas.links import LinkAnswer
from service.api.schemas.status import StatusAnswer
from service.api.validity import newest_attitude, newest_command
from service.errors import StorageError
from service.records.attitude import AttitudeRow
from service.records.calibration import CalibrationState
from service.records.catalogue import Release, Spacecraft
from service.records.command import TorqueCommand
from service.runtime.inspection import realignment_advised, runnable_methods

#: reason where the release cannot be read
UNKNOWN = "release_unreadable"


def status_of(context: ApiContext, spacecraft_id: str) -> StatusAnswer:
    """Return the present state; NotFoundError ``spacecraft.unknown``."""
    storage, clock = context.storage, context.clock
    spacecraft = storage.catalogue.spacecraft(spacecraft_id)
    # in this order: with nothing pending, the newest attitude is that of the newest measurement told, or of a later one
    newest_us = storage.archive.head(spacecraft_id).newest_epoch_us
    pending = storage.results.pending(spacecraft_id, runnable_methods(storage, spacecraft_id))
    row = newest_attitude(context, spacecraft_id, spacecraft.control.method)
    command = newest_command(context, spacecraft, row)
    alignments = storage.results.alignments(spacecraft_id)
    active = storage.results.calibrations(spacecraft_id, CalibrationState.ACTIVE)
    return StatusAnswer.model_validate(
        {
            "newest_measurement": newest_us,
            "newest_attitude": None if row is None else row.epoch_us,
            "pending": pending,
            "aligned": bool(alignments),
            "realignment_advised": realignment_advised(storage, spacecraft_id),
            "methods_disagree": context.supervisor.is_disagreeing(spacecraft_id),
            "clock": "data" if clock.is_data(spacecraft_id) else "system",
            "now": clock.now_us(spacecraft_id),
            "links": _links(context, spacecraft_id),
            "interlock": _interlock(context, spacecraft, row if command is None else command),
            "method": spacecraft.control.method,
            "calibration_id": active[0].id if active else None,
            "alignment_id": alignments[0].id if alignments else None,
        }
    )


def _links(context: ApiContext, spacecraft_id: str) -> list[dict[str, Any]]:
    """Return every source with the links that carry it, then links that have brought nothing yet."""
    told = links_told(context, context.storage.links.links(spacecraft_id))
    found = []
    for source in context.storage.archive.sources(spacecraft_id):
        seen = {
            "source": source.id,
            "role": source.role,
            "newest_epoch": source.newest_epoch_us,
            "rows": source.rows,
            "rows_missing": source.rows_missing,
        }
        carrying: list[LinkAnswer | None] = [link for link in told if link.source == source.id]
        found += [{**seen, **_reported(link)} for link in carrying or [None]]
    known = {entry["source"] for entry in found}
    unseen = {"role": None, "newest_epoch": None, "rows": None, "rows_missing": None}
    found += [{"source": link.source, **unseen, **_reported(link)} for link in told if link.source not in known]
    return found


def _reported(link: LinkAnswer | None) -> dict[str, Any]:
    """Return what a link reports; nulls where none does."""
    names = ("id", "kind", "state", "enabled", "age_s", "last_good_age_s")
    warnings = [] if link is None else link.warnings
    return {**{name: getattr(link, name, None) for name in names}, "warnings": warnings}


def _interlock(
    context: ApiContext, spacecraft: Spacecraft, newest: TorqueCommand | AttitudeRow | None
) -> dict[str, Any]:
    """Return the state of the interlock, and why no torque reaches the spacecraft by itself.

    Released one by one, commands go by the interlock's own state; where computed ones count as applied, by the newest
    of them, unless the interlock has tripped.
    """
    try:
        view = context.desk.control(spacecraft.id)
    except StorageError:
        # estimation can be read while nothing can be stored; what is not known counts as bad
        return {"state": "INHIBITED", "reasons": [UNKNOWN]}
    if spacecraft.control.release is not Release.AUTOMATIC:
        return {"state": view.state, "reasons": list(view.reasons)}
    reasons = ["no_attitude"] if newest is None else list(newest.inhibitions)
    if view.is_withheld:
        return {"state": view.state, "reasons": list(dict.fromkeys((*view.trips, *reasons)))}
    return {"state": "INHIBITED" if reasons else "ENGAGED", "reasons": reasons}
