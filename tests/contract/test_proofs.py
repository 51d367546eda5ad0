"""Heads of journals and checksums of rows: what an archive has lost and one flipped bit are found."""

import logging
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sqlalchemy import select, update
from stored_records import ALARM

import db.maintenance.integrity_check
from db.columns import CHECKSUM_BYTES, checksum_of
from db.maintenance.backup import create_backup, restore_backup, verify_backup
from db.maintenance.doctor import diagnose
from db.tables import attitude, measurement, metadata
from service.errors import StorageError
from service.ports.archive import LIVE, ListPart, Outcome
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS, Method
from service.records.inputs import (
    AttitudeReference,
    Correction,
    JournalHead,
    Operation,
    PolarizationRecord,
    TelemetryRecord,
    WeatherReport,
)
from service.records.levels.attitude import Axes
from service.records.levels.measurement import CarrierDetails, Ring, Sender, Trace, TraceSettings
from service.records.operations.alarms import AlarmChange, ChangeKind, Note
from service.records.operations.release import ProductForm, ReleaseChange, UplinkProduct
from service.records.storage import BackupError, Checkpoint, worst
from service.runtime.clock import system_now_us

DAY_US = 86_400_000_000


def compared(url, heads):
    """Return what the doctor says of heads."""
    found = diagnose(url, system_now_us(), lambda _: None, heads)
    return [(each.state, each.detail) for each in found if each.check == "log"]


def head(setting):
    (found,) = [each for each in setting.storage.archive.journal_heads() if each.spacecraft_id == setting.id]
    return found


def test_heads_of_every_kind_of_entry_hold_also_when_their_day_is_sealed(setting, url):
    heads = [head(setting)]
    details = CarrierDetails(*np.array([[[0.5, np.nan, 1.0]]] * 4, dtype=np.float32))
    for step in (
        lambda: setting.append([10], float("nan")),
        lambda: setting.append([20], -0.0, flags=[(1, 2, 3)], first_seq=5),
        lambda: setting.append([30], details=details),
        lambda: setting.append([25], source="sa-2", flags=[(0, 0, 0)], is_stale=[True]),
        lambda: setting.storage.archive.add_operation(setting.id, Operation(0, "eclipse", 1, 2, comment="тень")),
    ):
        step()
        heads.append(head(setting))
    assert [each.number for each in heads] == list(range(heads[0].number, heads[0].number + 6))
    assert len({each.digest for each in heads}) == 6
    said = [("ok", f"{setting.id}: 6 entries are those that the log names, up to {heads[-1].number}")]
    assert compared(url, heads) == said
    assert sum(part.rows for part in setting.storage.archive.seal(setting.id, 2 * DAY_US, system_now_us())) == 4
    assert compared(url, heads) == said
    setting.consume()
    assert sum(each.rows for each in setting.storage.archive.drop_before(setting.id, "measurements", DAY_US)) == 4
    assert [state for state, _ in compared(url, heads)] == ["ok"]
    assert compared(url, []) == []


@pytest.mark.parametrize("change", [{"digest": "0" * 16}, {"number": 3}])
def test_an_entry_that_is_another_one_is_told(setting, url, change):
    setting.append([10])
    ((state, words),) = compared(url, [head(setting), head(setting)._replace(**change)])
    assert (state, "are not those that the log names" in words) == ("fault", True)


def test_a_spacecraft_that_is_gone_is_told(setting, url):
    ((state, words),) = compared(url, [JournalHead("nobody", 7, "0" * 16)])
    assert (state, words) == ("fault", "nobody: 7 entries are lost: the log names 7, the journal ends at 0")


