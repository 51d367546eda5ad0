"""Links: reports of front ends, and what operators make of them."""

import re
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query

from service.api.access.auth import MAY_OPERATE, MAY_SEND
from service.api.context.dependencies import SPACECRAFT_ID_PATTERN, Context
from service.api.protocol.bodies import accepts, body_of
from service.api.schemas.base import NAME_PATTERN
from service.api.schemas.links import LinkAnswer, LinkListAnswer, LinkReportsDocument, LinkWishAnswer, LinkWishesAnswer
from service.api.views.links import link_answers
from service.errors import NotFoundError

router = APIRouter(prefix="/links", tags=["links"])
_NAME = re.compile(NAME_PATTERN.strip("^$"), re.ASCII)
SpacecraftParameter = Annotated[
    str | None, Query(pattern=SPACECRAFT_ID_PATTERN, description="Only links of this spacecraft")
]


# `links:report` stands beside `links`, not below it
report_router = APIRouter(tags=["links"])


@report_router.post("/links:report", dependencies=[MAY_SEND], openapi_extra=accepts(LinkReportsDocument))
def report_links(
    body: Annotated[LinkReportsDocument, body_of(LinkReportsDocument)], context: Context
) -> LinkWishesAnswer:
    """Store the reports of a front end and return the requested state of its links."""
    states = context.storage.links.report([each.to_record() for each in body.links], context.clock.system_us())
    requests = [LinkWishAnswer(id=state.report.id, enabled=state.enabled, reset=state.resets) for state in states]
    return LinkWishesAnswer(links=requests)


@router.get("")
def list_links(context: Context, spacecraft_id: SpacecraftParameter = None) -> LinkListAnswer:
    """List the links that have reported."""
    return LinkListAnswer(links=link_answers(context, context.storage.links.links(spacecraft_id)))


async def _link_id(link_id: Annotated[str, Path(description="Id of a link")]) -> str:
    """Return the id of a path; one that cannot exist never reaches the database."""
    if _NAME.fullmatch(link_id) is None:
        raise NotFoundError("link.unknown", f"no link {link_id[:64]!r}")
    return link_id


LinkId = Annotated[str, Depends(_link_id)]


@router.get("/{link_id}")
def get_link(link_id: LinkId, context: Context) -> LinkAnswer:
    """Return one link."""
    return link_answers(context, [context.storage.links.link(link_id)])[0]


@router.post("/{link_id}:enable", dependencies=[MAY_OPERATE])
def enable_link(link_id: LinkId, context: Context) -> LinkAnswer:
    """Let a link work; it hears of it with its next report."""
    state = context.storage.links.set_enabled(link_id, enabled=True)
    return link_answers(context, [state])[0]


@router.post("/{link_id}:disable", dependencies=[MAY_OPERATE])
def disable_link(link_id: LinkId, context: Context) -> LinkAnswer:
    """Let a link rest until it is enabled again, also beyond a restart of either side."""
    state = context.storage.links.set_enabled(link_id, enabled=False)
    return link_answers(context, [state])[0]


@router.post("/{link_id}:reset", dependencies=[MAY_OPERATE])
def reset_link(link_id: LinkId, context: Context) -> LinkAnswer:
    """Ask a link to zero its counters and to begin again."""
    state = context.storage.links.request_reset(link_id)
    return link_answers(context, [state])[0]


@router.delete("/{link_id}", status_code=HTTPStatus.NO_CONTENT, dependencies=[MAY_OPERATE])
def remove_link(link_id: LinkId, context: Context) -> None:
    """Forget a link that is gone for good."""
    context.storage.links.remove(link_id)
