"""Answers that take long end when their key does."""

from types import SimpleNamespace

import pytest

from service.api.access.access_middleware import AccessLayer
from service.api.access.key_cache import StoredKeys
from service.api.access.principals import Principal
from service.records.operations.access_key import AccessKey, Role, StoredKey, digest_of

pytestmark = pytest.mark.anyio


class Keys:
    """An archive of one key."""

    def __init__(self) -> None:
        self.key = AccessKey(id="abc", name="vera", role=Role.VIEWER, created_at_us=0, created_by="x", expires_at_us=50)

    def all(self):
        return (StoredKey(self.key, digest_of(b"soo_abc_secret")),)


class Stream:
    """An application that sends pieces, and does something between them."""

    def __init__(self, ring, between) -> None:
        self.ring, self.between, self.is_ended_early = ring, between, True

    async def __call__(self, scope, receive, send):
        scope["state"]["principal"] = await self.ring.principal("soo_abc_secret")
        await send({"type": "http.response.start", "status": 200, "headers": []})
        for k in range(6):
            if k == 3:
                self.between()
            await send({"type": "http.response.body", "body": b"%d" % k, "more_body": True})
        self.is_ended_early = False
        await send({"type": "http.response.body", "body": b"", "more_body": False})


async def sent(stream):
    """Return the body that a client gets, and whether it was ended properly."""
    chunks = []

    async def send(message):
        chunks.append(message)

    app = SimpleNamespace(state=SimpleNamespace(key_ring=stream.ring))
    scope = {"type": "http", "method": "GET", "path": "/api/v1/x", "query_string": b"", "app": app}
    await AccessLayer(stream)(scope, None, send)
    assert not chunks[-1]["more_body"]
    return b"".join(chunk.get("body", b"") for chunk in chunks)


async def test_a_stream_goes_on_while_its_key_holds():
    ring = StoredKeys(Keys(), None, lambda: 10)
    assert await sent(Stream(ring, lambda: None)) == b"012345"


async def test_a_stream_ends_when_its_key_expires():
    now_us = [10]
    ring = StoredKeys(Keys(), None, lambda: now_us[0])
    stream = Stream(ring, lambda: now_us.__setitem__(0, 50))
    assert await sent(stream) == b"012"
    assert stream.is_ended_early


async def test_a_stream_ends_when_its_key_is_revoked():
    keys = Keys()
    ring = StoredKeys(keys, None, lambda: 10)

    def revoke():
        keys.all = tuple
        ring.forget()

    assert await sent(Stream(ring, revoke)) == b"012"


async def test_the_bootstrap_key_holds_on():
    ring = StoredKeys(Keys(), "boot", lambda: 10)
    assert await ring.still_holds(await ring.principal("boot"))
    assert await ring.still_holds(Principal("somebody", Role.VIEWER))