def test_rows_of_a_deleted_write_ahead_log_are_told_and_nothing_else_tells_them(setting, url, tmp_path):
    if not url.startswith("sqlite"):
        pytest.skip("about files")
    setting.append(range(1, 11))
    engine = setting.storage._database.engines.write
    with engine.connect() as connection:
        connection.exec_driver_sql("ROLLBACK")
        connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.exec_driver_sql("BEGIN")
    before = head(setting)
    setting.append(range(11, 1011))
    after = head(setting)
    # what a kill leaves, and then the log is deleted
    (tmp_path / "killed").mkdir()
    killed = tmp_path / "killed" / "soo.db"
    shutil.copy(tmp_path / "soo.db", killed)
    lost = f"sqlite:///{killed}"
    assert {each.state for each in diagnose(lost, system_now_us(), lambda _: None) if each.check != "disk"} == {"ok"}
    ((state, words),) = compared(lost, [before, after])
    assert (state, words.split(": ")[1]) == ("fault", "1000 entries are lost")
    assert [state for state, _ in compared(lost, [before])] == ["ok"]


#: made of rows of closed days and of replays; sealing, summaries and replays have their own tests
MADE_OF_ROWS = {"segment", "summary"}
TABLES = {
    table.name: table for table in metadata.sorted_tables if "checksum" in table.c and table.name not in MADE_OF_ROWS
}


def ignore(*_):
    """Tell nobody of the progress."""


def write(setting):
    """Return a transaction that may change anything."""
    return setting.storage._database.engines.write.begin()


def of_checksums(url):
    """Return state and words of the doctor about checksums."""
    found = [each for each in diagnose(url, system_now_us(), ignore) if each.check == "checksums"]
    assert found
    return [(each.state, each.detail) for each in found]


@pytest.fixture
def filled(setting, make):
    """An open day with rows of every form, and a row in every table that has checksums."""
    details = CarrierDetails(*np.full((4, 3, 3), 0.5, dtype=np.float32))
    setting.append([10, 20, 30], [-50.1, -0.0, float("nan")], flags=[(1, 2, 3), None, (0, 0, 0)], first_seq=7)
    setting.append([40, 50, 60], details=details)
    setting.append([15], source="sa-2", flags=[(0, 0, 0)])
    together = [setting.batch([70 + position], source=source) for position in range(3) for source in ("sa-1", "sa-2")]
    for future in [setting.storage.archive.append_measurements(batch) for batch in together]:
        assert future.result(10).accepted == 1
    batch = replace(setting.batch([80]), sender=Sender("k1", 9, "north"))
    assert setting.storage.archive.append_measurements(batch).result(10).accepted == 1
    rows = setting.rows()
    reference = make.attitude_row(rows[0]).attitude_deg
    setting.storage.archive.append_inputs(setting.id, [AttitudeReference("star_tracker", 12, reference, reference)])
    setting.storage.archive.add_operation(setting.id, Operation(0, "eclipse", 1, 2, comment="тень \u2028 \x7f"))
    made = tuple(
        make.attitude_row(row, method, common_db=np.float64(0.1) + 0.2, residual_rms_db=0, downlink_fade_db=-0.0)
        for row in rows
        for method in LIVE_METHODS
    )
    setting.consume([Outcome(made, make.torque_command(rows[0], command_period_s=60))])
    trace = Trace(10, "wide", TraceSettings(1e9, 1e3, float("nan"), 1e3, 2), np.array([-60.0, -59.5]))
    setting.storage.traces.append(setting.id, "sa-1", [trace], 11, Ring(9, 1 << 20))
    setting.storage.notes.add(Note(0, setting.id, 5, 6, "olga", "смена"))
    product = UplinkProduct(ProductForm.TORQUES, 1, 5, 6, 7, 5, is_simulated=True)
    setting.storage.releases.save(setting.id, 0, ReleaseChange("{}", "holder", products=(product,)))
    alarm = replace(ALARM, spacecraft_id=setting.id, limit=2)
    setting.storage.results.save_outcomes(setting.id, LIVE, [], 1, 10, Checkpoint(1, 10, "1/numpy", b"\x00state"))
    setting.storage.alarms.save([AlarmChange(ChangeKind.RAISED, alarm, 7, is_told=True)])
    return setting


def test_every_row_agrees_with_its_checksum_of_four_bytes(filled, url):
    with filled.storage._database.read() as connection:
        for table in TABLES.values():
            sizes = {len(checksum) for checksum in connection.scalars(select(table.c.checksum))}
            assert sizes == {CHECKSUM_BYTES}, table.name
    ((state, words),) = of_checksums(url)
    assert state == "ok"
    assert "none yet" not in words


