"""Access: heads and refusals are written down, an answer ends with its key, known keys outlive a hanging archive."""

import asyncio
import logging
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest
from stored_records import AUDIT_EVENT

from service.api.access import housekeeping as access_keeping
from service.api.access import housekeeping as stored_keys
from service.api.access.access_middleware import AccessLayer
from service.api.access.auth import Principal
from service.api.access.housekeeping import MAX_GROUPS, AccessHousekeeping, Refusals, StoredKeys
from service.errors import StorageError
from service.records.inputs import JournalHead
from service.records.operations.access import (
    AccessKey,
    AuditHead,
    Role,
    StoredKey,
    digest_of,
    new_key,
    next_entry,
)

pytestmark = pytest.mark.anyio


def refused(address="192.0.2.1"):
    return replace(AUDIT_EVENT, address=address, outcome="401")


class Log:
    """An audit log in memory."""

    def __init__(self) -> None:
        self.entries = []

    def append(self, audit_event):
        self.entries.append(next_entry(self.head(), audit_event))

    def head(self):
        return self.entries[-1].head if self.entries else AuditHead(0, "0" * 64)


@pytest.fixture
def log():
    return Log()


def keeping(log, refusals=None, keys=None):
    unused = SimpleNamespace(write_down_used=lambda: None)
    return AccessHousekeeping(keys or unused, refusals or Refusals(), log)


def announced(caplog):
    return [record.getMessage().split()[2] for record in caplog.records if "audit head" in record.getMessage()]


def test_heads_are_announced_first_hourly_and_last_while_they_move(log, caplog, monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(access_keeping.time, "monotonic", lambda: now_s[0])
    kept = keeping(log)
    with caplog.at_level(logging.INFO, "soo.audit"):
        kept.keep()
        log.append(refused())
        kept.keep()
        assert announced(caplog) == ["0"]
        now_s[0] += access_keeping.ANNOUNCE_S
        kept.keep()
        assert announced(caplog) == ["0", "1"]
        now_s[0] += access_keeping.ANNOUNCE_S
        kept.keep()
        log.append(refused())
        kept.keep(is_last=True)
        assert announced(caplog) == ["0", "1", "2"]
        assert log.head().hash in caplog.text


def test_counted_refusals_are_written_at_the_end(log):
    refusals = Refusals(lambda: 0.0)
    admitted = [refusals.admit(refused()) for _ in range(5)]
    assert admitted == [True] + [False] * 4
    kept = keeping(log, refusals)
    kept.keep()
    assert log.entries == []
    kept.keep(is_last=True)
    assert [entry.audit_event.times for entry in log.entries] == [4]
    kept.keep(is_last=True)
    assert len(log.entries) == 1


def test_no_refusal_is_lost_in_the_count_and_memory_is_bounded():
    refusals = Refusals(lambda: 0.0)
    written = sum(refusals.admit(refused(f"192.0.{k // 256}.{k % 256}")) for k in range(5000))
    assert written == MAX_GROUPS + 1
    assert sum(audit_event.times for audit_event in refusals.settled(is_last=True)) == 5000 - written


async def test_it_lives_on_after_a_fault_and_ends_in_good_order(log, caplog, monkeypatch):
    monkeypatch.setattr(access_keeping, "PERIOD_S", 0.0)
    faults = iter([StorageError("storage.unavailable", "on purpose"), RuntimeError("on purpose")])
    uses = []

    def use():
        uses.append(1)
        fault = next(faults, None)
        if fault:
            raise fault

    kept = keeping(log, keys=SimpleNamespace(write_down_used=use))
    kept.start()
    while len(uses) < 4:
        await asyncio.sleep(0.001)
    await kept.stop()
    assert caplog.text.count("housekeeping of keys and audit log failed") == 2


async def test_journal_heads_are_announced_first_every_ten_minutes_and_last_while_they_move(log, caplog, monkeypatch):
    now_s, number = [0.0], [1]
    monkeypatch.setattr(access_keeping.time, "monotonic", lambda: now_s[0])
    unused = SimpleNamespace(write_down_used=lambda: None)
    heads = lambda: [JournalHead("craft-1", number[0], "0123456789abcdef")]  # noqa: E731
    kept = AccessHousekeeping(unused, Refusals(), log, heads)
    with caplog.at_level(logging.INFO, "soo.audit"):
        for at_s, entry in ((0.0, 1), (599.0, 2), (600.0, 3), (1200.0, 3), (1300.0, 4)):
            now_s[0], number[0] = at_s, entry
            kept.keep()
        kept.keep(is_last=True)
    said = [line for line in caplog.messages if line.startswith("journal")]
    assert said == [f"journal head craft-1 {entry} 0123456789abcdef" for entry in (1, 3, 4)]


class Keys:
    """An archive of one key."""

    def __init__(self) -> None:
        self.key = AccessKey(id="abc", name="vera", role=Role.VIEWER, created_at_us=0, created_by="x", expires_at_us=50)
        self.open_sessions = {}
        self.end_session = self.open_sessions.pop

    def open_session(self, session, _at_us):
        self.open_sessions[session.digest] = session

    def all(self):
        return (StoredKey(self.key, digest_of(b"soo_abc_secret")),)

    def sessions(self):
        return self.open_sessions


class Stream:
    """An application that sends pieces, and does something between them."""

    def __init__(self, ring, between) -> None:
        self.ring, self.between, self.is_ended_early = ring, between, True
        self.asked = lambda: ring.principal("soo_abc_secret")

    async def __call__(self, scope, receive, send):
        scope["state"]["principal"] = await self.asked()
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


@pytest.mark.parametrize("end", ["sign-out", "time", "another process"])
async def test_a_stream_ends_with_its_session(end):
    now_us, keys = [10], Keys()
    ring = StoredKeys(keys, "boot", lambda: now_us[0], "service")
    token, session = ring.open_session(await ring.principal("boot"))

    def close():
        if end == "time":
            now_us[0] = session.ends_at_us
        elif end == "sign-out":
            ring.end_session(session)
        else:
            keys.end_session(session.digest)
            ring.forget()

    stream = Stream(ring, close)
    stream.asked = lambda: ring.session_holder(token)
    assert await sent(stream) == b"012"


async def test_the_bootstrap_key_holds_on():
    ring = StoredKeys(Keys(), "boot", lambda: 10)
    assert await ring.still_holds(await ring.principal("boot"))
    assert await ring.still_holds(Principal("somebody", Role.VIEWER))


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

    def sessions(self):
        return {}


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
        keys = StoredKeys(archive, "boot", lambda: 0)
        first = await keys.principal(text)
        archive.is_hanging = True
        rest = await asyncio.gather(*(keys.principal(text) for _ in range(100)))
        monkeypatch.setattr(stored_keys, "HOLDS_S", 0.0)
        with pytest.raises(StorageError):
            await keys.principal(text)
        # the bootstrap key needs no archive
        assert (await keys.principal("boot")).name == "bootstrap"
        archive.is_hanging = False
        return [first, *rest, await keys.principal(text)]

    assert {principal.name for principal in asyncio.run(ask())} == {"anna"}
