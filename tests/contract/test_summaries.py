"""Samples and states read from summaries are those of the rows, whenever days are sealed and met by late rows."""

import math
import random
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from sqlalchemy import delete, select, update

from db.encoding.segments import DAY_US
from db.maintenance.integrity_check import compare_summaries
from db.results import result_samples
from db.results.results import SqlResults
from db.tables import segment, summary
from service.core.rows import GapSearch, RowState, SampleBins
from service.ports.archive import ATTITUDE_FIGURES, LIVE, ListPart, Outcome
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS, Method
from service.records.levels.attitude import NO_ANGLES, Axes, CarrierResults, Exclusion, Status
from service.records.levels.measurement import CarrierDetails

pytestmark = pytest.mark.slow


ALWAYS = 1 << 60
STEP_US = 300_000_000


def seal(setting, before_us=ALWAYS):
    """Seal what is over."""
    list(setting.storage.archive.seal(setting.id, before_us, ALWAYS))
    list(setting.storage.results.seal(setting.id, before_us))


def summaries(setting, quantity):
    """Return the summaries of a quantity by their first epoch."""
    with setting.storage._database.read() as connection:
        query = select(summary, segment.c.first_epoch_us).join(segment).where(summary.c.quantity.startswith(quantity))
        return connection.execute(query.order_by(segment.c.first_epoch_us, segment.c.segment_id)).all()


def is_one(row):
    names = ("segment_id", "quantity", "bin_s")
    return [summary.c[name] == getattr(row, name) for name in names]


def change(setting, statement):
    setting.storage._database.write(lambda connection: connection.execute(statement))


def equal(found, wanted):
    """Compare samples: all but the sums to the last bit."""
    one, other = (bins.all_intervals()._asdict() for bins in (found, wanted))
    np.testing.assert_allclose(one.pop("sums"), other.pop("sums"), rtol=1e-12, atol=1e-9)
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], name)


def check_powers(setting, window, count, source=None):
    """Compare samples of C/N0 and powers with those of the rows; the columns are those of the plan."""
    archive = setting.storage.archive
    plans = {setting.plan_id: [0, 1, 2]}
    rows = archive.measurements(setting.id, ListPart(window, 1_000_000), source)
    epochs_us = np.array([row.epoch_us for row in rows], dtype=np.int64)
    columns = [plans.get(row.plan_id, [2, 1, 0]) for row in rows]
    details = [CarrierDetails(*np.full((4, 3), np.nan)) if row.details is None else row.details for row in rows]
    for figure, those in (("c_n0_db_hz", details), ("power_dbm", rows)):
        found, wanted = (SampleBins(window.start_us, window.stop_us, count, 3) for _ in range(2))
        for plan_id, buckets in archive.sampled_measurements(setting.id, window, found, source, figure):
            found.add_summaries(buckets, np.array(plans.get(plan_id, [2, 1, 0])))
        values = [getattr(each, figure)[of] for each, of in zip(those, columns, strict=True)]
        wanted.add(epochs_us, np.array(values).reshape(-1, 3))
        equal(found, wanted)
    return found


def figures_of(row):
    others = (row.residual_rms_db, row.common_db, row.downlink_fade_db, row.carriers_used, row.control_allowed)
    return [*row.attitude_deg, *row.sigma_deg, *row.protection_deg, *others]


def check_attitude(setting, window, count, method=Method.ROBUST, version=LIVE):
    """Compare samples of attitude and of its carriers with those of the rows."""
    results = setting.storage.results
    rows = results.attitude_rows(setting.id, version, method, ListPart(window, 1_000_000))
    rows = [row for row in rows if row.calibration_id is not None]
    epochs_us = np.array([row.epoch_us for row in rows], dtype=np.int64)
    for columns in (len(ATTITUDE_FIGURES), 3):
        found, wanted = (SampleBins(window.start_us, window.stop_us, count, columns) for _ in range(2))
        for buckets in results.sampled_attitude(setting.id, version, method, window, found, columns):
            found.add_summaries(buckets)
        values = np.array([figures_of(row)[:columns] for row in rows], dtype=np.float64)
        wanted.add(epochs_us, values.reshape(-1, columns))
        equal(found, wanted)
    check_carriers(setting, window, count, method, version)
    return found


