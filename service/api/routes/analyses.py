"""Analyses: pure computations on the parameters of a request, in worker processes; nothing is stored."""

import asyncio
import math
from collections.abc import Callable
from http import HTTPStatus
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Depends

from service.api.context.dependencies import Context
from service.api.problems.problems import RequestProblemError
from service.api.protocol.bodies import accepts, body_of
from service.api.schemas.analyses import (
    CaptureAnswer,
    CaptureDocument,
    LimitCycleAnswer,
    LimitCycleDocument,
    ScheduleAnswer,
    ScheduleDocument,
)
from service.core.flexible.capture.capture_analysis import analyse_capture
from service.core.flexible.limit_cycle import analyse_limit_cycle
from service.core.flexible.schedule.schedule_check import analyse_schedule
from service.runtime.jobs.workers import Workers


async def _room(context: Context) -> None:
    """Refuse an analysis that could not be queued, before its body is decoded."""
    context.workers.check_room()


router = APIRouter(prefix="/analyses", tags=["analyses"], dependencies=[Depends(_room)])
Found = TypeVar("Found")


@router.post("/limit-cycle", openapi_extra=accepts(LimitCycleDocument))
async def limit_cycle(
    body: Annotated[LimitCycleDocument, body_of(LimitCycleDocument)], context: Context
) -> LimitCycleAnswer:
    """Return limit cycles, multipliers and the succession map of a relay of pulses on a wheel."""
    return LimitCycleAnswer.of(await _computed(context.workers, analyse_limit_cycle, body.model_dump()))


@router.post("/capture-boundary", openapi_extra=accepts(CaptureDocument))
async def capture_boundary(
    body: Annotated[CaptureDocument, body_of(CaptureDocument)], context: Context
) -> CaptureAnswer:
    """Return the swing above which a flexible mode captures the regulator, and the verdict on one swing."""
    given = body.model_dump()
    given["pulse_s"] = math.inf if body.pulse_s is None else body.pulse_s
    return CaptureAnswer.of(await _computed(context.workers, analyse_capture, given))


@router.post("/torque-schedule", openapi_extra=accepts(ScheduleDocument))
async def torque_schedule(
    body: Annotated[ScheduleDocument, body_of(ScheduleDocument)], context: Context
) -> ScheduleAnswer:
    """Return whether a torque schedule may be sent without exciting flexible modes, and what would be better."""
    given = body.model_dump(exclude={"pulses", "modes", "carried"})
    given["pulse_s"] = math.inf if body.pulse_s is None else body.pulse_s
    limit = body.momentum_limit_n_m_s
    given["momentum_limit_n_m_s"] = math.inf if limit is None else limit
    given["pulses"] = tuple((each.start_s, each.duration_s, each.torque_n_m) for each in body.pulses)
    given["modes"] = tuple((each.omega_rad_s, each.damping_ratio, each.coupling) for each in body.modes)
    if body.carried is not None:
        given["carried_rad"] = tuple(complex(each.re, each.im) for each in body.carried)
    return ScheduleAnswer.of(await _computed(context.workers, analyse_schedule, given))


async def _computed(workers: Workers, work: Callable[..., Found], given: dict[str, Any]) -> Found:
    """Return the result of a worker process; an unphysical parameter becomes a 422 that names it and the reason."""
    try:
        return await asyncio.wrap_future(workers.analyse(work, **given))
    except (ValueError, ArithmeticError) as error:
        raise RequestProblemError(
            HTTPStatus.UNPROCESSABLE_ENTITY, "analysis.not_physical", str(error)[:1000]
        ) from error
