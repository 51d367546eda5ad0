"""Query parameters for the estimation method and the version of the results."""

from typing import Annotated

from fastapi import Depends, Query

from service.api.context.dependencies import Context, SpacecraftId
from service.ports import LIVE, Results
from service.records.catalogue import Method

MethodParameter = Annotated[Method | None, Query(description="Default: the method that drives control")]
VersionParameter = Annotated[str, Query(max_length=64, description="`live`, or the version of a replay")]


def wanted_method(spacecraft_id: SpacecraftId, context: Context, method: MethodParameter = None) -> Method:
    """Return the method asked for, or the one that drives control of the spacecraft."""
    spacecraft = context.storage.catalogue.spacecraft(spacecraft_id)
    return spacecraft.control.method if method is None else method


def wanted_version(spacecraft_id: SpacecraftId, context: Context, version: VersionParameter = LIVE) -> str:
    """Return the version asked for; NotFoundError ``replay.unknown``."""
    check_version(context.storage.results, spacecraft_id, version)
    return version


def check_version(results: Results, spacecraft_id: str, version: str) -> None:
    """Raise NotFoundError unless a version exists."""
    if version != LIVE:
        results.replay(spacecraft_id, version)


WantedMethod = Annotated[Method, Depends(wanted_method)]
WantedVersion = Annotated[str, Depends(wanted_version)]