#: a value that differs in its last place, or in nothing but itself, of one row of each table
CHANGES = (
    "UPDATE measurement SET delay_us = delay_us + 1 WHERE epoch_us = 10",
    "UPDATE measurement SET seq = seq + 1 WHERE epoch_us = 20",
    "UPDATE measurement SET flags = NULL WHERE epoch_us = 30",
    "UPDATE measurement SET feeds = NOT feeds WHERE epoch_us = 15",
    "UPDATE measurement SET figures = NULL WHERE epoch_us = 40",
    "UPDATE journal SET document = replace(document, '\"comment\":', '\"Comment\":') WHERE kind = 'operation'",
    "UPDATE journal SET stop_us = stop_us + 1 WHERE kind = 'operation'",
    "UPDATE attitude SET downlink_fade_db = 0.0 WHERE epoch_us = 10",
    "UPDATE attitude SET common_db = 0.3 WHERE epoch_us = 20",
    "UPDATE attitude SET calibration_id = NULL WHERE epoch_us = 30",
    "UPDATE attitude SET status = 'INVALID' WHERE epoch_us = 40",
    "UPDATE torque SET roll_n_m = -roll_n_m",
    "UPDATE trace SET received_at_us = 12",
    "UPDATE alarm_change SET spacecraft_id = NULL",
    "UPDATE note SET epoch_us = 4",
    "UPDATE uplink_product SET created_us = 6",
    "UPDATE source_key_run SET station = 'south'",
)


def test_what_was_changed_is_found_in_every_table(filled):
    with filled.storage._database.engines.write.connect() as connection:
        for statement in CHANGES:
            with connection.begin() as transaction:
                assert connection.exec_driver_sql(statement).rowcount, statement
                damaged = [each for each in db.maintenance.integrity_check.checked_tables(connection) if each.differing]
                transaction.rollback()
            assert [each.name for each in damaged] == [statement.split()[1]], statement
            assert len(damaged[0].named) == damaged[0].differing


def flip(setting, epoch_us, column="powers"):
    """Flip one bit of what is stored of a row."""
    is_it = (measurement.c.epoch_us == epoch_us, measurement.c.source_key == 1)
    with write(setting) as connection:
        blob = bytearray(connection.scalar(select(measurement.c[column]).where(*is_it)))
        blob[-1] ^= 1
        connection.execute(update(measurement).where(*is_it).values({column: bytes(blob)}))


def as_stored(setting):
    """Return the rows as the chain takes them, sound or not."""
    return list(setting.storage.archive.measurements_after(setting.id, 0, 1 << 62))


#: every stretch of an answer lies within one interval
EACH = SimpleNamespace(hold=lambda first_us, _: np.ones(len(first_us), dtype=np.bool_))


def readers(setting):
    """Return by table what reads its rows for somebody outside."""
    archive, results, releases = setting.storage.archive, setting.storage.results, setting.storage.releases
    window = Window(0, DAY_US)
    of = (setting.id, "live", Method.ROBUST, window)
    notes = setting.storage.notes
    note_id = notes.notes(ListPart(window, 1), setting.id)[0].id
    with setting.storage._database.read() as connection:
        alarm_id = connection.scalar(select(metadata.tables["alarm_change"].c.alarm_id))
    return {
        "measurement": [
            setting.rows,
            lambda: list(archive.measurement_blocks(setting.id, window)),
            lambda: archive.measurement_series(setting.id, window, ("c00",)),
            lambda: list(archive.sampled_measurements(setting.id, window, EACH)),
            lambda: list(archive.sampled_measurements(setting.id, window, EACH, figure="c_n0_db_hz")),
            lambda: archive.journal(setting.id, 0, 99, is_compared=True),
        ],
        "journal": [
            lambda: archive.inputs(setting.id, "operation", ListPart(window, 99)),
            lambda: archive.operation(setting.id, 1),
            lambda: archive.journal(setting.id, 0, 99, is_compared=True),
        ],
        "trace": [lambda: setting.storage.traces.trace(setting.id, 10)],
        "note": [lambda: notes.note(note_id), lambda: notes.notes(ListPart(window, 9), setting.id)],
        "alarm_change": [lambda: setting.storage.alarms.changes(alarm_id)],
        "attitude": [
            lambda: results.attitude_rows(*of[:3], ListPart(window, 99)),
            lambda: results.attitude_rows(*of[:3], ListPart(window, 99, newest_first=True)),
            lambda: results.carrier_results(*of),
            lambda: list(results.sampled_attitude(*of, EACH)),
            lambda: results.results_after(setting.id, 0, 99),
        ],
        "torque": [
            lambda: results.commands(setting.id, "live", ListPart(window, 99)),
            lambda: results.newest_command(setting.id, "live"),
            lambda: list(results.sampled_impulse(setting.id, "live", window, EACH)),
        ],
        "uplink_product": [
            lambda: releases.product(setting.id, ProductForm.TORQUES, 1),
            lambda: releases.newest_product(setting.id, ProductForm.TORQUES),
        ],
    }


