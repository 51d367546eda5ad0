"""Samples read from summaries are those of the rows, whenever days are sealed, summarised, and met by late rows."""

import random
from dataclasses import astuple

import numpy as np
import pytest
from sqlalchemy import delete, select, update

from db.encoding.segments import DAY_US
from db.results import attitude_summaries
from db.schema.tables import attitude_summary, power_summary
from service.core.rows.sample_bins import SampleBins
from service.ports import LIVE, Outcome
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.levels.attitude import NO_ANGLES, Axes
from service.records.levels.measurement import CarrierDetails

ALWAYS = 1 << 60
STEP_US = 300_000_000


def seal(setting, before_us=ALWAYS):
    """Seal and summarise what is over."""
    list(setting.storage.archive.seal(setting.id, before_us, ALWAYS))
    list(setting.storage.results.complete_summaries(setting.id, before_us))


def summaries(setting, table):
    with setting.storage._database.read() as connection:
        return connection.execute(select(table).order_by(*table.primary_key.columns)).all()


def change(setting, statement):
    setting.storage._database.write(lambda connection: connection.execute(statement))


def equal(found, wanted, columns):
    """Compare samples: all but the means to the last bit."""
    for column in range(columns):
        one, other = astuple(found.samples(column)), astuple(wanted.samples(column))
        np.testing.assert_allclose(one[2], other[2], rtol=1e-12, atol=1e-12)
        for position in (0, 1, 3, 4, 5, 6):
            np.testing.assert_array_equal(one[position], other[position])


def check_powers(setting, window, count, source=None):
    """Compare samples of powers with those of the rows; the columns are those of the plan."""
    archive = setting.storage.archive
    found, wanted = (SampleBins(window.start_us, window.stop_us, count, 3) for _ in range(2))
    plans = {setting.plan_id: [0, 1, 2]}
    for plan_id, buckets in archive.sampled_measurements(setting.id, window, found, source):
        found.add_summaries(buckets, np.array(plans.get(plan_id, [2, 1, 0])))
    rows = archive.measurements(setting.id, window, 1_000_000, None, source)
    epochs_us = np.array([row.epoch_us for row in rows], dtype=np.int64)
    powers = [row.power_dbm[plans.get(row.plan_id, [2, 1, 0])] for row in rows]
    wanted.add(epochs_us, np.array(powers).reshape(-1, 3))
    equal(found, wanted, 3)
    return found


def check_attitude(setting, window, count, method=Method.ROBUST, version=LIVE):
    """Compare samples of attitude with those of the rows."""
    results = setting.storage.results
    found, wanted = (SampleBins(window.start_us, window.stop_us, count, 3) for _ in range(2))
    for buckets in results.sampled_attitude(setting.id, version, method, window, found):
        found.add_summaries(buckets)
    rows = results.attitude_rows(setting.id, version, method, window, 1_000_000, None)
    epochs_us = np.array([row.epoch_us for row in rows], dtype=np.int64)
    wanted.add(epochs_us, np.array([row.attitude_deg for row in rows]).reshape(-1, 3))
    equal(found, wanted, 3)
    return found


def some_rows(setting, make, dice, plans, step_us, day):
    """Store rows of some hours of a day, of one source under one plan, and the results of most of them."""
    begin_us = day * DAY_US + dice.randrange(20) * 3_600_000_000
    epochs_us = sorted({begin_us + k * step_us + dice.randrange(step_us) for k in range(dice.randint(1, 150))})
    powers = np.round([dice.uniform(-60, -50) for _ in epochs_us], dice.choice([0, 2, 5]))
    powers[np.array([dice.random() < 0.1 for _ in epochs_us])] = np.nan
    plain_id, setting.plan_id = setting.plan_id, dice.choice(plans)
    details = None
    if dice.random() < 0.2:
        details = CarrierDetails(*np.full((4, len(epochs_us), 3), 0.5, dtype=np.float32))
    before = setting.storage.archive.head(setting.id).newest_number
    setting.append(epochs_us, powers, source=dice.choice(["sa-1", "sa-1", "sa-2"]), details=details)
    setting.plan_id = plain_id
    outcomes = []
    for entry in setting.storage.archive.journal(setting.id, before, 1000):
        row = entry.content
        if getattr(row, "feeds_estimator", False) and dice.random() < 0.8:
            angles = NO_ANGLES if dice.random() < 0.1 else Axes(*(dice.choice([0.5, dice.gauss(0, 1)]) for _ in "abc"))
            outcomes.append(Outcome((make.attitude_row(row, attitude_deg=angles),), make.torque_command(row)))
    setting.consume(outcomes)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("step_us", [1_000_000, 47 * 1_000_000, 400 * 1_000_000])
