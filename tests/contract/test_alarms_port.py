"""Every storage keeps alarms, what happened to them, their limits and memory, and the notes of the shift log."""

import math
from dataclasses import replace

import pytest

from db.storage import SqlStorage
from service.errors import NotFoundError
from service.records.operations.alarm import Alarm, AlarmChange, ChangeKind, Cover, Handling, Process, Severity
from service.records.operations.alarm_limits import AlarmLimits
from service.records.operations.alarm_memory import EngineMemory, ValueMemory, WatchMemory
from service.records.operations.note import Note

S = 1_000_000
RAISED = Alarm(
    id=0,
    spacecraft_id="craft",
    condition="carrier_absent",
    thing="c01",
    process=Process.UNACKNOWLEDGED,
    cover=Cover.NONE,
    severity=Severity.WARNING,
    since_us=5 * S,
    raised_at_us=7 * S,
    changed_at_us=7 * S,
    value=120.5,
    limit=math.inf,
    unit="s",
    detail="carrier c01: nothing found\n\u0000 \u20ac",
)


def change(alarm, kind=ChangeKind.RAISED, **more):
    return AlarmChange(kind, alarm, alarm.changed_at_us, is_told=True, **more)


def closed(alarm):
    return replace(alarm, process=Process.NORMAL)


def raise_one(storage, **changes):
    (stored,) = storage.alarms.save([change(replace(RAISED, **changes))])
    return stored.alarm


def test_a_change_comes_back_as_it_was_with_numbers(storage):
    handling = Handling("anna", 9 * S, "seen")
    (raised,) = storage.alarms.save([change(RAISED)])
    assert raised.alarm == replace(RAISED, id=raised.alarm.id)
    seen = replace(raised.alarm, process=Process.ACKNOWLEDGED, acknowledged=handling, changed_at_us=9 * S)
    (acknowledged,) = storage.alarms.save([change(seen, ChangeKind.ACKNOWLEDGED, handling=handling)])
    assert acknowledged.sequence > raised.sequence > 0
    assert storage.alarms.alarm(raised.alarm.id) == seen
    assert storage.alarms.changes(raised.alarm.id) == [raised, acknowledged]
    assert storage.alarms.changes_after("craft", raised.sequence, 10) == [acknowledged]
    assert storage.alarms.newest_sequence() == acknowledged.sequence
    assert storage.alarms.open_alarms("craft") == (seen,)


def test_changes_of_a_new_alarm_in_one_batch_are_of_one_alarm_and_the_next_one_is_another(storage):
    second = replace(RAISED, raised_at_us=20 * S, changed_at_us=20 * S)
    batch = [change(RAISED), change(closed(RAISED), ChangeKind.RETURNED), change(second)]
    first, gone, other = storage.alarms.save(batch)
    assert first.alarm.id == gone.alarm.id != other.alarm.id
    assert [alarm.id for alarm in storage.alarms.open_alarms("craft")] == [other.alarm.id]


def test_alarms_are_listed_by_state_and_window_with_those_of_the_service(storage, make):
    raise_one(storage, spacecraft_id="other")
    ids = [raise_one(storage, thing=f"c{k}", raised_at_us=k * S).id for k in (1, 2, 3)]
    service = raise_one(storage, spacecraft_id=None, raised_at_us=4 * S).id
    covered = raise_one(storage, cover=Cover.SHELVED, raised_at_us=5 * S).id
    old = raise_one(storage, process=Process.NORMAL, raised_at_us=6 * S).id

    def listed(*states, limit=10, after=None, window=make.ever):
        return [each.id for each in storage.alarms.alarms("craft", states, window, limit, after)]

    assert listed() == [*ids, service, covered, old]
    assert listed("open") == [*ids, service]
    assert listed("shelved") == [covered]
    assert listed("closed", "shelved") == [covered, old]
    assert listed("unacknowledged", limit=2) == ids[:2]
    assert listed("open", after=(2 * S, ids[1])) == [ids[2], service]
    assert listed(window=replace(make.ever, start_us=2 * S, stop_us=4 * S)) == ids[1:]
    assert [each.id for each in storage.alarms.open_alarms(None)] == [service]


