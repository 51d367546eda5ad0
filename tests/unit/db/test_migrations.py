"""Migrations go up, down and up again, and what they make is what the tables say."""

import numpy as np
import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import inspect, select

import db.schema.access_tables
import db.schema.alarm_tables
import db.schema.release_tables  # noqa: F401 - their tables belong to the schema
from db.connection.engines import open_engines
from db.measurements.sequence_numbers import Block, SequenceNumbers, Tail
from db.migrations.migrate import downgrade, upgrade
from db.schema.tables import measurement_detail, metadata
from db.storage import SqlStorage
from service.ports import Outcome
from service.records.catalogue import Carrier, ControlSettings, Method, Release, Site, Spacecraft
from service.records.levels.attitude import row_without_attitude
from service.records.levels.measurement import CarrierDetails, MeasurementBatch
from service.records.operations.job import Job, JobState, Replay

INERTIA = ((4000.0, 0.0, 0.0), (0.0, 2000.0, 0.0), (0.0, 0.0, 4000.0))


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request, tmp_path):
    """An empty database of each kind."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'soo.db'}"
        return
    cluster = request.getfixturevalue("postgresql_cluster")
    made = cluster.new_database()
    yield made
    cluster.drop(made)


@pytest.fixture
def any_engine(url):
    engines = open_engines(url)
    yield engines.write
    engines.dispose()


@pytest.fixture
def engine(tmp_path):
    engines = open_engines(f"sqlite:///{tmp_path / 'soo.db'}")
    yield engines.write
    engines.dispose()


def schema(engine):
    """Return what each table is made of, as text."""
    if engine.dialect.name == "postgresql":
        found = inspect(engine)
        parts = (found.get_columns, found.get_pk_constraint, found.get_indexes, found.get_unique_constraints)
        names = [name for name in found.get_table_names() if not name.startswith("alembic")]
        return {name: repr([part(name) for part in parts]) for name in names}
    with engine.connect() as connection:
        rows = connection.exec_driver_sql("SELECT name, sql FROM sqlite_master ORDER BY name").all()
    return {name: sql for name, sql in rows if not name.startswith("alembic")}


def test_up_down_up_leaves_the_same_schema(any_engine):
    upgrade(any_engine)
    first = schema(any_engine)
    assert "measurement_segment" in first
    downgrade(any_engine)
    assert {name for name in schema(any_engine) if not name.startswith("sqlite_")} == set()
    upgrade(any_engine)
    assert schema(any_engine) == first


@pytest.mark.parametrize(("revision", "is_sealed"), [("0004", True), ("0008", False)])
def test_an_older_schema_gets_plain_rows_back(url, revision, is_sealed):
    """An archive goes down to the version before sealed days, or before packed powers, and up, and loses nothing."""
    storage = SqlStorage(url)
    storage.migrate()
    engine = storage._database.engines.write
    storage.catalogue.add_spacecraft(Spacecraft("craft", "craft", 90.0, Site(55.0, 38.0), INERTIA, 0.05))
    plan = storage.catalogue.put_plan("craft", [Carrier(f"c{k}", "C", "t0", 3.7e9, 5e6) for k in range(8)], "sha")
    power_dbm = (np.arange(24).reshape(3, 8) / 100 - 50).astype(np.float32)
    power_dbm[1] = np.nan
    for source, has_more in (("sa-1", True), ("sa-2", False)):
        details = CarrierDetails(*np.full((4, 3, 8), 0.1, dtype=np.float32)) if has_more else None
        batch = MeasurementBatch(
            "craft",
            source,
            plan.id,
            received_at_us=77,
            index=np.arange(3),
            epochs_us=np.array([10, 30, 20]),
            power_dbm=power_dbm if has_more else np.where(power_dbm == -50, np.float32(-0.0), power_dbm),
            flags=((1 << 22,) * 8, None, (0,) * 8) if has_more else (None,) * 3,
            is_stale=np.array([True, False, False]),
            first_seq=5 if has_more else None,
            details=details,
        )
        storage.archive.append_measurements(batch).result(120)
    details = stored_details(engine)
    journal = repr(storage.archive.journal("craft", 0, 99))
    if is_sealed:
        assert sum(part.rows for part in storage.archive.seal("craft", 1 << 60, 1 << 60)) == 6
        assert stored_details(engine) == []
        assert repr(storage.archive.journal("craft", 0, 99)) == journal
    else:
        assert packed_rows(engine) == 3
    downgrade(engine, revision)
    assert plain_rows(engine) == [
        (10, 1, 3, 5, 77, True, True, power_dbm[0].tobytes(), np.full(8, 1 << 22, dtype="<i4").tobytes()),
        (30, 1, 4, 6, 77, False, True, power_dbm[1].tobytes(), None),
        (20, 1, 5, 7, 77, False, True, power_dbm[2].tobytes(), bytes(32)),
        (10, 2, 6, None, 77, True, False, batch.power_dbm[0].tobytes(), None),
        (30, 2, 7, None, 77, False, False, power_dbm[1].tobytes(), None),
        (20, 2, 8, None, 77, False, False, power_dbm[2].tobytes(), None),
    ]
    assert stored_details(engine) == details
    upgrade(engine)
    assert repr(storage.archive.journal("craft", 0, 99)) == journal
    storage.close()


def plain_rows(engine):
    query = "SELECT epoch_us, source_key, number, seq, received_at_us, is_late, feeds, powers, flags FROM measurement"
    with engine.connect() as connection:
        rows = connection.exec_driver_sql(f"{query} ORDER BY number").all()
    return [tuple(row) for row in rows]


def packed_rows(engine):
    with engine.connect() as connection:
        return connection.exec_driver_sql("SELECT count(*) FROM measurement WHERE length(powers) < 32").scalar_one()


def stored_details(engine):
    with engine.connect() as connection:
        order = measurement_detail.c.source_key, measurement_detail.c.epoch_us
        return connection.execute(select(measurement_detail).order_by(*order)).all()


def test_migrating_twice_changes_nothing(any_engine):
    upgrade(any_engine)
    first = schema(any_engine)
    upgrade(any_engine)
    assert schema(any_engine) == first


def test_the_migrations_make_the_tables_of_the_code(any_engine):
    engine = any_engine
    upgrade(engine)
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": False})
        assert compare_metadata(context, metadata) == []
        metadata.drop_all(connection)
        metadata.create_all(connection)
        made = inspect(connection)
        declared = {
            name: {column["name"]: repr(column["type"]) for column in made.get_columns(name)}
            for name in metadata.tables
        }
        connection.rollback()
        built = inspect(connection)
        migrated = {
            name: {column["name"]: repr(column["type"]) for column in built.get_columns(name)}
            for name in metadata.tables
        }
    assert migrated == declared


def test_numbers_from_before_they_were_counted_are_one_run_without_gaps(engine):
    """An archive of the version before: its sources go on counting where they stand, and miss nothing."""
    upgrade(engine, "0002")
    with engine.begin() as connection:
        run = connection.exec_driver_sql
        run("INSERT INTO spacecraft VALUES (1, 'craft', '{}')")
        for key, name in ((1, "numbered"), (2, "plain")):
            run("INSERT INTO source VALUES (1, ?, ?, 1, 30, 2)", (key, name))
            for epoch_us, seq in ((10, 7), (30, 9)):
                values = (epoch_us, key, 10 * key + epoch_us, seq if key == 1 else None, b"")
                run("INSERT INTO measurement VALUES (1, ?, ?, ?, 1, ?, 5, 0, 1, ?, NULL)", values)
    upgrade(engine)
    with engine.connect() as connection:
        query = "SELECT seq_run, seq_after_us, seq_start, seq_last, rows_missing FROM source ORDER BY source_key"
        assert connection.exec_driver_sql(query).all() == [(1, 30, 9, 9, 0), (None,) * 5]
        numbers = SequenceNumbers(connection, 1, 1)
        tail = Tail(1, 30, 9, 9, 0)
        # what comes next goes on; what was held or lost before is not counted
        assert numbers.added(tail, Block(10, 12, 40, is_ahead=True), 30).rows_missing == 0
        assert numbers.added(tail, Block(3, 5, 5, is_ahead=False), 30) == tail
    downgrade(engine, "0002")
    with engine.connect() as connection:
        assert len(connection.exec_driver_sql("SELECT * FROM source").keys()) == 6


def test_tables_that_grow_have_no_second_key(engine):
    upgrade(engine)
    made = schema(engine)
    for name in ("measurement", "measurement_detail", "sequence_interval", "journal", "attitude", "torque"):
        assert made[name].rstrip().endswith("WITHOUT ROWID")


def test_a_migration_that_fails_leaves_nothing_behind(engine, monkeypatch):
    def fail(*_args, **_options):
        raise RuntimeError("on purpose")

    monkeypatch.setattr("alembic.operations.base.Operations.create_index", fail)
    with pytest.raises(RuntimeError, match="on purpose"):
        upgrade(engine)
    assert schema(engine) == {}


def test_rows_of_an_older_version_wait_for_their_checksums(any_engine):
    """The migration writes no row: it notes the tables that hold any."""
    upgrade(any_engine, "0009")
    with any_engine.begin() as connection:
        connection.exec_driver_sql("INSERT INTO note (note_id, epoch_us, document) VALUES (1, 2, '{}')")
    upgrade(any_engine)
    with any_engine.connect() as connection:
        assert connection.exec_driver_sql("SELECT table_name FROM checksum_backlog").scalars().all() == ["note"]
        assert connection.exec_driver_sql("SELECT checksum FROM note").scalar_one() is None


def test_real_spacecraft_under_release_automatic_become_two_step(url):
    storage = SqlStorage(url)
    storage.migrate()
    automatic = ControlSettings(release=Release.AUTOMATIC)
    crafts = [("real", False, automatic), ("toy", True, automatic), ("other", False, ControlSettings())]
    for name, is_simulated, control in crafts:
        site = Site(55.0, 38.0)
        spacecraft = Spacecraft(name, name, 90.0, site, INERTIA, 0.05, simulated=is_simulated, control=control)
        storage.catalogue.add_spacecraft(spacecraft)
    engine = storage._database.engines.write
    downgrade(engine, "0010")
    upgrade(engine)
    reported = {spacecraft.id: spacecraft.control.release for spacecraft in storage.catalogue.all_spacecraft()}
    assert reported == {"real": Release.TWO_STEP, "toy": Release.AUTOMATIC, "other": Release.TWO_STEP}
    made_us = {name: storage.releases.made_two_step_us(name) for name, *_ in crafts}
    assert [name for name, at_us in made_us.items() if at_us is not None] == ["real"]
    # a second upgrade finds nothing more to do
    upgrade(engine)
    assert storage.releases.made_two_step_us("real") == made_us["real"]
    storage.close()


def test_replays_of_an_older_schema_are_counted_with_their_sealed_rows(url):
    storage = SqlStorage(url)
    storage.migrate()
    storage.catalogue.add_spacecraft(Spacecraft("craft", "craft", 90.0, Site(55.0, 38.0), INERTIA, 0.05))
    results = storage.results
    results.add_job(Job("job", "replay", JobState.DONE, 1.0, 5))
    version = results.add_replay("craft", Replay(0, 1, 9, None, None, 1, "journal", "job", 9)).version
    for number in (1, 2, 3):
        row = row_without_attitude(number, number, number, Method.PAPER, ("late",))
        results.save_outcomes("craft", version, [Outcome((row,), None)], 0, None)
        if number == 2:
            assert sum(part.rows for part in results.seal("craft", 1 << 60)) == 2
    before = results.replay("craft", version)
    assert (before.attitude_rows, before.torque_rows, before.state) == (3, 0, JobState.DONE)
    downgrade(storage._database.engines.write, "0016")
    upgrade(storage._database.engines.write)
    assert results.replay("craft", version) == before
    storage.close()
