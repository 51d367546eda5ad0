"""Access keys and the audit log keep their contract on every database."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from sqlalchemy import text

from service.errors import ConflictError, NotFoundError, StorageError
from service.records.catalogue import Site, Spacecraft
from service.records.operations.access_key import AccessKey, Role, StoredKey, digest_of
from service.records.operations.audit import CURRENT_NOTE, AuditContext, AuditEvent, AuditFilter, findings

EVER = AuditFilter(start_us=-(2**62), stop_us=2**62)
INERTIA = ((4000.0, 0.0, 0.0), (0.0, 2000.0, 0.0), (0.0, 0.0, 4000.0))


def audit_event(action="create", **changes):
    known = AuditEvent(
        at_us=5,
        who="anna",
        key_id="k1",
        role="operator",
        address="127.0.0.1",
        action=action,
        target="/spacecraft/",
        outcome="done",
        request_id="r-1",
        body_sha256="ab" * 32,
    )
    return replace(known, **changes)


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