def test_no_row_that_differs_leaves_the_archive(filled):
    """The chain alone takes a damaged measurement, so that a replay of it stays equal to the live run."""
    statements = {each.split()[1]: [] for each in CHANGES}
    for statement in CHANGES:
        statements[statement.split()[1]].append(statement)
    for table, reads in readers(filled).items():
        for read in reads:
            read()
        assert statements[table]
        for statement in statements[table]:
            with write(filled) as connection:
                before = [dict(row) for row in connection.execute(metadata.tables[table].select()).mappings()]
                assert connection.exec_driver_sql(statement).rowcount, statement
            for read in reads:
                with pytest.raises(StorageError, match=r"storage\.corrupt: .* differs from its checksum"):
                    read()
            assert as_stored(filled)
            with write(filled) as connection:
                connection.execute(metadata.tables[table].delete())
                connection.execute(metadata.tables[table].insert(), before)


def test_no_slow_input_that_differs_leaves_the_archive_and_the_chain_takes_it(filled):
    axes, window, archive = Axes(0.1, 0.2, 0.3), Window(0, DAY_US), filled.storage.archive
    sent = [
        TelemetryRecord(11, "hold"),
        Correction(12, 14, axes),
        WeatherReport("gauge", "Dubna", 13, rain_rate_mm_h=1.0),
        PolarizationRecord("p", 14, angle_deg=0.3, sigma_deg=0.1),
    ]
    archive.append_inputs(filled.id, sent)
    for kind in ("reference", "telemetry", "correction", "weather", "polarization"):
        (entry,) = archive.inputs(filled.id, kind, ListPart(window, 9))
        with write(filled) as connection:
            is_it = metadata.tables["journal"].c.kind == kind
            document = metadata.tables["journal"].c.document
            connection.execute(update(metadata.tables["journal"]).where(is_it).values(document=document + " "))
        with pytest.raises(StorageError, match=r"storage\.corrupt: The journal row of .* differs from its checksum"):
            archive.inputs(filled.id, kind, ListPart(window, 9))
        assert archive.inputs(filled.id, kind, ListPart(window, 9), is_compared=False) == [entry]
        assert entry in archive.journal(filled.id, 0, 99)
    with pytest.raises(StorageError, match=r"storage\.corrupt: The journal row of .* differs from its checksum"):
        archive.reference_series(filled.id, window)


