"""Keys: made, listed and revoked by administrators."""

import re
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Request, Response

from service.api.access.auth import MAY_ADMINISTER, CurrentPrincipal
from service.api.access.key_cache import StoredKeys
from service.api.context.dependencies import Context
from service.api.problems.problems import invalid_request
from service.api.protocol.bodies import accepts, body_of
from service.api.schemas.keys import KeyAnswer, KeyDocument, KeyList, NewKeyAnswer
from service.errors import FieldError, NotFoundError
from service.records.operations.access_key import AccessKey, StoredKey, digest_of, new_key

router = APIRouter(prefix="/keys", tags=["access"], dependencies=[MAY_ADMINISTER])
_ID = re.compile(r"[a-z0-9]{1,32}", re.ASCII)


async def stored_keys_of(request: Request) -> StoredKeys:
    """Return the keys that the application knows."""
    keys: StoredKeys = request.app.state.stored_keys
    return keys


Ring = Annotated[StoredKeys, Depends(stored_keys_of)]


@router.post("", status_code=HTTPStatus.CREATED, openapi_extra=accepts(KeyDocument))
def create_key(
    body: Annotated[KeyDocument, body_of(KeyDocument)],
    context: Context,
    principal: CurrentPrincipal,
    ring: Ring,
    response: Response,
) -> NewKeyAnswer:
    """Make a key; only this answer contains its secret."""
    now_us = context.clock.system_us()
    if body.expires_at is not None and body.expires_at <= now_us:
        detail = "the key would have expired already"
        raise invalid_request([FieldError("/expires_at", "key.expires_past", detail)])
    key_id, text = new_key()
    key = AccessKey(
        id=key_id,
        name=body.name,
        role=body.role,
        created_at_us=now_us,
        created_by=principal.name,
        expires_at_us=body.expires_at,
    )
    context.storage.keys.add(StoredKey(key, digest_of(text.encode("ascii"))))
    ring.forget()
    response.headers["Cache-Control"] = "no-store"
    content = {"id": key.id, "key": text, "name": key.name, "role": key.role, "expires_at": key.expires_at_us}
    return NewKeyAnswer.model_validate(content)


@router.get("")
def list_keys(
    context: Context,
    ring: Ring,
    revoked: Annotated[bool, Query(description="List revoked keys too")] = False,  # noqa: FBT002 - a query parameter
) -> KeyList:
    """List keys without their secrets."""
    now_us = context.clock.system_us()
    keys = [each.key for each in context.storage.keys.all() if revoked or each.key.revoked_at_us is None]
    return KeyList(rows=[KeyAnswer.of(key, now_us, ring.last_used_us(key.id, key.last_used_us)) for key in keys])


@router.delete("/{key_id}", status_code=HTTPStatus.NO_CONTENT)
def revoke_key(key_id: Annotated[str, Path(description="Id of a key")], context: Context, ring: Ring) -> None:
    """Revoke a key: at once in this process, within seconds in every other."""
    if _ID.fullmatch(key_id) is None:
        # not told back: somebody may have put a whole key here
        raise NotFoundError("key.unknown", "no key has such an id")
    context.storage.keys.revoke(key_id, context.clock.system_us())
    ring.forget()