def test_memory_and_alarms_outlive_the_service(url):
    memory = EngineMemory((WatchMemory("carrier_level", "c01", ValueMemory(2, 5, 3, 7, None, 1.5, 8)),), 11, 60.5)
    first = SqlStorage(url)
    first.prepare()
    assert first.alarms.memory("craft") == EngineMemory()
    first.alarms.save_memory("craft", EngineMemory())
    first.alarms.save_memory("craft", memory)
    first.alarms.save_memory(None, replace(memory, newest_row_us=12))
    alarm = raise_one(first)
    first.close()
    second = SqlStorage(url)
    assert second.alarms.memory("craft") == memory
    assert second.alarms.memory(None).newest_row_us == 12
    assert second.alarms.open_alarms("craft") == (alarm,)
    second.close()


def test_every_version_of_limits_is_kept(storage, setting):
    stated = AlarmLimits(0, 5, "anna", "first", {"normal": {"carrier_level": {"warning": 2.0, "distress": None}}})
    assert storage.alarms.limits(setting.id) == AlarmLimits()
    first = storage.alarms.put_limits(setting.id, stated)
    second = storage.alarms.put_limits(setting.id, replace(stated, nominal_dbm={"c00": -42.5}))
    assert (first.version, second.version) == (1, 2)
    assert storage.alarms.limits(setting.id) == second
    assert storage.alarms.limits(setting.id, 1) == first == replace(stated, version=1)
    assert storage.alarms.limits(setting.id, 0) == AlarmLimits()
    with pytest.raises(NotFoundError) as caught:
        storage.alarms.limits(setting.id, 3)
    assert caught.value.code == "alarm_limits.unknown"


def test_notes_are_added_and_told_in_order_of_their_epochs(storage, make):
    def add(epoch_us, **more):
        return storage.notes.add(Note(0, "craft", epoch_us, 50, "anna", f"text {epoch_us}", ("shift",), **more))

    late, early = add(20), add(10)
    general = storage.notes.add(Note(0, None, 15, 50, "boris", "all well"))
    fixed = add(30, corrects=early.id)
    other = storage.notes.add(Note(0, "other", 12, 50, "anna", "elsewhere"))
    assert storage.notes.note(fixed.id) == fixed
    assert storage.notes.notes(make.ever, 10, None, "craft") == [early, general, late, fixed]
    assert storage.notes.notes(make.ever, 10, None) == [early, other, general, late, fixed]
    assert storage.notes.notes(make.ever, 2, (10, early.id), "craft") == [general, late]
    assert storage.notes.newest(2, "craft") == [fixed, late]
    assert storage.notes.last_written(3, "craft") == [fixed, general, early]


def test_unknown_alarms_and_notes_are_told_so(storage):
    for call, code in (
        (lambda: storage.alarms.alarm(1 << 40), "alarm.unknown"),
        (lambda: storage.notes.note(1 << 40), "note.unknown"),
        (lambda: storage.notes.add(Note(0, None, 1, 1, "anna", "x", (), 1 << 40)), "note.unknown"),
    ):
        with pytest.raises(NotFoundError) as caught:
            call()
        assert caught.value.code == code


def test_closed_alarms_are_dropped_with_their_changes_and_open_ones_stay(storage):
    old, late = raise_one(storage), raise_one(storage, thing="c02", raised_at_us=20 * S)
    standing = raise_one(storage, thing="c03")
    of_service = raise_one(storage, spacecraft_id=None, thing="disk")
    for alarm in (old, late, of_service):
        storage.alarms.save([change(closed(alarm), ChangeKind.CLEARED)])
    assert list(storage.alarms.drop_before("craft", 20 * S)) == [1]
    with pytest.raises(NotFoundError):
        storage.alarms.alarm(old.id)
    assert storage.alarms.changes(old.id) == []
    assert [storage.alarms.alarm(kept.id).thing for kept in (late, standing, of_service)] == ["c02", "c03", "disk"]
    assert list(storage.alarms.drop_before(None, 20 * S)) == [1]
    assert list(storage.alarms.drop_before("craft", 20 * S)) == []
    assert len(storage.alarms.changes(late.id)) == 2


def test_notes_are_dropped_by_the_instant_they_are_about(storage):
    def note(epoch_us, spacecraft_id):
        return storage.notes.add(Note(0, spacecraft_id, epoch_us, epoch_us, "anna", "text"))

    old, other, general, late = (note(*each) for each in ((5, "a"), (5, "b"), (5, None), (9, "a")))
    assert list(storage.notes.drop_before("a", 9)) == [1]
    assert list(storage.notes.drop_before(None, 9)) == [1]
    assert {each.id for each in storage.notes.newest(10)} == {other.id, late.id}
    for gone in (old, general):
        with pytest.raises(NotFoundError):
            storage.notes.note(gone.id)