@pytest.mark.parametrize("column", ["powers", "checksum"])
def test_one_flipped_bit_is_told_by_doctor_and_backups(filled, url, tmp_path, column):
    assert create_backup(url, tmp_path / "sound", 5, ignore).damaged == []
    flip(filled, 20, column)
    ((state, words),) = of_checksums(url)
    assert state == "fault"
    assert words.startswith("1 rows of measurement differ from their checksum:")
    assert "epoch 1970-01-01T00:00:00.000020Z" in words
    (reported,) = create_backup(url, tmp_path / "spoilt", 5, ignore).damaged
    assert reported == words
    assert worst(verify_backup(tmp_path / "sound", ignore)) == "ok"
    assert words in [each.detail for each in verify_backup(tmp_path / "spoilt", ignore) if each.state == "fault"]
    # all that is sound in it can be put back, and the row as it is
    restored = f"sqlite:///{tmp_path / 'restored.db'}"
    restore_backup(tmp_path / "spoilt", restored, "x", ignore, may_replace=False)
    assert of_checksums(restored) == [("fault", words)]
    # a row that was damaged after the backup was made is another matter
    forged = tmp_path / "sound" / "archive.db"
    with closing(sqlite3.connect(forged)) as connection, connection:
        connection.execute("UPDATE measurement SET delay_us = delay_us + 1 WHERE epoch_us = 20")
    with pytest.raises(BackupError, match="the backup is not sound: file"):
        restore_backup(tmp_path / "sound", restored, "x", ignore, may_replace=True)


def test_rows_that_the_database_refuses_to_read_are_told_by_a_backup(setting, url, tmp_path):
    if not url.startswith("sqlite"):
        pytest.skip("about files")
    setting.storage.notes.add(Note(0, setting.id, 5, 6, "olga", "a"))
    with write(setting) as connection:
        connection.exec_driver_sql("UPDATE note SET document = CAST(x'ff' AS TEXT)")
    (reported,) = create_backup(url, tmp_path / "b", 5, ignore).damaged
    assert reported.startswith("rows cannot be read: Could not decode")


def test_values_that_no_writer_stores_differ_and_stop_nothing(setting):
    setting.append([10])
    with setting.storage._database.engines.write.begin() as connection:
        if connection.dialect.name != "sqlite":
            return
        connection.exec_driver_sql("UPDATE measurement SET seq = 'x', number = 1.5")
        (damaged,) = [each for each in db.maintenance.integrity_check.checked_tables(connection) if each.differing]
    assert damaged.name == "measurement"


def test_a_damaged_row_is_not_sealed_and_not_lost(setting, url, caplog):
    for day in range(2):
        details = CarrierDetails(*np.full((4, 5, 3), 0.5, dtype=np.float32))
        setting.append([day * DAY_US + position for position in range(1, 6)], details=details)
    flip(setting, 3)
    before = as_stored(setting)
    with caplog.at_level(logging.ERROR):
        parts = list(setting.storage.archive.seal(setting.id, 3 * DAY_US, system_now_us()))
    assert sum(part.rows for part in parts) == 9
    assert repr(as_stored(setting)) == repr(before)
    (line,) = [record.getMessage() for record in caplog.records]
    assert "1 measurement rows differ" in line
    assert "1970-01-01T00:00:00.000003Z" in line
    assert [state for state, _ in of_checksums(url)] == ["fault"]
    # it comes back as itself: the bit flips back, and the row is merged into its day
    flip(setting, 3)
    assert [part.rows for part in setting.storage.archive.seal(setting.id, 3 * DAY_US, system_now_us())] == [1]
    assert [state for state, _ in of_checksums(url)] == ["ok"]


def test_a_group_with_very_many_damaged_rows_is_left_alone(setting, monkeypatch):
    monkeypatch.setattr("db.sealing._MOST_STAYING", 1)
    setting.append(range(1, 6))
    flip(setting, 2)
    flip(setting, 3)
    assert list(setting.storage.archive.seal(setting.id, 3 * DAY_US, system_now_us())) == []
    assert len(as_stored(setting)) == 5


def test_a_column_that_is_added_later_leaves_checksums_as_they_are():
    row = {"spacecraft_key": 1, "version": "live", "yaw_deg": float("nan"), "advice": None}
    assert checksum_of(attitude, row) == checksum_of(attitude, {"spacecraft_key": 1, "version": "live"})
    assert checksum_of(attitude, row) != checksum_of(attitude, {**row, "advice": "[]"})


def test_rows_without_a_checksum_are_counted(filled, url):
    with write(filled) as connection:
        rows = connection.execute(update(attitude).values(checksum=None)).rowcount
    warning = ("warning", f"{rows} rows of attitude have no checksum, where every row should have one")
    assert of_checksums(url)[0] == warning