def test_samples_are_those_of_the_rows(setting, make, seed, step_us):
    """Random rows, late rows and ends of sealing, seen through random intervals."""
    dice = random.Random(f"{seed} {step_us}")
    plans = [setting.plan_id, setting.storage.catalogue.put_plan(setting.id, make.carriers[::-1], "turned").id]
    for _ in range(8):
        some_rows(setting, make, dice, plans, step_us, dice.randrange(4))
        if dice.random() < 0.5:
            seal(setting, dice.randrange(5) * DAY_US)
        bounds = sorted(dice.sample(range(4 * DAY_US), 2))
        check_powers(setting, Window(*bounds), dice.randint(1, 60), dice.choice([None, "sa-1"]))
        check_attitude(setting, Window(*bounds), dice.randint(1, 60))
    seal(setting)
    assert summaries(setting, power_summary)
    assert summaries(setting, attitude_summary)
    for count in (1, 3, 7, 96, 997):
        check_powers(setting, Window(0, 4 * DAY_US), count)
        check_attitude(setting, Window(0, 4 * DAY_US), count)


@pytest.fixture
def summed(setting, make):
    """Three days of a row every five minutes, sealed and summarised, with results of the first two."""
    dice = random.Random(5)
    for day in range(3):
        epochs_us = [day * DAY_US + k * STEP_US + 7 for k in range(288)]
        setting.append(epochs_us, np.round([dice.uniform(-60, -50) for _ in epochs_us], 2))
    outcomes = [
        Outcome(
            (make.attitude_row(row, attitude_deg=Axes(*(dice.gauss(0, 1) for _ in "abc"))),), make.torque_command(row)
        )
        for row in setting.rows()
    ]
    setting.consume(outcomes)
    seal(setting)
    return setting


def test_closed_days_are_read_from_summaries(summed, monkeypatch):
    """Neither a segment nor a row of results is opened, and the samples are the same."""
    span = Window(0, 2 * DAY_US)
    plain = [check_powers(summed, span, 50), check_attitude(summed, span, 50)]
    monkeypatch.setattr("db.measurements.power_summaries.read_chunk", None)
    monkeypatch.setattr("db.results.results.SqlResults.attitude_rows", None)
    archive = summed.storage.archive
    powers, angles = (SampleBins(span.start_us, span.stop_us, 50, 3) for _ in range(2))
    for _, buckets in archive.sampled_measurements(summed.id, span, powers):
        powers.add_summaries(buckets)
    for buckets in attitude_summaries.sampled(
        summed.storage._database, archive._database.key(summed.id), "robust", lambda *_: [], span, angles
    ):
        angles.add_summaries(buckets)
    equal(powers, plain[0], 3)
    equal(angles, plain[1], 3)


def test_an_archive_without_summaries_is_answered_from_rows_until_it_has_them(summed):
    wanted = summaries(summed, power_summary)
    change(summed, delete(power_summary))
    change(summed, delete(attitude_summary))
    check_powers(summed, Window(0, 3 * DAY_US), 50)
    check_attitude(summed, Window(0, 3 * DAY_US), 50)
    assert sum(summed.storage.archive.complete_summaries(summed.id)) == 3
    assert list(summed.storage.archive.complete_summaries(summed.id)) == []
    # the day that the chain stands in stays open: two methods and the commands of two days
    assert sum(summed.storage.results.complete_summaries(summed.id, ALWAYS)) == 6
    assert list(summed.storage.results.complete_summaries(summed.id, ALWAYS)) == []
    assert summaries(summed, power_summary) == wanted
    check_attitude(summed, Window(0, 3 * DAY_US), 50)