def check_carriers(setting, window, count, method, version):
    """Compare samples of deviations and residuals, plan by plan, with those of the rows."""
    results = setting.storage.results
    found, wanted = {}, {}
    grid = SampleBins(window.start_us, window.stop_us, count, 6)
    for plan_id, buckets in results.sampled_carriers(setting.id, version, method, window, grid):
        found.setdefault(plan_id, SampleBins(window.start_us, window.stop_us, count, 6)).add_summaries(buckets)
    for (epoch_us, _), each in results.carrier_results(setting.id, version, method, window).items():
        bins = wanted.setdefault(each.plan_id, SampleBins(window.start_us, window.stop_us, count, 6))
        bins.add(np.array([epoch_us]), np.concatenate((each.deviation_db, each.residual_db))[None])
    for plan_id in found.keys() | wanted.keys():
        none = SampleBins(window.start_us, window.stop_us, count, 6)
        equal(found.get(plan_id, none), wanted.get(plan_id, none))


def carriers_of(dice, row):
    """Return results of the carriers of a row; a fifth of them are absent."""
    levels_db = [[math.nan if dice.random() < 0.2 else dice.gauss(0, 1) for _ in range(3)] for _ in "dr"]
    return CarrierResults(row.plan_id, *np.array(levels_db), *np.zeros((2, 3), dtype=np.int64))


def some_rows(setting, make, dice, plans, step_us, day):
    """Store rows of some hours of a day, of one source under one plan, and the results of most of them."""
    begin_us = day * DAY_US + dice.randrange(20) * 3_600_000_000
    epochs_us = sorted({begin_us + k * step_us + dice.randrange(step_us) for k in range(dice.randint(1, 150))})
    powers = np.round([dice.uniform(-60, -50) for _ in epochs_us], dice.choice([0, 2, 5]))
    powers[np.array([dice.random() < 0.1 for _ in epochs_us])] = np.nan
    plain_id, setting.plan_id = setting.plan_id, dice.choice(plans)
    details = None
    if dice.random() < 0.2:
        stated = np.array([dice.choice([math.nan, dice.uniform(60, 90)]) for _ in range(12 * len(epochs_us))])
        details = CarrierDetails(*stated.astype(np.float32).reshape(4, len(epochs_us), 3))
    before = setting.storage.archive.head(setting.id).newest_number
    setting.append(epochs_us, powers, source=dice.choice(["sa-1", "sa-1", "sa-2"]), details=details)
    setting.plan_id = plain_id
    outcomes = []
    for entry in setting.storage.archive.journal(setting.id, before, 1000):
        row = entry.content
        if getattr(row, "feeds_estimator", False) and dice.random() < 0.8:
            angles = NO_ANGLES if dice.random() < 0.1 else Axes(*(dice.choice([0.5, dice.gauss(0, 1)]) for _ in "abc"))
            carriers = carriers_of(dice, row) if dice.random() < 0.9 else None
            made = make.attitude_row(row, attitude_deg=angles, common_db=dice.gauss(0, 1))
            outcomes.append(Outcome((made,), make.torque_command(row), carriers=(carriers,)))
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
    assert all(summaries(setting, quantity) for quantity in ("power_dbm", "attitude", "carriers"))
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
            (make.attitude_row(row, attitude_deg=Axes(*(dice.gauss(0, 1) for _ in "abc"))),),
            make.torque_command(row),
            carriers=(carriers_of(dice, row),),
        )
        for row in setting.rows()
    ]
    setting.consume(outcomes)
    seal(setting)
    return setting


def test_sealed_days_are_read_from_summaries(summed, monkeypatch):
    """Of intervals that are whole hours neither a segment is opened nor a row read, and the samples are the same."""
    span = Window(0, 2 * DAY_US)
    plain = [check_powers(summed, span, 48), check_attitude(summed, span, 48)]
    monkeypatch.setattr("db.measurements.measurement_pages.read_chunk", None)
    monkeypatch.setattr("db.results.result_samples.read_results", None)
    powers, angles = (SampleBins(span.start_us, span.stop_us, 48, 3) for _ in range(2))
    for _, buckets in summed.storage.archive.sampled_measurements(summed.id, span, powers):
        powers.add_summaries(buckets)
    for buckets in summed.storage.results.sampled_attitude(summed.id, LIVE, Method.ROBUST, span, angles):
        angles.add_summaries(buckets)
    equal(powers, plain[0])
    equal(angles, plain[1])
    hours = SampleBins(span.start_us, span.stop_us, 48, 6)
    for _, buckets in summed.storage.results.sampled_carriers(summed.id, LIVE, Method.ROBUST, span, hours):
        hours.add_summaries(buckets)
    assert int(hours.all_intervals().counts.sum()) > 2 * 288 * 6 * 0.7


