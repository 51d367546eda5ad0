"""Migrations go up, down and up again, and what they make is what the tables say."""

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import inspect

import db.alarm_tables
import db.key_tables  # noqa: F401 - their tables belong to the schema
from db.engine import open_engines
from db.migrate import downgrade, upgrade
from db.sequence_numbers import Block, SequenceNumbers, Tail
from db.tables import metadata


@pytest.fixture
def engine(tmp_path):
    engines = open_engines(f"sqlite:///{tmp_path / 'soo.db'}")
    yield engines.write
    engines.dispose()


def schema(engine):
    with engine.connect() as connection:
        rows = connection.exec_driver_sql("SELECT name, sql FROM sqlite_master ORDER BY name").all()
    return {name: sql for name, sql in rows if not name.startswith("alembic")}


def test_up_down_up_leaves_the_same_schema(engine):
    upgrade(engine)
    first = schema(engine)
    downgrade(engine)
    assert {name for name in schema(engine) if not name.startswith("sqlite_")} == set()
    upgrade(engine)
    assert schema(engine) == first


def test_migrating_twice_changes_nothing(engine):
    upgrade(engine)
    first = schema(engine)
    upgrade(engine)
    assert schema(engine) == first


def test_the_migrations_make_the_tables_of_the_code(engine):
    upgrade(engine)
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": False})
        assert compare_metadata(context, metadata) == []
        metadata.drop_all(connection)
        metadata.create_all(connection)
        made = inspect(connection)
        declared = {name: [repr(column["type"]) for column in made.get_columns(name)] for name in metadata.tables}
        connection.rollback()
        built = inspect(connection)
        migrated = {name: [repr(column["type"]) for column in built.get_columns(name)] for name in metadata.tables}
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
