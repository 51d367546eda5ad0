"""Calibrations, alignments, harmonics, and the carriers that a rule recommends."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Path, Query, Response

from service.api.access.auth import MAY_OPERATE, CurrentPrincipal, Permission, Principal
from service.api.context import ApiContext, Context, SpacecraftId
from service.api.problems.problems import RequestProblemError
from service.api.protocol.paging import EVERYTHING, Page, window_of
from service.api.protocol.requests import Body, OptionalBody
from service.api.schemas import calibrations as documents
from service.api.schemas.access import JobAnswer
from service.api.schemas.base import LiveMethod
from service.api.schemas.calibrations import ReplayAnswer, ReplayDocument, ReplayPage, ReplayStartedAnswer
from service.api.schemas.carrier_selection import CarrierSelectionAnswer, Turns
from service.pipeline.planning.planning import WHEEL_PERIOD_S, Rule, stated_wheels
from service.records.calibration import Calibration
from service.records.catalogue import Method
from service.records.operations.work import JobKind
from service.runtime.jobs.analysis import MIN_COUNT, recommend_carriers, window_harmonics

alignments_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/alignments", tags=["calibration"])


@alignments_router.post("", status_code=HTTPStatus.CREATED, dependencies=[MAY_OPERATE])
def align(
    spacecraft_id: SpacecraftId,
    body: Body[documents.AlignmentDocument],
    context: Context,
    principal: CurrentPrincipal,
    response: Response,
) -> documents.AlignmentMadeAnswer:
    """Set angles and reference powers of every method; angles by hand need an approver's key.

    Rows that an earlier alignment computed stay, also at the same epoch: `rows_kept`.
    """
    if body.is_manual:
        _require_approver(principal)
    alignment = context.aligner.align(spacecraft_id, body.to_request(principal.name))
    recomputed, kept = context.storage.results.rows_after(spacecraft_id, alignment)
    context.supervisor.notify(spacecraft_id)
    response.headers["Location"] = f"/api/v1/spacecraft/{spacecraft_id}/alignments/{alignment.id}"
    return documents.AlignmentMadeAnswer.of(alignment, rows_recomputed=recomputed, rows_kept=kept)


@alignments_router.get("")
def list_alignments(spacecraft_id: SpacecraftId, context: Context) -> documents.AlignmentList:
    """List alignments, newest first; the newest holds."""
    found = context.storage.results.alignments(spacecraft_id)
    return documents.AlignmentList(rows=[documents.AlignmentAnswer.of(alignment) for alignment in found])


@alignments_router.get("/{alignment_id}")
def get_alignment(
    spacecraft_id: SpacecraftId, alignment_id: Annotated[int, Path(ge=1, le=2**31 - 1)], context: Context
) -> documents.AlignmentAnswer:
    """Return one alignment."""
    return documents.AlignmentAnswer.of(context.storage.results.alignment(spacecraft_id, alignment_id))


def _require_approver(principal: Principal) -> None:
    """Refuse angles by hand from a key that may not approve."""
    if not principal.may(Permission.APPROVE):
        detail = f"angles by hand need an approver's key, this one has the role {principal.role}"
        raise RequestProblemError(HTTPStatus.FORBIDDEN, "key.forbidden", detail)


calibrations_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/calibrations", tags=["calibration"])
CalibrationId = Annotated[int, Path(ge=1, le=2**31 - 1)]


@calibrations_router.post("", status_code=HTTPStatus.ACCEPTED, dependencies=[MAY_OPERATE])
def start_calibration(
    spacecraft_id: SpacecraftId,
    body: Body[documents.CalibrationDocument],
    context: Context,
    principal: CurrentPrincipal,
    response: Response,
) -> documents.CalibrationStartedAnswer:
    """Start a calibration; its job shows when the draft is complete."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    draft, job = context.calibrator.start(spacecraft_id, body.to_record(), principal.name)
    response.headers["Location"] = f"/api/v1/spacecraft/{spacecraft_id}/calibrations/{draft.id}"
    return documents.CalibrationStartedAnswer(id=draft.id, job=job.id)


@calibrations_router.get("")
def list_calibrations(spacecraft_id: SpacecraftId, context: Context) -> documents.CalibrationList:
    """List calibrations, newest first."""
    found = context.storage.results.calibrations(spacecraft_id)
    return documents.CalibrationList(rows=[_answer(context, spacecraft_id, calibration) for calibration in found])


@calibrations_router.get("/{calibration_id}")
def get_calibration(
    spacecraft_id: SpacecraftId, calibration_id: CalibrationId, context: Context
) -> documents.CalibrationAnswer:
    """Return one calibration."""
    return _answer(context, spacecraft_id, context.storage.results.calibration(spacecraft_id, calibration_id))


@calibrations_router.delete("/{calibration_id}", status_code=HTTPStatus.NO_CONTENT, dependencies=[MAY_OPERATE])
def delete_calibration(spacecraft_id: SpacecraftId, calibration_id: CalibrationId, context: Context) -> None:
    """Delete a draft or a failed calibration; its number is not given again."""
    context.storage.results.delete_calibration(spacecraft_id, calibration_id)


@calibrations_router.post("/{calibration_id}:activate", dependencies=[MAY_OPERATE])
def activate_calibration(
    spacecraft_id: SpacecraftId,
    calibration_id: CalibrationId,
    body: OptionalBody[documents.ActivationDocument],
    context: Context,
) -> documents.CalibrationAnswer:
    """Make a calibration the active one of its method; the one before it is superseded, history stays.

    One whose turns are inconsistent is refused without `override_reason`.
    """
    calibration = context.calibrator.activate(spacecraft_id, calibration_id, body.override_reason)
    context.supervisor.notify(spacecraft_id)
    return documents.CalibrationAnswer.of(calibration)


