"""State of one spacecraft, put together from what archive, results and clock say; the stream tells the same."""

from typing import Any

from service.api.context.dependencies import ApiContext
from service.api.schemas.control import VerdictAnswer
from service.api.schemas.links import LinkAnswer
from service.api.schemas.status import StatusAnswer
from service.api.views.links import link_answers
from service.api.views.present import present_of
from service.pipeline.estimation.robust.attitude_rows import ADVICE
from service.records.calibration import CalibrationState
from service.runtime.jobs.archive_analysis import newest_advice, runnable_methods


def status_of(context: ApiContext, spacecraft_id: str) -> StatusAnswer:
    """Return the present state; NotFoundError ``spacecraft.unknown``."""
    storage, clock = context.storage, context.clock
    spacecraft = storage.catalogue.spacecraft(spacecraft_id)
    # in this order: with nothing pending, the newest attitude is that of the newest measurement told, or of a later one
    newest_us = storage.archive.head(spacecraft_id).newest_epoch_us
    pending = storage.results.pending(spacecraft_id, runnable_methods(storage, spacecraft_id))
    row, _, verdict = present_of(context, spacecraft)
    alignments = storage.results.alignments(spacecraft_id)
    active = storage.results.calibrations(spacecraft_id, CalibrationState.ACTIVE)
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
            "links": _links(context, spacecraft_id),
            "control": VerdictAnswer.of(verdict),
            "interlock": {"state": verdict.state, "reasons": [reason.code for reason in verdict.reasons]},
            "method": spacecraft.control.method,
            "calibration_id": active[0].id if active else None,
            "alignment_id": alignments[0].id if alignments else None,
        }
    )


def _links(context: ApiContext, spacecraft_id: str) -> list[dict[str, Any]]:
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
        found += [{**seen, **_reported(link)} for link in carrying or [None]]
    known = {entry["source"] for entry in found}
    unseen = {"role": None, "newest_epoch": None, "rows": None, "rows_missing": None}
    found += [{"source": link.source, **unseen, **_reported(link)} for link in reported if link.source not in known]
    return found


def _reported(link: LinkAnswer | None) -> dict[str, Any]:
    """Return the report of a link; nulls where there is none."""
    names = ("id", "kind", "state", "enabled", "age_s", "last_good_age_s")
    warnings = [] if link is None else link.warnings
    return {**{name: getattr(link, name, None) for name in names}, "warnings": warnings}