@pytest.mark.parametrize("column", ["hours", "row_frames"])
@pytest.mark.parametrize("table", [power_summary, attitude_summary])
def test_a_damaged_summary_is_passed_over(summed, caplog, table, column):
    blob = bytearray(getattr(summaries(summed, table)[0], column))
    # of every frame
    blob[4::20] = bytes(byte ^ 1 for byte in blob[4::20])
    name = next(iter(table.primary_key.columns))
    is_it = name == summaries(summed, table)[0][0]
    change(summed, update(table).where(is_it).values({column: bytes(blob)}))
    check_powers(summed, Window(0, 3 * DAY_US), 50)
    for method in Method:
        check_attitude(summed, Window(0, 3 * DAY_US), 50, method)
    assert f"{table.name} " in caplog.text


def test_a_late_row_while_its_day_is_summarised(summed, make, monkeypatch):
    """Rows are read, a late row is stored, and the summary of what was read is not."""
    change(summed, delete(attitude_summary))
    summed.append([DAY_US + 5], -40.0)
    late = next(row for row in summed.rows() if row.epoch_us == DAY_US + 5)
    read = attitude_summaries.day_blobs

    def read_then_late(reader, start_us):
        blobs = read(reader, start_us)
        if start_us == DAY_US:
            summed.consume([Outcome((make.attitude_row(late, attitude_deg=Axes(9.0, 9.0, 9.0)),), None)])
        return blobs

    monkeypatch.setattr(attitude_summaries, "day_blobs", read_then_late)
    list(summed.storage.results.complete_summaries(summed.id, ALWAYS))
    check_powers(summed, Window(0, 3 * DAY_US), 50)
    assert max(check_attitude(summed, Window(0, 3 * DAY_US), 50).samples(0).maxima) == 9.0
    monkeypatch.undo()
    assert sum(summed.storage.results.complete_summaries(summed.id, ALWAYS)) > 0
    check_attitude(summed, Window(0, 3 * DAY_US), 50)


def test_a_summary_that_was_begun_and_never_finished(summed, monkeypatch):
    """A process killed between two transactions leaves a row without bytes: rows are read until it is made."""
    change(summed, delete(attitude_summary))

    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(attitude_summaries, "day_blobs", killed)
    with pytest.raises(KeyboardInterrupt):
        list(summed.storage.results.complete_summaries(summed.id, ALWAYS))
    assert [row.day for row in summaries(summed, attitude_summary)] == [None]
    check_attitude(summed, Window(0, 3 * DAY_US), 50)
    monkeypatch.undo()
    assert sum(summed.storage.results.complete_summaries(summed.id, ALWAYS)) == 6


def test_summaries_go_with_their_rows(summed):
    """Retention: what samples count is what rows and exports show."""
    archive = summed.storage.archive
    for series in ("measurements", "attitude", "torques"):
        list(archive.drop_before(summed.id, series, 2 * DAY_US))
    assert len(summaries(summed, power_summary)) == 1
    assert summaries(summed, attitude_summary) == []
    check_powers(summed, Window(0, 3 * DAY_US), 50)
    check_attitude(summed, Window(0, 3 * DAY_US), 50)


def test_a_version_of_a_replay_is_read_from_its_rows(summed, make):
    rows = summed.rows()[:200]
    summed.consume([Outcome((make.attitude_row(row),), None) for row in rows], "replay-1")
    found = check_attitude(summed, Window(0, 3 * DAY_US), 20, version="replay-1")
    assert found.samples(0).counts.sum() == 200


def test_the_first_count_of_a_process_begins_where_the_last_one_ended(summed, make, monkeypatch):
    """Rows with results are not counted again after a start."""
    summed.calibrate()
    summed.align(5)
    results, methods = summed.storage.results, (Method.ROBUST,)
    results.mark_complete(summed.id, methods)
    head = summed.storage.archive.head(summed.id)
    looked = []
    lacking = "db.results.pending._lacking_rows"
    monkeypatch.setattr(lacking, lambda *arguments: looked.append(arguments[3]) or (0, None))
    monkeypatch.setattr("db.results.pending._lacking_sealed", lambda *_: iter(()))
    results._pending = type(results._pending)()
    assert results.pending(summed.id, methods) == 0
    assert looked == [head.newest_number]
    results._pending = type(results._pending)()
    results.pending(summed.id, tuple(Method))
    assert looked[1] == 0, "of other methods nothing is known"
