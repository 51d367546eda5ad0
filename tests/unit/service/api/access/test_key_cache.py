"""Keys that cannot be read: those known hold on for a while, and an archive that hangs is waited for together."""

import asyncio
import time

import pytest

from service.api.access import key_cache as stored_keys
from service.api.access.key_cache import StoredKeys
from service.errors import StorageError
from service.records.operations.access_key import AccessKey, Role, StoredKey, digest_of, new_key

WAIT_S = 0.2


class Hanging:
    """Keys of an archive that answers until it hangs."""

    def __init__(self, *stored):
        self.stored, self.is_hanging, self.reads = stored, False, 0

    def all(self):
        self.reads += 1
        if self.is_hanging:
            time.sleep(WAIT_S)
            raise StorageError("storage.unavailable", "no answer")
        return self.stored


@pytest.fixture
def known():
    """A key, and the archive that holds it."""
    key_id, text = new_key()
    key = AccessKey(id=key_id, name="anna", role=Role.VIEWER, created_at_us=0, created_by="test")
    return text, Hanging(StoredKey(key, digest_of(text.encode())))


def test_a_thousand_requests_wait_for_a_hanging_archive_no_longer_than_one(known):
    text, archive = known
    archive.is_hanging = True

    async def ask():
        keys = StoredKeys(archive, None, lambda: 0)
        began_s = time.monotonic()
        asked = [keys.principal(text) for _ in range(1000)]
        answers = await asyncio.gather(*asked, return_exceptions=True)
        return answers, time.monotonic() - began_s

    answers, spent_s = asyncio.run(ask())
    assert {type(answer) for answer in answers} == {StorageError}
    assert {answer.code for answer in answers} == {"storage.unavailable"}
    assert archive.reads == 1
    assert spent_s < 600 * WAIT_S  # one wait for each would be a thousand


def test_keys_that_are_known_hold_on_while_the_archive_hangs(known, monkeypatch):
    text, archive = known
    monkeypatch.setattr(stored_keys, "REFRESH_S", 0.0)
    monkeypatch.setattr(stored_keys, "HOLDS_S", 600.0)

    async def ask():
        keys = StoredKeys(archive, None, lambda: 0)
        first = await keys.principal(text)
        archive.is_hanging = True
        rest = await asyncio.gather(*(keys.principal(text) for _ in range(100)))
        monkeypatch.setattr(stored_keys, "HOLDS_S", 0.0)
        with pytest.raises(StorageError):
            await keys.principal(text)
        archive.is_hanging = False
        return [first, *rest, await keys.principal(text)]

    assert {principal.name for principal in asyncio.run(ask())} == {"anna"}
