"""Every storage keeps alarms, notes, releases, keys and the audit log; of two who change one only one succeeds."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from sqlalchemy import text
from stored_records import ALARM, AUDIT_EVENT, AXES, COMMAND, PULSES

from db.storage import SqlStorage
from service.errors import ConflictError, NotFoundError, StorageError
from service.ports.archive import ListPart
from service.records.calibration import Window
from service.records.catalogue import Site, Spacecraft
from service.records.levels.attitude import ReleasedCommand, ReportedCommand
from service.records.operations.access import (
    CURRENT_NOTE,
    AccessKey,
    AuditContext,
    AuditFilter,
    BrowserSession,
    Role,
    StoredKey,
    digest_of,
    findings,
)
from service.records.operations.alarms import (
    AlarmChange,
    AlarmLimits,
    ChangeKind,
    Cover,
    EngineMemory,
    Handling,
    Note,
    Process,
    ValueMemory,
    WatchMemory,
)
from service.records.operations.release import (
    CommandState,
    InterlockHold,
    ProductForm,
    ReleaseChange,
    StoredRelease,
    UplinkProduct,
)

S = 1_000_000


def change(alarm, kind=ChangeKind.RAISED, **more):
    return AlarmChange(kind, alarm, alarm.changed_at_us, is_told=True, **more)


def closed(alarm):
    return replace(alarm, process=Process.NORMAL)


def raise_one(storage, **changes):
    (stored,) = storage.alarms.save([change(replace(ALARM, **changes))])
    return stored.alarm


def test_a_change_comes_back_as_it_was_with_numbers(storage):
    handling = Handling("anna", 9 * S, "seen")
    (raised,) = storage.alarms.save([change(ALARM)])
    assert raised.alarm == replace(ALARM, id=raised.alarm.id)
    seen = replace(raised.alarm, process=Process.ACKNOWLEDGED, acknowledged=handling, changed_at_us=9 * S)
    (acknowledged,) = storage.alarms.save([change(seen, ChangeKind.ACKNOWLEDGED, handling=handling)])
    assert acknowledged.sequence > raised.sequence > 0
    assert storage.alarms.alarm(raised.alarm.id) == seen
    assert storage.alarms.changes(raised.alarm.id) == [raised, acknowledged]
    assert storage.alarms.changes_after("craft", raised.sequence, 10) == [acknowledged]
    assert storage.alarms.newest_sequence() == acknowledged.sequence
    assert storage.alarms.open_alarms("craft") == (seen,)


def test_changes_of_a_new_alarm_in_one_batch_are_of_one_alarm_and_the_next_one_is_another(storage):
    second = replace(ALARM, raised_at_us=20 * S, changed_at_us=20 * S)
    batch = [change(ALARM), change(closed(ALARM), ChangeKind.RETURNED), change(second)]
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
        return [each.id for each in storage.alarms.alarms("craft", states, ListPart(window, limit, after))]

    assert listed() == [*ids, service, covered, old]
    assert listed("open") == [*ids, service]
    assert listed("shelved") == [covered]
    assert listed("closed", "shelved") == [covered, old]
    assert listed("unacknowledged", limit=2) == ids[:2]
    assert listed("open", after=(2 * S, ids[1])) == [ids[2], service]
    assert listed(window=replace(make.ever, start_us=2 * S, stop_us=4 * S)) == ids[1:]
    assert [each.id for each in storage.alarms.open_alarms(None)] == [service]


def test_the_memory_of_the_alarms_is_kept_for_each_spacecraft_and_for_the_service(storage):
    value = ValueMemory(2, 5, 3, 7, None, ("downlink_fade", "receiving site"), 9, 1.5, 8)
    memory = EngineMemory((WatchMemory("carrier_level", "c01", value),), 11, 60.5)
    assert storage.alarms.memory("craft") == EngineMemory()
    storage.alarms.save_memory("craft", EngineMemory())
    storage.alarms.save_memory("craft", memory)
    storage.alarms.save_memory(None, replace(memory, newest_row_us=12))
    assert storage.alarms.memory("craft") == memory
    assert storage.alarms.memory(None).newest_row_us == 12


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
    assert storage.notes.notes(ListPart(make.ever, 10), "craft") == [early, general, late, fixed]
    assert storage.notes.notes(ListPart(make.ever, 10)) == [early, other, general, late, fixed]
    assert storage.notes.notes(ListPart(make.ever, 2, (10, early.id)), "craft") == [general, late]
    assert storage.notes.notes(ListPart(make.ever, 2, newest_first=True), "craft") == [fixed, late]
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


def test_notes_are_dropped_by_the_instant_they_are_about(storage, make):
    def note(epoch_us, spacecraft_id):
        return storage.notes.add(Note(0, spacecraft_id, epoch_us, epoch_us, "anna", "text"))

    old, other, general, late = (note(*each) for each in ((5, "a"), (5, "b"), (5, None), (9, "a")))
    assert list(storage.notes.drop_before("a", 9)) == [1]
    assert list(storage.notes.drop_before(None, 9)) == [1]
    assert {each.id for each in storage.notes.notes(ListPart(make.ever, 10))} == {other.id, late.id}
    for gone in (old, general):
        with pytest.raises(NotFoundError):
            storage.notes.note(gone.id)


PRODUCT = UplinkProduct(ProductForm.TORQUES, 1, 800 * S, 900 * S, 993 * S, 690 * S, True, "ab", PULSES)
ANGLES = UplinkProduct(ProductForm.ATTITUDE, 1, 5 * S, 5 * S, 8 * S, 4 * S, True, attitude_deg=AXES, sigma_deg=AXES)


def release_change(document="{}", **parts):
    return ReleaseChange(document, "process-1", **parts)


def test_the_state_comes_back_as_it_was_with_its_version(setting):
    releases = setting.storage.releases
    assert (releases.stored(setting.id), releases.versions()) == (StoredRelease(), {})
    assert releases.save(setting.id, 0, release_change('{"a": 1}')) == 1
    assert releases.save(setting.id, 1, replace(release_change('{"a": 2}'), holder="process-2")) == 2
    assert releases.stored(setting.id) == StoredRelease(2, '{"a": 2}', "process-2")
    assert releases.versions() == {setting.id: 2}
    with pytest.raises(NotFoundError, match=r"spacecraft\.unknown"):
        releases.stored("nobody")


@pytest.mark.parametrize("version", [0, 2, -1])
def test_who_does_not_know_the_newest_version_changes_nothing(setting, version):
    releases = setting.storage.releases
    releases.save(setting.id, 0, release_change("first"))
    number = setting.storage.archive.head(setting.id).newest_number
    reported = (InterlockHold(1, "TRIPPED", ("stop",), is_withheld=True, version=9),)
    with pytest.raises(ConflictError, match=r"release\.changed"):
        releases.save(
            setting.id, version, release_change("second", commands=(COMMAND,), products=(PRODUCT,), entries=reported)
        )
    assert releases.stored(setting.id).document == "first"
    assert releases.newest_product(setting.id, ProductForm.TORQUES) is None
    assert setting.storage.archive.head(setting.id).newest_number == number
    with pytest.raises(NotFoundError, match=r"command\.unknown"):
        releases.command(setting.id, 1)


def test_of_many_that_change_it_at_once_one_succeeds(setting, url):
    second = SqlStorage(url)
    barrier, won, lost = threading.Barrier(6), [], []

    def attempt(storage, name):
        barrier.wait()
        try:
            won.append(storage.releases.save(setting.id, 0, replace(release_change(), holder=name)))
        except ConflictError:
            lost.append(name)

    threads = [threading.Thread(target=attempt, args=((setting.storage, second)[k % 2], str(k))) for k in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    second.close()
    assert (won, len(lost)) == ([1], 5)


def test_a_command_changes_its_state_and_never_what_it_is(setting):
    releases = setting.storage.releases
    releases.save(setting.id, 0, release_change(commands=(COMMAND,)))
    assert repr(releases.command(setting.id, 1)) == repr(COMMAND)
    released = replace(COMMAND, state=CommandState.RELEASED, confirmed_by="bob", released_us=800 * S)
    releases.save(setting.id, 1, release_change(commands=(released,), products=(PRODUCT,)))
    assert repr(releases.command(setting.id, 1)) == repr(released)
    with pytest.raises(ConflictError, match=r"release\.changed"):
        releases.save(setting.id, 2, release_change(commands=(replace(released, digest="other"),)))
    assert releases.stored(setting.id).version == 2


def test_uplink_products_are_only_added(setting):
    releases = setting.storage.releases
    releases.save(setting.id, 0, release_change(products=(PRODUCT, ANGLES, replace(ANGLES, counter=2))))
    assert releases.product(setting.id, ProductForm.TORQUES, 1) == PRODUCT
    assert repr(releases.newest_product(setting.id, ProductForm.ATTITUDE)) == repr(replace(ANGLES, counter=2))
    with pytest.raises(ConflictError, match=r"release\.changed"):
        releases.save(setting.id, 1, release_change(products=(replace(PRODUCT, digest="other"),)))
    assert releases.product(setting.id, ProductForm.TORQUES, 1) == PRODUCT
    with pytest.raises(NotFoundError, match=r"uplink\.unknown"):
        releases.product(setting.id, ProductForm.TORQUES, 2)


def test_commands_are_listed_in_order_of_preparation_beyond_a_cursor(setting, new_setting):
    releases = setting.storage.releases
    made = tuple(replace(COMMAND, counter=k, prepared_us=(700 + k // 2) * S) for k in range(1, 6))
    releases.save(setting.id, 0, release_change(commands=made))
    releases.save(new_setting().id, 0, release_change(commands=(COMMAND,)))
    window = Window(700 * S, 702 * S)
    first = releases.commands(setting.id, ListPart(window, 2))
    assert [command.counter for command in first] == [1, 2]
    rest = releases.commands(setting.id, ListPart(window, 9, (first[-1].prepared_us, 2)))
    assert [command.counter for command in rest] == [3]


def test_release_and_report_enter_the_journal_with_the_state(setting):
    releases, archive = setting.storage.releases, setting.storage.archive
    before = archive.head(setting.id).newest_number
    reported = (
        ReleasedCommand(1, 800 * S, PULSES),
        ReportedCommand(1, 1000 * S, PULSES[:1]),
        InterlockHold(1000 * S, "TRIPPED", ("stop",), is_withheld=True, version=1),
    )
    releases.save(setting.id, 0, release_change(entries=reported))
    assert tuple(entry.content for entry in archive.journal(setting.id, before, 9)) == reported
    again = InterlockHold(1000 * S, "INHIBITED", (), is_withheld=False, version=2)
    releases.save(setting.id, 1, release_change(entries=(again,)))
    holds = archive.inputs(setting.id, "interlock", ListPart(Window(0, 1 << 60), 9))
    assert [entry.content.version for entry in holds] == [1, 2]
    # a version that is told again would be lost without a word
    with pytest.raises(ConflictError, match=r"release\.changed"):
        releases.save(setting.id, 2, release_change("third", entries=reported[:1]))
    assert releases.stored(setting.id).version == 2


EVER = AuditFilter(start_us=-(2**62), stop_us=2**62)
INERTIA = ((4000.0, 0.0, 0.0), (0.0, 2000.0, 0.0), (0.0, 0.0, 4000.0))


def audit_event(action="create", **changes):
    return replace(AUDIT_EVENT, action=action, **changes)


def stored(key_id="k1", role=Role.OPERATOR, **changes):
    key = AccessKey(id=key_id, name=f"anna {key_id}", role=role, created_at_us=7, created_by="bootstrap", **changes)
    return StoredKey(key, digest_of(key_id.encode()))


def faults(storage, announced=None):
    return [(one.number, one.kind) for one in findings(storage.audit.chain(), storage.audit.head(), announced)]


@pytest.fixture
def noted():
    """Give a function that puts a note on this context, as the interface does for a request."""
    tokens = []

    def put(wanted):
        note = AuditContext(wanted)
        tokens.append(CURRENT_NOTE.set(note))
        return note

    yield put
    for token in reversed(tokens):
        CURRENT_NOTE.reset(token)


def test_keys_come_back_as_they_were_stored(storage):
    first, second = stored(), stored("k2", Role.ADMIN, expires_at_us=99)
    storage.keys.add(first)
    storage.keys.add(second)
    assert storage.keys.all() == (first, second)
    storage.keys.note_used({"k1": 42, "nobody": 1})
    assert storage.keys.all()[0].key == replace(first.key, last_used_us=42)


def test_a_key_is_revoked_once_and_stays_known(storage):
    storage.keys.add(stored())
    assert storage.keys.revoke("k1", 50).revoked_at_us == 50
    assert storage.keys.all()[0].key.revoked_at_us == 50
    for key_id in ("k1", "nobody"):
        with pytest.raises(NotFoundError, match=r"key\.unknown"):
            storage.keys.revoke(key_id, 60)
    assert storage.keys.all()[0].key.revoked_at_us == 50


def test_sessions_end_one_by_one_with_their_key_and_with_their_time(storage):
    for key_id in ("k1", "k2"):
        storage.keys.add(stored(key_id))
    opened = [BrowserSession(bytes([k]), key_id, 100 + k) for k, key_id in enumerate(("k1", "k1", "k2", "k2"))]
    for session in opened:
        storage.keys.open_session(session, 50)
    assert storage.keys.sessions() == {session.digest: session for session in opened}
    storage.keys.end_session(opened[3].digest)
    storage.keys.revoke("k1", 60)
    assert list(storage.keys.sessions().values()) == [opened[2]]
    storage.keys.open_session(opened[0], 102)
    assert list(storage.keys.sessions().values()) == [opened[0]]
    assert storage.keys.service_id() == storage.keys.service_id() != ""


def test_the_first_administrator_is_made_only_while_there_is_none(storage):
    assert storage.keys.add_first_administrator(stored("a1", Role.ADMIN), audit_event("first"))
    assert not storage.keys.add_first_administrator(stored("a2", Role.ADMIN), audit_event("first"))
    storage.keys.revoke("a1", 50)
    assert storage.keys.add_first_administrator(
        stored("a3", Role.ADMIN, expires_at_us=100), audit_event("first", at_us=60)
    )
    # that one has expired by then
    assert storage.keys.add_first_administrator(stored("a4", Role.ADMIN), audit_event("first", at_us=100))
    assert [entry.audit_event.action for entry in storage.audit.chain()] == ["first"] * 3


def test_entries_are_numbered_and_chained(storage):
    assert (storage.audit.head().number, faults(storage)) == (0, [])
    made = [storage.audit.append(audit_event(f"a{k}", at_us=k)) for k in range(5)]
    assert [entry.number for entry in made] == [1, 2, 3, 4, 5]
    assert list(storage.audit.chain()) == made
    assert storage.audit.head() == made[-1].head
    assert faults(storage) == []
    assert faults(storage, {3: made[2].hash}) == []
    assert faults(storage, {3: "x", 9: "y"}) == [(3, "announced"), (9, "announced")]


def test_entries_are_found_by_time_person_and_thing(storage):
    storage.audit.append(audit_event("select_source", at_us=10, target="/spacecraft/a/sources/x%_"))
    storage.audit.append(audit_event("create_key", at_us=20, who="root", role="admin", target="/keys/k9"))
    storage.audit.append(audit_event("list_keys", at_us=30, outcome="403"))

    def found(limit=10, after=None, **wanted):
        return [entry.number for entry in storage.audit.entries(replace(EVER, **wanted), limit, after)]

    assert found() == [1, 2, 3]
    assert found(limit=2) == [1, 2]
    assert found(after=1) == [2, 3]
    assert found(start_us=20, stop_us=30) == [2]
    assert (found(who="root"), found(role="admin"), found(action="list_keys"), found(outcome="403")) == (
        [2],
        [2],
        [3],
        [3],
    )
    assert (found(target_prefix="/keys"), found(target_prefix="/spacecraft/a/sources/x%_")) == ([2], [1])
    assert found(target_prefix="%") == []


def test_a_change_takes_its_entry_along(storage, noted):
    note = noted(audit_event("create_spacecraft"))
    storage.catalogue.add_spacecraft(Spacecraft("craft", "Craft", 90.0, Site(55.0, 38.0), INERTIA, 0.05))
    assert list(storage.audit.chain()) == [note.entry]
    assert note.entry.audit_event.action == "create_spacecraft"
    # one entry a request, whatever else it writes
    storage.keys.add(stored())
    assert storage.audit.head().number == 1


def test_an_entry_names_what_was_made(storage, noted):
    noted(audit_event("create_key", target="/keys/"))
    storage.keys.add(stored("k7"))
    noted(audit_event("revoke_key", target="/keys/k7"))
    storage.keys.revoke("k7", 9)
    assert [entry.audit_event.target for entry in storage.audit.chain()] == ["/keys/k7", "/keys/k7"]


def test_a_change_that_fails_leaves_no_entry(storage, noted):
    note = noted(audit_event("revoke_key"))
    with pytest.raises(NotFoundError):
        storage.keys.revoke("nobody", 9)
    assert (note.entry, storage.audit.head().number) == (None, 0)


def test_a_change_whose_entry_fails_is_undone(storage, noted):
    storage.audit.append(audit_event())
    with storage._database.engines.write.begin() as connection:
        connection.execute(text("DELETE FROM audit_head"))
    # the chain would begin again, but number 1 is taken
    noted(audit_event("create_key"))
    with pytest.raises(StorageError):
        storage.keys.add(stored())
    assert storage.keys.all() == ()


@pytest.mark.parametrize("statement", ["UPDATE audit_entry SET who = 'eve'", "DELETE FROM audit_entry"])
def test_the_database_refuses_to_change_entries(storage, statement):
    storage.audit.append(audit_event())
    with pytest.raises(Exception, match="never changed"), storage._database.engines.write.begin() as connection:
        connection.execute(text(statement))
    assert faults(storage) == []


def tamper(storage, *statements):
    """Change the log as somebody would who owns the database and takes the guards away first."""
    with storage._database.engines.write.begin() as connection:
        if connection.dialect.name == "sqlite":
            for name in ("audit_entry_no_UPDATE", "audit_entry_no_DELETE"):
                connection.execute(text(f"DROP TRIGGER {name}"))
        else:
            connection.execute(text("SET LOCAL session_replication_role = replica"))
        for statement in statements:
            connection.execute(text(statement))


_COPY = "SELECT {number}, at_us, who, key_id, role, address, action, target, outcome, request_id, body_sha256, times"


@pytest.mark.parametrize(
    ("statements", "found"),
    [
        (("UPDATE audit_entry SET who = 'eve' WHERE number = 3",), [(3, "changed")]),
        (("UPDATE audit_entry SET times = 7 WHERE number = 5",), [(5, "changed")]),
        (("UPDATE audit_entry SET hash = previous_hash WHERE number = 3",), [(3, "changed"), (4, "changed")]),
        (("DELETE FROM audit_entry WHERE number = 1",), [(1, "missing")]),
        (("DELETE FROM audit_entry WHERE number = 3",), [(3, "missing")]),
        (("DELETE FROM audit_entry WHERE number >= 4",), [(4, "truncated")]),
        (("DELETE FROM audit_entry",), [(1, "truncated")]),
        # one taken out and the others moved up, so that the numbers look whole
        (
            (
                "DELETE FROM audit_entry WHERE number = 2",
                "UPDATE audit_entry SET number = 2 WHERE number = 3",
                "UPDATE audit_entry SET number = 3 WHERE number = 4",
                "UPDATE audit_entry SET number = 4 WHERE number = 5",
            ),
            [(2, "changed"), (2, "changed"), (3, "changed"), (4, "changed"), (5, "truncated")],
        ),
        # one put in behind the end
        (
            (f"INSERT INTO audit_entry {_COPY.format(number=6)}, hash, hash FROM audit_entry WHERE number = 5",),
            [(6, "changed"), (6, "beyond_head")],
        ),
        # the end cut off, and the head with it: only what was announced tells
        (
            (
                "DELETE FROM audit_entry WHERE number >= 4",
                "UPDATE audit_head SET number = 3, hash = (SELECT hash FROM audit_entry WHERE number = 3)",
            ),
            [(5, "announced")],
        ),
        (("DELETE FROM audit_head",), [(1, "beyond_head")]),
    ],
)
def test_whatever_is_changed_is_found(storage, statements, found):
    announced = {}
    for k in range(5):
        entry = storage.audit.append(audit_event(f"a{k}", at_us=k))
        announced = {entry.number: entry.hash}
    assert faults(storage, announced) == []
    tamper(storage, *statements)
    reported = faults(storage, announced if "audit_head SET" in "".join(statements) else None)
    assert reported[: len(found)] == found


def named(key_id, name, **changes):
    return replace(stored(key_id), key=replace(stored(key_id).key, name=name, **changes))


def test_no_two_keys_in_force_have_one_name(storage):
    storage.keys.add(named("k1", "Olga Straße"))
    for name in ("olga STRASSE", "Ｏlga Straße"):
        with pytest.raises(ConflictError, match="The valid key k1 has the name") as refused:
            storage.keys.add(named("k2", name))
        assert refused.value.code == "key.exists"
    storage.keys.add(named("k2", "Olga 2", expires_at_us=10))
    storage.keys.add(named("k3", "OLGA 2", created_at_us=10))
    storage.keys.revoke("k1", 20)
    storage.keys.add(named("k4", "olga straße"))
    assert [each.key.id for each in storage.keys.all()] == ["k1", "k2", "k4", "k3"]


def test_of_two_keys_of_one_name_that_are_made_at_once_one_is_made(storage):
    with ThreadPoolExecutor(8) as pool:
        made = [pool.submit(storage.keys.add, named(f"k{k}", "olga")) for k in range(8)]
    assert [future.exception() is None for future in made].count(True) == 1