def _answer(context: ApiContext, spacecraft_id: str, calibration: Calibration) -> documents.CalibrationAnswer:
    unfinished_job_of = context.storage.results.unfinished_job_of
    job = unfinished_job_of(spacecraft_id, JobKind.CALIBRATION, str(calibration.id))
    return documents.CalibrationAnswer.of(calibration, job=job)


carrier_selection_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/carrier-selection", tags=["calibration"])


@carrier_selection_router.get("")
def get_carrier_selection(
    spacecraft_id: SpacecraftId,
    context: Context,
    count: Annotated[
        int | None, Query(ge=MIN_COUNT, le=1000, description="Carriers wanted; default 16, or all when there are fewer")
    ] = None,
    rule: Annotated[Rule, Query(description="The publication's rule, or the weighted A-optimal choice")] = Rule.PAPER,
    turns: Annotated[Turns, Query(description="Add the recommended calibration turns")] = Turns.NONE,
    wheels_n_m_s: Annotated[
        float | None,
        Query(ge=-1e4, le=1e4, description="Momentum along pitch; default: onboard.momentum.pitch_bias_n_m_s"),
    ] = None,
    wheel_sigma_n_m_s: Annotated[
        float | None, Query(gt=0, le=10, description="Noise of a record; default: that of onboard.momentum, else 0.01")
    ] = None,
    wheel_period_s: Annotated[float, Query(ge=60, le=86_400, description="Time between two records")] = WHEEL_PERIOD_S,
) -> CarrierSelectionAnswer:
    """Recommend carriers by the active calibration by geometry, else by the newest with figures; nothing is stored."""
    spacecraft = context.storage.catalogue.spacecraft(spacecraft_id)
    wheels = stated_wheels(spacecraft.onboard.momentum, wheels_n_m_s, wheel_sigma_n_m_s, wheel_period_s)
    found = recommend_carriers(context.storage, spacecraft_id, count, rule, context.calibration)
    return CarrierSelectionAnswer.of(found.with_motion(spacecraft, wheels), turns)


harmonics_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/harmonics", tags=["calibration"])


@harmonics_router.get("")
def get_harmonics(
    spacecraft_id: SpacecraftId,
    context: Context,
    start: Annotated[str, Query(max_length=64, description="RFC 3339, inclusive")],
    stop: Annotated[str, Query(max_length=64, description="RFC 3339, exclusive")],
    carrier: Annotated[str | None, Query(max_length=64, description="Default: all carriers of the newest plan")] = None,
    method: LiveMethod = Method.PAPER,
) -> documents.WindowHarmonicsAnswer:
    """Fit the daily change of a window; nothing is stored.

    `paper`: one harmonic, 3 sigma. `robust`: trimmed start and Tukey's estimate of the dish law where the ephemeris has
    a track over the window, else of two harmonics.
    """
    window = window_of(start, stop, EVERYTHING)
    context.storage.catalogue.spacecraft(spacecraft_id)
    harmonics = window_harmonics(context.storage, spacecraft_id, window, carrier, method, context.calibration)
    return documents.WindowHarmonicsAnswer.of(window, method, harmonics)


jobs_router = APIRouter(prefix="/jobs", tags=["jobs"])


@jobs_router.get("/{job_id}")
def get_job(job_id: Annotated[str, Path(max_length=64)], context: Context) -> JobAnswer:
    """Return how far a job is."""
    return JobAnswer.of(context.storage.results.job(job_id))


ReplayId = Annotated[int, Path(ge=1, le=2**31 - 1)]

replays_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/replays", tags=["replay"])


@replays_router.post("", status_code=HTTPStatus.ACCEPTED, dependencies=[MAY_OPERATE])
def start_replay(
    spacecraft_id: SpacecraftId, body: Body[ReplayDocument], context: Context, response: Response
) -> ReplayStartedAnswer:
    """Start a replay; its rows are read by ?version= on history and export."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    replay, job = context.replayer.start(spacecraft_id, body.to_replay())
    response.headers["Location"] = f"/api/v1/spacecraft/{spacecraft_id}/replays/{replay.id}"
    return ReplayStartedAnswer(id=replay.id, job=job.id, version=replay.version)


@replays_router.get("")
def list_replays(spacecraft_id: SpacecraftId, page: Page, context: Context) -> ReplayPage:
    """List the replays whose span overlaps an interval, in order of their numbers."""
    after_id = None if page.after is None else page.after[1]
    read = context.storage.results.replays
    found = read(spacecraft_id, page.window, page.most, after_id, newest_first=page.newest_first)
    return page.answer(ReplayPage, found, lambda each: (0, each.replay.id), ReplayAnswer.of)


@replays_router.get("/{replay_id}")
def get_replay(spacecraft_id: SpacecraftId, replay_id: ReplayId, context: Context) -> ReplayAnswer:
    """Return one replay."""
    return ReplayAnswer.of(context.storage.results.replay(spacecraft_id, f"replay-{replay_id}"))


@replays_router.delete("/{replay_id}", status_code=HTTPStatus.NO_CONTENT, dependencies=[MAY_OPERATE])
def delete_replay(spacecraft_id: SpacecraftId, replay_id: ReplayId, context: Context) -> None:
    """Delete a replay and its rows, which nobody reads from now on; one that runs or waits ends."""
    context.storage.results.delete_replay(spacecraft_id, f"replay-{replay_id}")
