"""Every storage answers the same before, while and after days are sealed, whenever that happens."""

import random
import re
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from block_rows import row_sources
from sqlalchemy import select, update

from db import sealing
from db.columns import checksum_of
from db.encoding.column_blob import pack_columns
from db.encoding.segments import DAY_US, SegmentCache, heads_where, of_measurements
from db.maintenance.integrity_check import examine_content
from db.storage import SqlStorage
from db.tables import measurement, segment
from service.core.rows import SampleBins
from service.errors import StorageError
from service.ports.archive import LIVE, ListPart, Outcome
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS, Method
from service.records.inputs import Correction
from service.records.levels.attitude import Axes, CarrierResults
from service.records.levels.measurement import CarrierDetails

#: two days and a bit: no row is older than the spacecraft
DAYS = 3
STEP_US = DAY_US // 8
ALWAYS = 1 << 60


def seal(setting, before_us=ALWAYS, received_before_us=ALWAYS):
    return list(setting.storage.archive.seal(setting.id, before_us, received_before_us))


def rows_in_table(setting):
    with setting.storage._database.read() as connection:
        return len(connection.execute(select(measurement.c.number)).all())


def segments(setting):
    """Return the heads of the sealed measurements."""
    database = setting.storage._database
    with database.read() as connection:
        return list(heads_where(connection, *of_measurements(database.key(setting.id))))


