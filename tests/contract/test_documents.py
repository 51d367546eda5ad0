"""Documents that estimates rest on: a change in the database is found, and named, wherever it is looked for."""

import json
from dataclasses import replace
from hashlib import sha256

import pytest

from db.encoding.record_codec import COVERED, digest_of
from db.maintenance.backup import create_backup
from db.maintenance.doctor import diagnose
from db.tables import metadata
from service.errors import StorageError
from service.records.catalogue import Ephemeris
from service.runtime.clock import system_now_us

#: statement that changes one document, name of that document
CHANGES = [
    ("UPDATE calibration SET result = replace(result, '0.1', '-0.1') WHERE calibration_id = 2", "calibration 2"),
    ("UPDATE calibration SET request = replace(request, '20', '21') WHERE calibration_id = 2", "calibration 2"),
    ("UPDATE calibration SET plan_id = 7 WHERE calibration_id = 2", "calibration 2"),
    ("UPDATE alignment SET document = replace(document, '100', '101')", "alignment 1"),
    ("UPDATE carrier_plan SET document = replace(document, '3710000000.0', '3.8e9') WHERE plan_id = 2", None),
    ("UPDATE ephemeris SET document = replace(document, '86164.0', '86165.0') WHERE ephemeris_id = 3", "ephemeris 3"),
    ("UPDATE spacecraft SET document = replace(document, '4000.0', '-4000.0')", "catalogue entry"),
    ("UPDATE journal SET document = document || ' ' WHERE kind = 'activation' AND key = '2'", None),
]


@pytest.fixture
def filled(setting):
    """A spacecraft with two of every document, the second ones in force."""
    catalogue = setting.storage.catalogue
    craft = catalogue.spacecraft(setting.id)
    catalogue.replace_spacecraft(replace(craft, name="another"))
    carriers = catalogue.plan(setting.id).carriers
    setting.plan_id = catalogue.put_plan(setting.id, tuple(reversed(carriers)), "b" * 64).id
    withdrawn = catalogue.put_plan(setting.id, carriers[:1], "c" * 64)
    catalogue.withdraw_plan(setting.id, withdrawn.id)
    for stop in (10, 20):
        catalogue.put_ephemeris(setting.id, Ephemeris(0, (1, 2), 86_164.0, 0, stop, "nodes"))
    for _ in range(2):
        setting.calibrate()
    setting.align(100)
    return setting


def damaged(setting):
    """Return what is damaged of the documents in force."""
    return setting.storage.catalogue.damaged_documents(setting.id)


def execute(setting, statement):
    """Change something in the database; return how many rows."""
    with setting.storage._database.engines.write.begin() as connection:
        return connection.exec_driver_sql(statement).rowcount


def test_documents_of_a_sound_archive_have_their_digests(filled, url):
    assert damaged(filled) == ()
    assert [each for each in diagnose(url, system_now_us(), lambda _: None) if "digest" in each.detail] == []


@pytest.mark.parametrize(("statement", "name"), CHANGES)
def test_a_changed_document_is_named_by_interlock_doctor_and_backup(filled, url, tmp_path, statement, name):
    assert execute(filled, statement) == 1, statement
    (found,) = damaged(filled)
    assert found == (name or found)
    words = f"{found} of {filled.id}"
    faults = [each for each in diagnose(url, system_now_us(), lambda _: None) if each.check == "checksums"]
    assert f"{words} differs from its digest" in [each.detail for each in faults if each.state == "fault"]
    manifest = create_backup(url, tmp_path / "copy", 5, lambda *_: None)
    assert f"{words} differs from its digest" in manifest.damaged


@pytest.mark.parametrize("table", COVERED, ids=lambda table: table.name)
def test_a_document_changed_together_with_its_digest_differs_from_the_journal(filled, table):
    text = "result" if table.name == "calibration" else "document"
    with filled.storage._database.engines.write.begin() as connection:
        for row in connection.execute(table.select()).all():
            values = {**row._mapping, text: row._mapping[text].replace("1", "2")}
            number = table.c[COVERED[table][0]]
            changed = {text: values[text], "digest": digest_of(table, values)}
            connection.execute(table.update().where(number == row._mapping[number.name]).values(changed))
    (found,) = damaged(filled)
    names = {"spacecraft": "catalogue entry", "carrier_plan": "carrier plan"}
    assert found.startswith(names.get(table.name, table.name))


def test_a_document_that_is_not_in_force_stops_nothing_and_the_doctor_names_it(filled, url):
    execute(filled, "UPDATE calibration SET result = replace(result, '0.1', '-0.1') WHERE calibration_id = 1")
    assert damaged(filled) == ()
    found = [each.detail for each in diagnose(url, system_now_us(), lambda _: None) if each.check == "checksums"]
    assert found == [f"calibration 1 of {filled.id} differs from its digest"]
    with pytest.raises(StorageError, match=r"document\.corrupt: Calibration 1 differs"):
        filled.storage.results.activate_calibration(filled.id, 1)
    # the one in force still is
    assert [each.id for each in filled.storage.results.calibrations(filled.id) if each.state == "active"] == [2]


def test_a_document_made_again_is_sound(filled):
    execute(filled, "UPDATE calibration SET result = replace(result, '0.1', '-0.1') WHERE calibration_id = 2")
    assert damaged(filled) == ("calibration 2",)
    filled.calibrate()
    assert damaged(filled) == ()


def test_a_document_that_cannot_be_read_is_named(filled):
    execute(filled, """UPDATE calibration SET result = replace(result, '"observability"', '"ability"')""")
    execute(filled, """UPDATE ephemeris SET document = '{'""")
    execute(filled, """UPDATE alignment SET document = replace(document, '"source"', '"from"')""")
    storage = filled.storage
    for read, name in (
        (lambda: storage.results.calibration(filled.id, 2), "calibration 2"),
        (lambda: storage.catalogue.ephemeris(filled.id), f"ephemeris 3 of {filled.id}"),
        (lambda: storage.results.alignments(filled.id), "alignment 1"),
    ):
        with pytest.raises(StorageError, match=rf"storage\.corrupt: {name}: a stored \w+ cannot be read"):
            read()


def test_the_journal_names_documents_by_a_plain_sha256(filled):
    with filled.storage._database.read() as connection:
        row = connection.execute(metadata.tables["alignment"].select()).one()
    content = json.dumps([row.alignment_id, row.epoch_us, row.document])
    assert row.digest == sha256(content.encode()).hexdigest()