def test_rows_closer_than_twenty_seconds_have_minutes(setting, monkeypatch):
    setting.append(range(0, 3_600_000_000, 10_000_000), np.arange(360) / 100)
    seal(setting)
    assert {row.bin_s for row in summaries(setting, "power_dbm")} == {60, 3600}
    plain = check_powers(setting, Window(0, 3_600_000_000), 30)
    monkeypatch.setattr("db.measurements.measurement_pages.read_chunk", None)
    powers = SampleBins(0, 3_600_000_000, 30, 3)
    for _, buckets in setting.storage.archive.sampled_measurements(setting.id, Window(0, 3_600_000_000), powers):
        powers.add_summaries(buckets)
    equal(powers, plain)


def test_c_n0_of_sealed_days_is_read_from_summaries(setting, monkeypatch):
    """A day without any says nothing, and its rows are not opened for that."""
    for day in range(2):
        epochs_us = [day * DAY_US + k * STEP_US for k in range(288)]
        stated = np.array([math.nan, 80.0, 81.5], dtype=np.float32) * np.ones((4, 288, 1), dtype=np.float32)
        setting.append(epochs_us, details=CarrierDetails(*stated) if day else None)
    seal(setting)
    monkeypatch.setattr("db.measurements.measurement_pages.read_chunk", None)
    hours = SampleBins(0, 2 * DAY_US, 48, 3)
    read = setting.storage.archive.sampled_measurements(setting.id, Window(0, 2 * DAY_US), hours, None, "c_n0_db_hz")
    for _, buckets in read:
        hours.add_summaries(buckets)
    samples = hours.all_intervals()
    assert samples.counts.tolist() == 24 * [[0, 0, 0]] + 24 * [[0, 12, 12]]
    assert set(samples.sums[24:, 2]) == {12 * 81.5}


def test_an_archive_without_summaries_is_answered_from_rows(summed):
    change(summed, delete(summary))
    for count in (48, 50):
        check_powers(summed, Window(0, 3 * DAY_US), count)
        check_attitude(summed, Window(0, 3 * DAY_US), count)