def flat(value):
    """Return anything as text that tells every bit of it."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(flat, value))}]"
    if hasattr(value, "__slots__"):
        # a digest covers the id of the spacecraft
        names = [name for name in value.__slots__ if name != "digest"]
        return f"{type(value).__name__}({', '.join(flat(getattr(value, name)) for name in names)})"
    return repr(value)


def blocks(archive, name, window, **options):
    """Return the rows of blocks without their division."""
    return [
        (source, block.plan_id, epoch_us, powers.tobytes())
        for block in archive.measurement_blocks(name, window, **options)
        for source, epoch_us, powers in zip(row_sources(block), block.epochs_us.tolist(), block.power_dbm, strict=True)
    ]


def pages(archive, name, window, limit, source=None) -> Iterator[str]:
    after = None
    while page := archive.measurements(name, ListPart(window, limit, after), source):
        yield flat(page)
        after = page[-1].epoch_us, page[-1].number


def answers(setting, windows, methods=LIVE_METHODS) -> dict[str, str]:
    """Return what every method of the ports says, as text."""
    archive, results, name = setting.storage.archive, setting.storage.results, setting.id
    newest = archive.head(name).newest_number
    found: dict[str, object] = {
        "head": archive.head(name),
        "sources": archive.sources(name),
        "newest": archive.newest_measurement(name),
        "journal": archive.journal(name, 0, 10_000),
        "journal by parts": [archive.journal(name, after, 25) for after in range(0, newest, 25)],
        "pending": [results.pending(name, chosen) for chosen in ([Method.PAPER], list(methods))],
        # counted from the beginning, as after a restart
        "attitude now": [results.newest_attitude(name, "live", method) for method in methods],
    }
    for window in windows:
        found[f"plans {window}"] = archive.plan_ids(name, window)
        found[f"pages {window}"] = list(pages(archive, name, window, 5))
        found[f"all {window}"] = archive.measurements(name, ListPart(window, 10_000))
        found[f"second {window}"] = list(pages(archive, name, window, 3, "sa-2"))
        found[f"after {window}"] = list(archive.measurements_after(name, window.start_us, newest - 3))
        found[f"series {window}"] = archive.measurement_series(name, window, ["c02", "none", "c00"])
        found[f"blocks {window}"] = blocks(archive, name, window)
        found[f"feeding {window}"] = blocks(archive, name, window, source="sa-1", feeds_estimator_only=True)
        for method in methods:
            found[f"attitude {method} {window}"] = results.attitude_rows(name, "live", method, ListPart(window, 10_000))
            found[f"some attitude {method} {window}"] = results.attitude_rows(name, "live", method, ListPart(window, 4))
    return {question: flat(answer) for question, answer in found.items()}


def some_batch(setting, make, dice, plans):
    """Append rows of random places, some with flags, some with details, some known already."""
    count = dice.randint(1, 12)
    positions = [dice.randint(0, 8 * DAYS - 1) for _ in range(count)]
    epochs_us = [position * STEP_US + dice.choice([0, 0, 1]) for position in positions]
    powers = [dice.choice([-50.25, -51.0, float("nan"), -0.0]) for _ in positions]
    flags = [dice.choice([None, (0, 16, 1 << 22)]) for _ in positions] if dice.random() < 0.5 else None
    details = None
    if dice.random() < 0.5:
        figures = np.arange(4 * count * 3, dtype=np.float32).reshape(4, count, 3) + np.float32(0.1)
        figures[dice.randrange(4)] = np.nan
        figures[:, dice.randrange(count)] = np.nan
        details = CarrierDetails(*figures)
    setting.plan_id = dice.choice(plans)
    return setting.append(
        epochs_us,
        powers,
        source=dice.choice(["sa-1", "sa-2"]),
        flags=flags,
        details=details,
        is_stale=[dice.random() < 0.2 for _ in positions],
        first_seq=dice.choice([None, dice.randrange(1000)]),
    )


@pytest.mark.parametrize("seed", range(3))
def test_sealing_at_random_moments_changes_no_answer(new_setting, make, monkeypatch, seed):
    """Two spacecraft live the same life; days of one are sealed again and again, into segments of few rows."""
    monkeypatch.setitem(sealing.SEGMENT_ROWS, "measurement", 3 if seed % 2 else 10_800)
    monkeypatch.setattr("db.measurements.archive.BLOCK_PAGE_ROWS", 5)
    plain, sealed = new_setting(), new_setting()
    lives = []
    for setting in (plain, sealed):
        plans = [setting.plan_id, setting.storage.catalogue.put_plan(setting.id, make.carriers[::-1], "turned").id]
        lives.append((setting, random.Random(seed), plans))
    dice = random.Random(1000 + seed)
    moved = 0
    for step in range(16):
        receipts = [some_batch(setting, make, thrown, plans) for setting, thrown, plans in lives]
        assert receipts[0] == receipts[1], f"seed {seed} step {step}"
        if step == 5:
            for setting in (plain, sealed):
                setting.calibrate()
                setting.align(STEP_US * 9)
        if step == 9:
            for setting in (plain, sealed):
                setting.storage.archive.select_source(setting.id, "sa-2")
                setting.storage.archive.append_inputs(setting.id, [Correction(1, 2, Axes(0.1, 0.2, 0.3))])
        if dice.random() < 0.5:
            wanted = dice.random()
            for setting in (plain, sealed):
                rows = [row for row in setting.rows() if row.feeds_estimator]
                chosen = rows[: int(wanted * len(rows))]
                setting.consume([Outcome((make.attitude_row(row),), make.torque_command(row)) for row in chosen])
        if dice.random() < 0.6:
            moved += sum(part.rows for part in seal(sealed, before_us=dice.randint(0, DAYS) * DAY_US + 5))
    moved += sum(part.rows for part in seal(sealed, before_us=DAYS * DAY_US))
    stops = sorted(dice.sample(range(-1, DAYS * DAY_US + 2), 4))
    windows = [make.ever, Window(DAY_US, 2 * DAY_US), Window(stops[0], stops[2]), Window(stops[1], stops[3])]
    said = [answers(setting, windows) for setting in (plain, sealed)]
    names = sealed.id, plain.id
    for question, answer in said[0].items():
        assert said[1][question].replace(*names) == answer, f"seed {seed}: {question}"
    assert moved == len(plain.rows())
    assert len(segments(sealed)) > 2
    # the same archive opened again: nothing that was remembered helped
    reopened = SqlStorage(sealed.storage._database.engines.write.url.render_as_string(hide_password=False))
    sealed.storage = reopened
    assert answers(sealed, windows) == said[1]
    reopened.close()


def test_open_days_and_days_that_still_receive_stay_rows(setting):
    setting.append([0, STEP_US, DAY_US, DAY_US + 1])
    assert seal(setting, received_before_us=77) == [], "received at 77, so more may be coming"
    (part,) = seal(setting, before_us=2 * DAY_US - 1)
    assert (part.source, part.rows, part.first_epoch_us, part.last_epoch_us) == ("sa-1", 2, 0, STEP_US)
    assert rows_in_table(setting) == 2
    assert seal(setting, before_us=2 * DAY_US - 1) == []
    assert [part.rows for part in seal(setting, before_us=2 * DAY_US)] == [2]
    assert rows_in_table(setting) == 0
    assert len(setting.rows()) == 4


def test_late_rows_are_merged_on_reading_and_go_into_the_segment_later(setting):
    setting.append([10, 30], [-1.0, -3.0])
    seal(setting)
    setting.append([20, 40, 5], [-2.0, -4.0, -0.5])
    assert [row.epoch_us for row in setting.rows()] == [5, 10, 20, 30, 40]
    (part,) = seal(setting)
    assert (part.rows, part.rows_of_segments) == (3, 5)
    assert rows_in_table(setting) == 0
    assert [row.power_dbm[0] for row in setting.rows()] == [-0.5, -1.0, -2.0, -3.0, -4.0]
    assert len(segments(setting)) == 1


def test_a_busy_day_is_several_segments(setting, monkeypatch):
    monkeypatch.setitem(sealing.SEGMENT_ROWS, "measurement", 10)
    setting.append(range(0, 64, 2))
    assert [part.rows for part in seal(setting)] == [10, 10, 10, 2]
    setting.append(range(1, 40, 2))
    seal(setting)
    assert [row.epoch_us for row in setting.rows()] == [*range(40), *range(40, 64, 2)]
    sizes = [head.row_count for head in segments(setting)]
    assert sum(sizes) == 52
    assert max(sizes) <= 15


def test_rows_stored_while_a_day_is_packed_are_not_lost(setting, monkeypatch):
    setting.append([10, 30])
    before = sealing.carry_out

    def carry_out(connection, change):
        # comes between the reading of the rows and the writing of the segment
        connection.exec_driver_sql("UPDATE head SET newest_number = newest_number + 1")
        row = dict(connection.execute(select(measurement).limit(1)).mappings().one())
        late = {**row, "epoch_us": 20, "number": row["number"] + 2, "checksum": None}
        connection.execute(measurement.insert().values(late))
        return before(connection, change)

    monkeypatch.setattr(sealing, "carry_out", carry_out)
    assert next(setting.storage.archive.seal(setting.id, ALWAYS, ALWAYS)).rows == 2
    assert [row.epoch_us for row in setting.rows()] == [10, 20, 30]
    assert rows_in_table(setting) == 1


def test_two_processes_that_seal_the_same_day_make_one_segment(setting, url, monkeypatch):
    setting.append([10, 20])
    other = SqlStorage(url)
    before = sealing.carry_out

    def carry_out(connection, change):
        monkeypatch.setattr(sealing, "carry_out", before)
        assert before(connection, change)
        # the other process had read the same rows
        return before(connection, change)

    monkeypatch.setattr(sealing, "carry_out", carry_out)
    assert list(other.archive.seal(setting.id, ALWAYS, ALWAYS)) == []
    other.close()
    assert [row.epoch_us for row in setting.rows()] == [10, 20]
    assert [head.row_count for head in segments(setting)] == [2]


@pytest.mark.parametrize("column", ["content", "row_count", "checksum", "first_number", "feeding_count"])
def test_a_damaged_segment_is_told_and_touches_no_other_day(setting, make, column):
    for day in range(3):
        setting.append([day * DAY_US + 5, day * DAY_US + 6], flags=[(1, 2, 3), None])
    seal(setting)
    damage(setting, DAY_US + 5, column)
    archive = setting.storage.archive
    with pytest.raises(StorageError) as caught:
        archive.measurements(setting.id, ListPart(make.ever, 99))
    assert caught.value.code == "storage.corrupt"
    assert setting.id in caught.value.detail
    assert "1970-01-02" in caught.value.detail
    for calls in (
        lambda: list(archive.measurement_blocks(setting.id, make.ever)),
        lambda: setting.append([DAY_US + 5]),
    ):
        with pytest.raises(StorageError, match=r"storage\.corrupt"):
            calls()
    assert len(archive.measurements(setting.id, ListPart(Window(0, DAY_US), 99))) == 2
    assert len(archive.measurements(setting.id, ListPart(Window(2 * DAY_US, 3 * DAY_US), 99))) == 2
    assert archive.newest_measurement(setting.id).epoch_us == 2 * DAY_US + 6
    assert {words for check, words in diagnosed(setting) if check == "segments"} == {"1970-01-02"}
    # late rows of the damaged day are taken in, wait in the table of rows, and let other days be sealed
    assert setting.append([DAY_US + 9, 9]).accepted == 2
    assert [part.rows for part in seal(setting)] == [1]
    assert rows_in_table(setting) == 1


def diagnosed(setting):
    """Return the checks of the doctor that find a fault, and the day that each names."""
    with setting.storage._database.read() as connection:
        found = [each for each in examine_content(connection, lambda _: None) if each.state == "fault"]
    days = (re.search(r"1970-01-\d\d", each.detail) for each in found)
    return [(each.check, day and day.group()) for each, day in zip(found, days, strict=True)]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda blob: blob[: len(blob) // 2],
        lambda blob: blob[:-1],
        lambda _: b"",
        lambda _: pack_columns({"a": [1, 2]}),
        lambda _: pack_columns({"epoch_us": ["a", "b"], "number": [1, 2]}),
        lambda _: pack_columns({"epoch_us": [1, 2, 3]}),
    ],
    ids=["cut", "cut in the footer", "empty", "another schema", "other types", "more rows than its head says"],
)
def test_a_blob_under_a_right_checksum_that_is_no_such_day_is_told(setting, make, spoil):
    for day in range(3):
        setting.append([day * DAY_US + 5, day * DAY_US + 6], flags=[(1, 2, 3), None])
    seal(setting)
    head = next(head for head in segments(setting) if head.day == 1)
    is_it = segment.c.segment_id == head.segment_id
    with setting.storage._database.engines.write.begin() as connection:
        blob = spoil(connection.scalar(select(segment.c.content).where(is_it)))
        checksum = checksum_of(segment, {**head._asdict(), "content": blob})
        connection.execute(update(segment).where(is_it).values(content=blob, checksum=checksum))
    setting.storage._database.segments = SegmentCache()
    archive = setting.storage.archive
    with pytest.raises(StorageError, match=r"storage\.corrupt.*1970-01-02"):
        archive.measurements(setting.id, ListPart(make.ever, 99))
    for window in (Window(0, DAY_US), Window(2 * DAY_US, 3 * DAY_US)):
        assert len(archive.measurements(setting.id, ListPart(window, 99))) == 2
    assert ("segments", "1970-01-02") in diagnosed(setting)


def damage(setting, first_epoch_us, column):
    """Change one thing of a segment, behind the back of the cache."""
    is_it = segment.c.first_epoch_us == first_epoch_us
    with setting.storage._database.engines.write.begin() as connection:
        found = connection.scalar(select(segment.c[column]).where(is_it))
        changed = found + 1 if isinstance(found, int) else found[:-1] + bytes([found[-1] ^ 1])
        connection.execute(update(segment).where(is_it).values({column: changed}))
    setting.storage._database.segments = SegmentCache()


READ_STEP_US = DAY_US // 50
SPAN = Window(0, 2 * DAY_US)
LATE = 60


def results_of(make, row):
    """Return the results of a row: all its values are its epoch, s."""
    value = row.epoch_us / 1e6
    levels_db = np.full((2, 3), (row.epoch_us // 1000) % 100 * 0.004)
    carriers = CarrierResults(row.plan_id, *levels_db, *np.zeros((2, 3), dtype=np.int64))
    return Outcome((make.attitude_row(row, attitude_deg=Axes(value, value, value)),), None, carriers=(carriers,))


def counts(setting):
    """Return how many rows samples and rows of each kind count, in the order in which they are stored."""
    results = setting.storage.results
    angles, levels, powers = (SampleBins(SPAN.start_us, SPAN.stop_us, 7, 3) for _ in range(3))
    for buckets in results.sampled_carriers(setting.id, LIVE, Method.ROBUST, SPAN, levels):
        levels.add_summaries(buckets.buckets.columns(slice(3)))
    for buckets in results.sampled_attitude(setting.id, LIVE, Method.ROBUST, SPAN, angles):
        angles.add_summaries(buckets)
    for sampled in setting.storage.archive.sampled_measurements(setting.id, SPAN, powers):
        powers.add_summaries(sampled.buckets)
    samples = angles.all_intervals()
    is_filled = samples.counts > 0
    # of each row the value is its epoch: a row that is counted twice, or with another one's value, changes these
    np.testing.assert_array_equal(samples.maxima[is_filled], samples.maximum_us[is_filled] / 1e6)
    np.testing.assert_array_equal(samples.minima[is_filled], samples.minimum_us[is_filled] / 1e6)
    return [int(bins.all_intervals().counts[:, 0].sum()) for bins in (levels, angles, powers)]


@pytest.mark.slow
def test_samples_are_those_of_a_moment(setting, make):
    epochs_us = [k * READ_STEP_US + 7 for k in range(130)]
    setting.append(epochs_us, -50.0)
    setting.consume([results_of(make, row) for row in setting.rows()])
    known = sum(epoch_us < SPAN.stop_us for epoch_us in epochs_us)
    stored, is_over, faults = [known], threading.Event(), []

    def run(work):
        def guarded():
            try:
                while not is_over.is_set():
                    work()
            except BaseException as fault:
                faults.append(fault)
                raise

        return threading.Thread(target=guarded)

    def seal():
        list(setting.storage.archive.seal(setting.id, ALWAYS, ALWAYS))
        list(setting.storage.results.seal(setting.id, ALWAYS))

    def late():
        k = len(stored)
        epoch_us = k * (SPAN.stop_us // (LATE + 2)) + 11
        setting.append([epoch_us], -50.0)
        (row,) = setting.storage.archive.measurements(setting.id, ListPart(Window(epoch_us, epoch_us + 1), 9))
        setting.consume([results_of(make, row)])
        stored.append(known + k)
        if k == LATE:
            is_over.set()

    def read():
        before = stored[-1]
        found = counts(setting)
        # what was stored when it began, and at most what was stored when it ended, the row under way among it
        assert all(before <= count <= stored[-1] + 1 for count in found), (before, found, stored[-1])

    threads = [run(work) for work in (seal, late, read, read)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(300)
    assert faults == []
    assert counts(setting) == [known + LATE] * 3
    seal()
    assert counts(setting) == [known + LATE] * 3
