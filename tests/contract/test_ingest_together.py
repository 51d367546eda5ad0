"""Batches that wait together are stored as if each had come alone: receipts, rows, details, sources, sequences."""

import random
from dataclasses import replace
from threading import Event

import numpy as np
import pytest
from sqlalchemy import select

from db.encoding.segments import SegmentCache
from db.measurements.ingest_grouped import StoreBatch
from db.measurements.prepared_batch import prepare
from db.schema.tables import head, measurement, measurement_detail, sequence_interval, source
from service.records.levels.measurement import CarrierDetails

TABLES = (head, source, sequence_interval, measurement, measurement_detail)


def a_batch(setting, dice):
    """Return what one of four front ends may send: mostly the next row, sometimes anything."""
    rows = dice.choice([1, 1, 1, 1, 1, 1, 2, 0])
    number = dice.randrange(12)
    details = CarrierDetails(*np.full((4, rows, 3), dice.random(), dtype=np.float32)) if dice.random() < 0.3 else None
    batch = setting.batch(
        [100 * (number + position) for position in range(rows)],
        np.full((rows, 3), dice.choice([-50.25, -50.1, np.nan, -0.0])),
        source=f"sa-{dice.randrange(4)}",
        flags=[dice.choice([None, (0, 0, 0), (0, 1 << 22, 0)]) for _ in range(rows)],
        is_stale=[dice.random() < 0.2] * rows,
        first_seq=dice.choice([None, number, number, number, dice.randrange(20)]),
        details=details,
    )
    return replace(batch, received_at_us=77 + number)


def stored(connection, keys):
    """Return everything stored of spacecraft, the same for both ways of storing."""
    found = []
    for table in TABLES:
        rows = connection.execute(select(table).where(table.c.spacecraft_key.in_(keys))).all()
        names = [name for name in table.c.keys()[1:] if name != "checksum"]  # which covers the key
        found.append(
            sorted([keys.index(row.spacecraft_key), *(repr(getattr(row, name)) for name in names)] for row in rows)
        )
    return found


@pytest.mark.parametrize("seed", range(5))
def test_batches_together_are_batches_one_by_one(new_setting, seed):
    print(f"seed {seed}")
    dice = random.Random(seed)
    pairs = [(new_setting(), new_setting()) for _ in range(2)]
    database = pairs[0][0].storage._database
    cache = SegmentCache()
    keys = [[database.key(setting.id) for setting in settings] for settings in zip(*pairs, strict=True)]
    for _ in range(8):
        crafts = [dice.choice([0, 0, 0, 1]) for _ in range(dice.randrange(1, 9))]
        sent = [(record, a_batch(pairs[record][0], dice)) for record in crafts]
        alone = [StoreBatch(prepare(keys[0][record], batch), cache) for record, batch in sent]
        joint = [StoreBatch(prepare(keys[1][record], batch), cache) for record, batch in sent]
        with database.engines.write.begin() as connection:
            one_by_one = [work(connection) for work in alone]
        with database.engines.write.begin() as connection:
            together = StoreBatch.together(connection, joint)
        assert list(map(repr, together)) == list(map(repr, one_by_one))
        with database.read() as connection:
            assert stored(connection, keys[1]) == stored(connection, keys[0])


def test_rows_of_many_front_ends_at_once_are_all_there(setting):
    for position in range(20):
        batches = [setting.batch([100 * position], source=f"sa-{k}", first_seq=position) for k in range(16)]
        waiting = [setting.storage.archive.append_measurements(batch) for batch in batches]
        assert all(future.result(120).accepted == 1 for future in waiting)
    rows = setting.rows()
    assert len(rows) == 320
    assert sorted(row.number for row in rows) == list(range(rows[0].number, rows[0].number + 320))
    assert [(state.rows, state.rows_missing) for state in setting.storage.archive.sources(setting.id)] == [(20, 0)] * 16


def test_a_batch_that_fails_among_others_is_lost_alone(setting):
    archive, database = setting.storage.archive, setting.storage._database
    is_full = Event()
    held = database.submit(lambda _: is_full.wait(120))
    batches = [setting.batch([100 * position], source="sa-1", first_seq=position) for position in range(6)]
    good = [archive.append_measurements(batch) for batch in batches[:3]]
    bad = database.submit(StoreBatch(prepare(1 << 20, batches[3]), SegmentCache()))
    good += [archive.append_measurements(batch) for batch in batches[3:]]
    is_full.set()
    assert held.result(120)
    assert [future.result(120).accepted for future in good] == [1] * 6
    assert bad.exception(120) is not None
    assert [row.epoch_us for row in setting.rows()] == [0, 100, 200, 300, 400, 500]
