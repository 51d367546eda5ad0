"""Query parameters for the estimation method and the version of the results."""

from typing import Annotated

from fastapi import Depends, Query

from service.api.context.dependencies import Context, SpacecraftId
from service.errors import ConflictError, InvalidInputError
from service.ports import LIVE, SMOOTHED, Results
from service.records.catalogue import LIVE_METHODS, Method
from service.records.operations.job import JobState, ReplayVersion

MethodParameter = Annotated[Method | None, Query(description="Default: the method that drives control")]
VersionParameter = Annotated[
    str, Query(max_length=64, description="`live`, `smoothed` (live rows of robust_smoothed), or that of a replay")
]


def wanted_method(spacecraft_id: SpacecraftId, context: Context, method: MethodParameter = None) -> Method:
    """Return the method asked for, or the one that drives control of the spacecraft."""
    spacecraft = context.storage.catalogue.spacecraft(spacecraft_id)
    return spacecraft.control.method if method is None else method


def wanted_version(spacecraft_id: SpacecraftId, context: Context, version: VersionParameter = LIVE) -> str:
    """Return the version asked for; NotFoundError ``replay.unknown``, ConflictError ``replay.unfinished``."""
    check_version(context.storage.results, spacecraft_id, version)
    return version


def stored_method(
    method: Annotated[Method, Depends(wanted_method)], version: Annotated[str, Depends(wanted_version)]
) -> Method:
    """Return the method asked for, which the version has."""
    check_method(method, version)
    return method


def check_method(method: Method, version: str) -> None:
    """Raise InvalidInputError ``method.smoothed`` for smoothed rows of the live version, or others of `smoothed`."""
    if version == LIVE and method not in LIVE_METHODS:
        detail = f"{method} exists only in version {SMOOTHED}, and in versions of replays with smooth=true"
        raise InvalidInputError("method.smoothed", detail)
    if version == SMOOTHED and method is not Method.ROBUST_SMOOTHED:
        detail = f"version {SMOOTHED} has rows of method {Method.ROBUST_SMOOTHED} alone"
        raise InvalidInputError("method.smoothed", detail)


def check_version(results: Results, spacecraft_id: str, version: str) -> None:
    """Raise NotFoundError unless a version exists, ConflictError unless every row of it is stored."""
    if version not in (LIVE, SMOOTHED):
        _check_done(results.replay(spacecraft_id, version))


def _check_done(found: ReplayVersion) -> None:
    """Raise ConflictError ``replay.unfinished`` unless every row of a replay is stored."""
    if found.state is JobState.DONE:
        return
    version = found.replay.version
    detail = f"{version} is {found.state} ({found.progress:.0%}); its job is {found.replay.job_id}"
    if found.state is JobState.FAILED:
        detail = f"{version} failed and has no complete rows; delete it and start another one. {found.error or ''}"
    raise ConflictError("replay.unfinished", detail.rstrip())


WantedMethod = Annotated[Method, Depends(wanted_method)]
WantedVersion = Annotated[str, Depends(wanted_version)]
#: of a version
StoredMethod = Annotated[Method, Depends(stored_method)]
