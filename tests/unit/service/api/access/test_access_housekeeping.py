"""What is written down beside the requests: heads while they move, counts and uses at the latest at the end."""

import asyncio
import logging
from types import SimpleNamespace

import pytest

from service.api.access import access_housekeeping as access_keeping
from service.api.access.access_housekeeping import AccessHousekeeping
from service.api.access.refusal_audit import MAX_GROUPS, Refusals
from service.errors import StorageError
from service.records.journal import JournalHead
from service.records.operations.audit import AuditEvent, AuditHead, next_entry

pytestmark = pytest.mark.anyio


def refused(address="192.0.2.1"):
    return AuditEvent(
        at_us=1,
        who="anonymous",
        key_id="",
        role="",
        address=address,
        action="list_keys",
        target="/keys",
        outcome="401",
        request_id="r",
    )


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
