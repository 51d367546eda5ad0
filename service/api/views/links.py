"""Links as operators see them: the newest report, its age, and what is missing of the rows that came over it."""

from collections.abc import Iterable

from service.api.context.dependencies import ApiContext
from service.api.schemas.links import LinkAnswer
from service.errors import NotFoundError
from service.records.epoch import US_PER_S
from service.records.operations.link import LinkReport, LinkState

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
        reported.append(_reported(context, state, missing.get(spacecraft_id or "", {}).get(source or "")))
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


def _reported(context: ApiContext, state: LinkState, rows_missing: int | None) -> LinkAnswer:
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