@pytest.mark.parametrize("is_agreeing", [False, True])
@pytest.mark.parametrize("quantity", ["power_dbm", "attitude", "carriers"])
def test_a_damaged_summary_is_passed_over(summed, caplog, quantity, is_agreeing):
    """One that differs from its checksum, and one that holds something else."""
    first, *_ = summaries(summed, quantity)
    values = {**first._asdict(), "content": first.content[:40] + bytes([first.content[40] ^ 1]) + first.content[41:]}
    if is_agreeing:
        values["content"] = first.content[: len(first.content) // 2]
        change(summed, delete(summary).where(*is_one(first)))
        names = ("segment_id", "quantity", "bin_s", "content")
        change(summed, summary.insert().values({name: values[name] for name in names}))
    else:
        change(summed, update(summary).where(*is_one(first)).values(content=values["content"]))
    for count in (1, 50, 72):
        check_powers(summed, Window(0, 3 * DAY_US), count)
        for method in LIVE_METHODS:
            check_attitude(summed, Window(0, 3 * DAY_US), count, method)
    assert f"summary of segment {first.segment_id} is damaged" in caplog.text


@pytest.mark.parametrize("quantity", ["power_dbm", "attitude", "carriers", "states", "impulse"])
def test_the_doctor_compares_summaries_with_their_rows(summed, quantity):
    database = summed.storage._database

    def diagnosed():
        with database.read() as connection:
            return next(compare_summaries(connection, database.key(summed.id), "craft"))

    assert diagnosed().state == "ok"
    first, second, *_ = (row for row in summaries(summed, quantity) if row.first_epoch_us < 2 * DAY_US)
    assert first.first_epoch_us < DAY_US <= second.first_epoch_us
    change(summed, update(summary).where(*is_one(second)).values(content=first.content))
    assert diagnosed().state == "fault"
    assert diagnosed().detail.endswith("differ from their rows: 1970-01-02")


def test_a_late_row_makes_the_bins_of_its_day_again(summed, make):
    """Rows and bins are written in one transaction: what samples count is what rows show, before and after it."""
    summed.append([DAY_US + 5], -40.0)
    late = next(row for row in summed.rows() if row.epoch_us == DAY_US + 5)
    summed.consume([Outcome((make.attitude_row(late, attitude_deg=Axes(9.0, 9.0, 9.0)),), None)])
    for _ in range(2):
        for count in (50, 72):
            check_powers(summed, Window(0, 3 * DAY_US), count)
            found = check_attitude(summed, Window(0, 3 * DAY_US), count)
            assert found.all_intervals().maxima[:, 0].max() == 9.0
        seal(summed)
    assert len(summaries(summed, "power_dbm")) == 3


def test_summaries_go_with_their_rows(summed):
    """Retention: what samples count is what rows and exports show."""
    archive = summed.storage.archive
    for series in ("measurements", "attitude", "torques"):
        list(archive.drop_before(summed.id, series, 2 * DAY_US))
    assert {len(summaries(summed, quantity)) for quantity in ("power_dbm", "attitude", "carriers", "impulse")} == {1}
    check_powers(summed, Window(0, 3 * DAY_US), 72)
    check_attitude(summed, Window(0, 3 * DAY_US), 72)


def test_a_version_of_a_replay_is_sampled_as_the_live_one(summed, make):
    rows = summed.rows()[:200]
    summed.consume([Outcome((make.attitude_row(row),), None) for row in rows], "replay-1")
    for _ in range(2):
        found = check_attitude(summed, Window(0, 3 * DAY_US), 72, version="replay-1")
        assert found.all_intervals().counts[:, 0].sum() == 200
        seal(summed)


DAYS = 4


def states_of(row):
    """Return the states of a row."""
    found = {RowState("status", row.status.value)}
    found |= {RowState("control", "allowed")} if row.control_allowed else set()
    found |= {RowState("inhibition", name) for name in row.inhibitions} | {
        RowState("advice", name) for name in row.advice
    }
    found |= {RowState("fade", "downlink")} if row.downlink_fade else set()
    return found | {RowState("exclusion", each.reason, each.carrier) for each in row.excluded}


def rows_of(setting):
    span = Window(0, DAYS * DAY_US)
    return setting.storage.results.attitude_rows(setting.id, LIVE, Method.ROBUST, ListPart(span, 99_999))


def check(setting):
    """Compare states and gaps of all days with those found row by row."""
    rows = rows_of(setting)
    span = Window(rows[0].epoch_us, rows[-1].epoch_us + 1)
    found = setting.storage.results.state_history(setting.id, Method.ROBUST, span)
    wanted, running = [], {}
    for row in rows:
        held = states_of(row)
        wanted += [(state, *running.pop(state)) for state in set(running) - held]
        for state in held:
            start_us, _, count = running.get(state, (row.epoch_us, 0, 0))
            running[state] = (start_us, row.epoch_us, count + 1)
    wanted += [(state, *ends) for state, ends in running.items()]
    assert [tuple(run) for run in found.runs] == sorted(wanted, key=lambda run: (run[1], run[0]))
    if summaries(setting, "states"):
        search = GapSearch()
        # rows have one distance, so that of a day is that of all
        gaps = [*search.add(np.array([row.epoch_us for row in rows])), *search.end()]
        assert found.gaps == gaps


def state_some_rows(setting, make, dice, day, results=0.9):
    """Store rows of some hours of a day, and results of most of them."""
    first = day * 288 + dice.randrange(200)
    epochs_us = [STEP_US * (first + k) for k in range(dice.randint(1, 88)) if dice.random() < 0.9]
    before = setting.storage.archive.head(setting.id).newest_number
    setting.append(epochs_us, np.full(len(epochs_us), -50.0))
    state, outcomes = {}, []
    for entry in setting.storage.archive.journal(setting.id, before, 1000):
        if dice.random() < 0.2:
            state = {
                "status": dice.choice([Status.ACQUIRED, Status.INVALID]),
                "control_allowed": dice.random() < 0.5,
                "inhibitions": tuple(dice.sample(["fade", "sigma", "operation"], dice.randrange(3))),
                "advice": ("realign",) if dice.random() < 0.2 else (),
                "downlink_fade": dice.random() < 0.3,
                "excluded": (Exclusion("c01", "step"),) if dice.random() < 0.3 else (),
            }
        if dice.random() < results:
            outcomes.append(Outcome((replace(make.attitude_row(entry.content), **state),), None))
    setting.consume(outcomes)


@pytest.mark.parametrize("seed", range(3))
def test_states_are_those_of_the_rows(setting, make, seed):
    dice = random.Random(seed)
    for _ in range(8):
        state_some_rows(setting, make, dice, dice.randrange(DAYS))
        if dice.random() < 0.6:
            seal(setting, dice.randrange(DAYS + 1) * DAY_US)
        check(setting)
    state_some_rows(setting, make, dice, DAYS - 1)
    seal(setting)
    assert summaries(setting, "states")
    check(setting)


@pytest.fixture
def state_summed(setting, make):
    """Four days of rows that all have results, three of them sealed."""
    dice = random.Random(7)
    for day in range(DAYS):
        state_some_rows(setting, make, dice, day, results=1.0)
    seal(setting, 3 * DAY_US)
    return setting


def test_sealed_days_are_read_from_their_states(state_summed, monkeypatch):
    span = Window(rows_of(state_summed)[0].epoch_us, 3 * DAY_US)
    wanted = state_summed.storage.results.state_history(state_summed.id, Method.ROBUST, span)
    assert wanted.runs
    monkeypatch.setattr(SqlResults, "attitude_rows", lambda *_, **__: [])
    assert state_summed.storage.results.state_history(state_summed.id, Method.ROBUST, span) == wanted


def test_damaged_or_missing_states_are_passed_over(state_summed):
    first, second, *_ = summaries(state_summed, "states")
    damaged = bytes([*first.content[:-1], first.content[-1] ^ 1])
    change(state_summed, update(summary).where(*is_one(first)).values(content=damaged))
    change(state_summed, delete(summary).where(*is_one(second)))
    check(state_summed)


def test_days_whose_measurements_were_dropped_are_read_from_their_states(state_summed, monkeypatch):
    wanted = rows_of(state_summed)
    list(state_summed.storage.archive.drop_before(state_summed.id, "measurements", 2 * DAY_US))
    assert rows_of(state_summed) == wanted
    check(state_summed)


@pytest.mark.parametrize("most", [0, 1, 40, 300])
def test_rows_without_states_are_read_up_to_a_bound_and_the_rest_is_stated(state_summed, monkeypatch, most):
    """The first and the last day have no summary; what is given is what the given spans hold by themselves."""
    first, *_ = summaries(state_summed, "states")
    change(state_summed, delete(summary).where(*is_one(first)))
    rows = rows_of(state_summed)
    span = Window(rows[0].epoch_us, rows[-1].epoch_us + 1)
    history = partial(state_summed.storage.results.state_history, state_summed.id, Method.ROBUST)
    whole = history(span)
    monkeypatch.setattr(result_samples, "MOST_ROWS", most)
    found = history(span)
    ends = [span.start_us, *(end for part in found.left_out_us for end in part), span.stop_us]
    given = [Window(*part) for part in zip(ends[::2], ends[1::2], strict=True) if part[0] < part[1]]
    unread = [row for row in rows if not DAY_US <= row.epoch_us < 3 * DAY_US]
    left_out = [row for row in rows if any(start <= row.epoch_us < stop for start, stop in found.left_out_us)]
    assert [row for row in left_out if row not in unread] == []
    # rows of one epoch stand together
    assert len(unread) - len(left_out) <= most
    assert left_out == unread[: len(left_out)]
    monkeypatch.undo()
    parts = [history(part) for part in given]
    assert found.runs == [run for part in parts for run in part.runs]
    assert found.gaps == [gap for part in parts for gap in part.gaps]
    assert whole.left_out_us == []


def test_an_open_day_of_more_rows_costs_no_more_than_the_bound(setting, make, monkeypatch):
    """Four times the rows of the newest day, and one bound: processor time stays, where all rows would cost four."""
    monkeypatch.setattr(result_samples, "MOST_ROWS", 500)
    taken_s = []
    for day, count in ((0, 1000), (1, 8000)):
        span = Window(day * DAY_US, day * DAY_US + count * 10_000_000)
        before = setting.storage.archive.head(setting.id).newest_number
        setting.append(list(range(span.start_us, span.stop_us, 10_000_000)), np.full(count, -50.0))
        entries = setting.storage.archive.journal(setting.id, before, 10_000)
        setting.consume([Outcome((make.attitude_row(entry.content),), None) for entry in entries])
        found = []
        for _ in range(5):
            began_s = time.process_time()
            history = setting.storage.results.state_history(setting.id, Method.ROBUST, span)
            found.append(time.process_time() - began_s)
            assert history.left_out_us == [(span.start_us, span.stop_us - 5_000_000_000 - 9_999_999)]
        taken_s.append(min(found))
    assert taken_s[1] < 3 * taken_s[0]
