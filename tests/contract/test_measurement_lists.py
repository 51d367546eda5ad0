"""Measurements as blocks, of a span, from the end, numbered by their source, dropped by age, in any stored form."""

import random
import tracemalloc
from dataclasses import replace
from itertools import pairwise
from threading import Event

import numpy as np
import pytest
from block_rows import row_sources
from sqlalchemy import select
from stored_records import ALARM, AUDIT_EVENT, COMMAND

from db.encoding.segments import DAY_US, SegmentCache
from db.measurements.ingest import StoreBatch, prepare
from db.tables import head, measurement, sequence_interval, source
from service.errors import NotFoundError
from service.ports.archive import LIVE, ListPart, Outcome
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.inputs import AttitudeReference, Operation
from service.records.levels.attitude import Axes
from service.records.levels.measurement import CarrierDetails, Ring, Trace, TraceSettings
from service.records.operations.access import AuditFilter
from service.records.operations.alarms import AlarmChange, ChangeKind, Note
from service.records.operations.release import ReleaseChange
from service.records.operations.work import Replay


def reported(setting, window, **options):
    """Return (source, plan, epoch, powers as bytes) of the rows of all blocks, in order."""
    found = []
    for block in setting.storage.archive.measurement_blocks(setting.id, window, **options):
        assert block.power_dbm.dtype == np.float32
        assert block.power_dbm.shape[0] == len(block.epochs_us) > 0
        rows = zip(row_sources(block), block.epochs_us.tolist(), block.power_dbm, strict=True)
        found += [(source, block.plan_id, epoch_us, powers.tobytes()) for source, epoch_us, powers in rows]
    return found


def expected(rows):
    return [(row.source, row.plan_id, row.epoch_us, row.power_dbm.astype(np.float32).tobytes()) for row in rows]


def test_blocks_hold_the_rows_in_order_of_epoch(setting, make, monkeypatch):
    # pages of three rows: runs and pages end in different places
    monkeypatch.setattr("db.measurements.archive.BLOCK_PAGE_ROWS", 3)
    setting.append([40, 10, 20], [-4.0, -1.0, float("nan")])
    setting.append([20, 30, 15], [-2.5, -3.5, -1.5], source="sa-2")
    setting.plan_id = setting.storage.catalogue.put_plan(setting.id, make.carriers[::-1], "turned").id
    setting.append([50, 5], [-5.0, -0.5])
    assert reported(setting, make.ever) == expected(setting.rows())
    assert [row[2] for row in reported(setting, Window(10, 40))] == [10, 15, 20, 20, 30]
    assert [row[2] for row in reported(setting, make.ever, source="sa-2")] == [15, 20, 30]
    assert [row[2] for row in reported(setting, make.ever, feeds_estimator_only=True)] == [5, 10, 20, 40, 50]
    assert reported(setting, Window(60, 70)) == []


def test_rows_of_one_source_under_one_plan_make_one_block(setting, make):
    setting.append(range(100))
    (block,) = setting.storage.archive.measurement_blocks(setting.id, make.ever)
    assert block.power_dbm.shape == (100, 3)
    for array in (block.power_dbm, block.epochs_us):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_sources_that_take_turns_row_by_row_make_few_blocks(setting, make):
    for name, first in (("sa-1", 0), ("sa-2", 1), ("sa-3", 2)):
        setting.append(range(first, 600, 3), source=name)
    blocks = list(setting.storage.archive.measurement_blocks(setting.id, make.ever))
    assert len(blocks) == 1
    assert reported(setting, make.ever) == expected(setting.rows())
    assert row_sources(blocks[0])[:4] == ["sa-1", "sa-2", "sa-3", "sa-1"]
    assert row_sources(blocks[0].part(100, 102)) == ["sa-2", "sa-3"]


def test_an_unknown_spacecraft_is_told_before_the_first_block(storage, make):
    with pytest.raises(NotFoundError) as caught:
        storage.archive.measurement_blocks("none", make.ever)
    assert caught.value.code == "spacecraft.unknown"


@pytest.mark.slow
def test_memory_of_rows_after_an_epoch_does_not_grow_with_their_number(setting, monkeypatch):
    monkeypatch.setattr("db.measurements.archive.RECORD_PAGE_ROWS", 64)
    setting.append(range(10, 9_010))

    def peak_bytes(use):
        found = setting.storage.archive.measurements_after(setting.id, 0, 1 << 40)
        next(found)
        tracemalloc.start()
        assert use(found) == 8_999
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    assert 3 * peak_bytes(lambda found: sum(1 for _ in found)) < peak_bytes(lambda found: len(list(found)))


def test_plans_of_a_window(setting, make):
    assert setting.storage.archive.plan_ids(setting.id, make.ever) == ()
    setting.append([10, 20])
    second = setting.storage.catalogue.put_plan(setting.id, make.carriers[::-1], "other")
    setting.plan_id = second.id
    setting.append([30])
    archive = setting.storage.archive
    assert archive.plan_ids(setting.id, make.ever) == (1, 2)
    assert archive.plan_ids(setting.id, Window(10, 30)) == (1,), "stop is exclusive"
    assert archive.plan_ids(setting.id, Window(30, 31)) == (2,), "start is inclusive"
    assert archive.plan_ids(setting.id, Window(21, 30)) == ()


def test_behind_the_last_number_of_a_window_no_row_lies_in_it(setting):
    day_us = 86_400_000_000
    setting.append([10, 20, day_us + 10])
    setting.append([15], source="sa-2")
    setting.append([2 * day_us + 10])
    windows = [Window(0, 16), Window(16, 30), Window(day_us, 2 * day_us), Window(0, 1 << 50), Window(30, 40)]
    rows = setting.rows()
    newest = [max((row.number for row in rows if w.start_us <= row.epoch_us < w.stop_us), default=0) for w in windows]
    assert [setting.storage.archive.last_number(setting.id, window) for window in windows] == newest
    # of a sealed day more than the last row may be told, never less
    assert list(setting.storage.archive.seal(setting.id, 2 * day_us, 2**60))
    told = [setting.storage.archive.last_number(setting.id, window) for window in windows]
    assert all(one >= least for one, least in zip(told, newest, strict=True))
    assert told[2:4] == newest[2:4]


DAYS = 3
STEP_US = DAY_US // 12
REPLAYED = "replay-1"
EVER = Window(0, DAYS * DAY_US + 1)
ALWAYS = 1 << 60


def by_epoch(row):
    return row.epoch_us, row.number


def joined(read, position, limit, *, newest_first):
    """Return all rows of a list page by page."""
    found, after = [], None
    while page := read(limit, after, newest_first=newest_first):
        assert len(page) <= limit
        found += page
        after = position(page[-1])
    return found


def fill(setting, make, random_of):
    """Store rows of two sources at shared epochs, of two versions, and some of everything that is listed."""
    storage, name = setting.storage, setting.id
    epochs_us = [k * STEP_US for k in range(DAYS * 12)]
    setting.append(epochs_us[: len(epochs_us) // 2])
    setting.append(random_of.sample(epochs_us, 20), source="sa-2")
    setting.append(epochs_us[len(epochs_us) // 2 :])
    rows = [row for row in setting.rows() if row.feeds_estimator]
    # of some measurements no method computed anything
    computed = [row for row in rows if random_of.random() < 0.8]
    outcomes = [Outcome((make.attitude_row(row),), make.torque_command(row)) for row in computed]
    setting.consume(outcomes)
    setting.consume(outcomes, REPLAYED)
    for k in range(8):
        at_us = random_of.choice(epochs_us)
        storage.notes.add(Note(0, name, at_us, at_us, "ann", f"note {k}", (), None))
        alarm = replace(ALARM, spacecraft_id=name, thing=f"c{k}", raised_at_us=at_us)
        storage.alarms.save([AlarmChange(ChangeKind.RAISED, alarm, at_us, is_told=True)])
        storage.archive.add_operation(name, Operation(0, "slew", at_us, at_us + random_of.randrange(DAY_US)))
        target = f"/spacecraft/{name}/{k}"
        storage.audit.append(replace(AUDIT_EVENT, target=target))
        replay = Replay(0, at_us, at_us + STEP_US, Method.PAPER, None, 3, "journal", f"{name}-{k}", 9)
        storage.results.add_replay(name, replay)
        storage.releases.save(
            name, k, ReleaseChange("{}", "process-1", commands=(replace(COMMAND, counter=k + 1, prepared_us=at_us),))
        )
    star = Axes(0.1, 0.2, 0.3)
    storage.archive.append_inputs(name, [AttitudeReference("star", at_us, star, star) for at_us in epochs_us])
    settings = TraceSettings(954e6, 15e3, 30e3, 31.5e3, 0.0)
    for source_id in ("sa-1", "sa-2"):
        traces = [Trace(at_us, "tp1", settings, np.zeros(3)) for at_us in random_of.sample(epochs_us, 8)]
        storage.traces.append(name, source_id, traces, 77, Ring(1000, 1 << 30))


def lists_of(setting, window):
    """Return every list as a reader of pages and what its cursor holds."""
    storage, name = setting.storage, setting.id
    results, archive = storage.results, storage.archive
    wanted = AuditFilter(start_us=0, stop_us=ALWAYS, target_prefix=f"/spacecraft/{name}/")

    def of_inputs(kind):
        return (
            lambda limit, after, **order: archive.inputs(name, kind, ListPart(window, limit, after, **order)),
            lambda entry: (entry.start_us, entry.number),
        )

    def of_attitude(version, method):
        return (
            lambda limit, after, **order: results.attitude_rows(
                name, version, method, ListPart(window, limit, after, **order)
            ),
            by_epoch,
        )

    return {
        "attitude": of_attitude(LIVE, Method.ROBUST),
        "attitude without rows": of_attitude(LIVE, Method.PAPER),
        "attitude of a replay": of_attitude(REPLAYED, Method.ROBUST),
        "torques": (lambda *page, **order: results.commands(name, LIVE, ListPart(window, *page, **order)), by_epoch),
        "replays": (
            lambda *page, **order: results.replays(name, window, *page, **order),
            lambda each: each.replay.id,
        ),
        "measurements": (lambda *page, **order: archive.measurements(name, ListPart(window, *page, **order)), by_epoch),
        "measurements of a source": (
            lambda *page, **order: archive.measurements(name, ListPart(window, *page, **order), "sa-2"),
            by_epoch,
        ),
        "references": of_inputs("reference"),
        "operations": of_inputs("operation"),
        "alarms": (
            lambda *page, **order: storage.alarms.alarms(name, [], ListPart(window, *page, **order)),
            lambda alarm: (alarm.raised_at_us, alarm.id),
        ),
        "notes": (
            lambda *page, **order: storage.notes.notes(ListPart(window, *page, **order), name),
            lambda note: (note.epoch_us, note.id),
        ),
        "commands": (
            lambda *page, **order: storage.releases.commands(name, ListPart(window, *page, **order)),
            lambda command: (command.prepared_us, command.counter),
        ),
        "traces": (
            lambda *page, **order: storage.traces.heads(name, ListPart(window, *page, **order)),
            by_epoch,
        ),
        "audit": (
            lambda *page, **order: storage.audit.entries(wanted, *page, **order),
            lambda entry: entry.number,
        ),
    }


def check(setting, random_of):
    """Compare both orders of every list in some windows."""
    first, last = sorted(random_of.sample(range(DAYS * 24), 2))
    windows = [EVER, Window(STEP_US, STEP_US + 1), Window(first * STEP_US // 2, last * STEP_US // 2)]
    sizes = {}
    for window in windows:
        for what, (read, position) in lists_of(setting, window).items():
            expected = repr(joined(read, position, 10_000, newest_first=False)[::-1])
            for limit in (random_of.randrange(1, 9), 10_000):
                found = joined(read, position, limit, newest_first=True)
                assert repr(found) == expected, (what, window, limit)
                sizes[what] = max(sizes.get(what, 0), len(found))
    # none of the lists was compared while it was empty
    assert min(sizes.values()) > 5, sizes


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_pages_from_the_end_are_those_from_the_start_turned_round(setting, make, seed):
    print(f"seed {seed}")
    random_of = random.Random(seed)
    fill(setting, make, random_of)
    check(setting, random_of)
    # of the first day all is sealed, of the second the results alone, and rows arrive late into both
    list(setting.storage.archive.seal(setting.id, DAY_US, ALWAYS))
    list(setting.storage.results.seal(setting.id, 2 * DAY_US))
    setting.append([STEP_US + 5, DAY_US + 5], source="sa-3")
    check(setting, random_of)
    # of the first hours the attitude alone is left
    list(setting.storage.archive.drop_before(setting.id, "measurements", DAY_US))
    check(setting, random_of)


@pytest.mark.parametrize("limit", [1, 2, 3])
def test_a_page_from_the_end_may_end_between_rows_of_one_epoch(setting, limit):
    for source_id in ("sa-1", "sa-2"):
        setting.append([10, 20, 30], source=source_id)
    read, position = lists_of(setting, EVER)["measurements"]
    found = [position(row) for row in joined(read, position, limit, newest_first=True)]
    assert found == sorted(found, reverse=True)
    assert [epoch_us for epoch_us, _ in found] == [30, 30, 20, 20, 10, 10]


def test_a_page_from_the_end_reads_what_it_holds_and_no_more(setting, make):
    """A list that is long costs no more from its end than a short one."""
    setting.append(range(0, 3000 * 1_000_000, 1_000_000))
    seen = []
    archive = setting.storage.archive
    page = archive.measurements(setting.id, ListPart(EVER, 10, newest_first=True))
    assert [row.epoch_us for row in page] == [k * 1_000_000 for k in range(2999, 2989, -1)]
    pages = archive._pages

    def counting(connection, key):
        found = pages(connection, key)
        read = found.read

        def counted(*arguments, **options):
            runs = read(*arguments, **options)
            seen.append(sum(len(run.positions) for run in runs))
            return runs

        found.read = counted
        return found

    archive._pages = counting
    archive.measurements(setting.id, ListPart(EVER, 10, (page[-1].epoch_us, page[-1].number), newest_first=True))
    assert sum(seen) < 40


def missing(setting, source: str = "sa-1") -> int | None:
    return next(s.rows_missing for s in setting.storage.archive.sources(setting.id) if s.id == source)


def send(setting, seqs, *, epoch_of=lambda seq: 100 + seq, **options) -> None:
    """Send rows of consecutive numbers as one batch."""
    epochs_us = [epoch_of(seq) for seq in seqs]
    setting.append(epochs_us, [-50.0 - epoch_us / 8 for epoch_us in epochs_us], first_seq=seqs[0], **options)


def test_a_source_without_numbers_misses_nothing_that_could_be_told(setting):
    setting.append([10, 20])
    assert missing(setting) is None


def test_rows_before_the_first_ever_held_are_not_known_to_be_missing_until_one_of_them_comes(setting):
    send(setting, range(900, 910))
    assert missing(setting) == 0
    send(setting, range(5))
    assert missing(setting) == 895
    send(setting, range(5, 900))
    assert missing(setting) == 0


def test_a_duplicate_changes_nothing_and_a_refused_row_stays_missing(setting):
    send(setting, range(10))
    send(setting, range(10))
    assert missing(setting) == 0
    # row 12 of the request was refused by screening: its place is not in the batch
    setting.append([110, 111, 113], -1.0, index=[0, 1, 3], first_seq=10)
    assert missing(setting) == 1


def test_rows_held_under_another_number_do_not_look_lost(setting):
    """A station that lost its counter sends again what the archive has, in the middle of what it has not."""
    send(setting, range(5), epoch_of=lambda seq: 100 + 10 * seq)
    powers = [-50.0 - epoch_us / 8 for epoch_us in (90, 95, 100, 105)]
    receipt = setting.append([90, 95, 100, 105], powers, first_seq=70)
    assert (receipt.accepted, receipt.duplicates) == (3, 1)
    assert missing(setting) == 65


def test_numbers_that_start_anew_are_a_new_run_and_both_runs_keep_their_gaps(setting):
    send(setting, range(10))
    send(setting, range(15, 20))
    assert missing(setting) == 5
    later = {"epoch_of": lambda seq: 1000 + seq}
    send(setting, range(3), **later)
    assert missing(setting) == 5
    send(setting, range(8, 12), **later)
    assert missing(setting) == 10
    # rows of the earlier run find their gap by their epoch
    send(setting, range(10, 15))
    assert missing(setting) == 5
    send(setting, range(3, 8), **later)
    assert missing(setting) == 0


def test_a_source_that_always_says_number_zero_neither_misses_nor_grows_without_end(setting):
    for k in range(40):
        send(setting, range(3), epoch_of=lambda seq, k=k: 100 * (k + 1) + seq)
    assert missing(setting) == 0
    assert len(setting.rows()) == 120


def test_sources_are_counted_apart(setting):
    send(setting, range(3))
    send(setting, range(7, 9), source="sa-2")
    send(setting, range(5, 9))
    assert (missing(setting), missing(setting, "sa-2")) == (2, 0)


@pytest.mark.parametrize("seed", range(6))
def test_in_whatever_order_blocks_come_the_count_is_that_of_the_stored_rows(setting, seed):
    """Two runs of 120 rows, sent in blocks in any order, some twice and some never."""
    rng = random.Random(seed)
    expected = 0
    for run in range(2):
        rows = range(120)
        cuts = sorted({0, 120, *rng.sample(rows, 25)})
        blocks = [rows[start:stop] for start, stop in pairwise(cuts)]
        sent = [block for block in blocks[1:-1] if rng.random() < 0.7]
        rng.shuffle(sent)
        # a run is known by its first number after the last of the one before, and is over with its last
        order = [blocks[0], *sent, blocks[-1], *sent[:3]] if run == 0 else [blocks[0], blocks[-1], *sent]
        for block in order:
            send(setting, block, epoch_of=lambda seq, run=run: 1000 * (run + 1) + seq)
        held = set().union(*order)
        expected += 120 - len(held)
        assert missing(setting) == expected, f"seed {seed} run {run}"
    stored = setting.storage.archive.measurements(setting.id, ListPart(Window(0, 1 << 60), 1000))
    assert len(stored) == 240 - expected


def test_a_jump_of_more_than_a_thousand_million_numbers_is_flagged_and_counts_no_gap(setting):
    send(setting, range(10))
    far = 2**52
    receipt = setting.append([500, 501], [-1.0, -2.0], first_seq=far)
    assert receipt.accepted == 2
    assert [(each.index, each.seq, each.code) for each in receipt.flagged] == [(0, far, "seq.jump")]
    assert missing(setting) == 0
    # numbers go on either way, and gaps of this run are counted again
    assert setting.append([502], -3.0, first_seq=far + 4).flagged == ()
    assert missing(setting) == 2
    assert setting.append([600], -3.0, first_seq=10).flagged == ()
    assert missing(setting) == 2


def test_a_late_row_far_off_the_numbers_of_its_source_counts_no_gap(setting):
    for first_seq, seq in ((0, 5_000_000_000), (5_000_000_000, 3)):
        source = f"sa-{seq}"
        setting.append([100, 101], [-1.0, -2.0], first_seq=first_seq, source=source)
        assert setting.append([50], -3.0, first_seq=seq, source=source).accepted == 1
        assert missing(setting, source) == 0


def test_a_jump_of_just_a_thousand_million_numbers_is_a_gap(setting):
    send(setting, range(1))
    assert setting.append([500], -3.0, first_seq=1_000_000_000).flagged == ()
    assert missing(setting) == 999_999_999


TABLES = (head, source, sequence_interval, measurement)


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


LEVEL = np.float32(-50.12)
#: hundredths, neighbours that differ in their last bit, and levels far apart
ROWS = np.array(
    [[-50.12, -50.5, -49.0], [LEVEL, LEVEL, np.nextafter(LEVEL, np.float32(0))], [-50.12, 3e-30, np.nan]],
    dtype=np.float32,
)
FLAGS = ((0, 0, 0), (0, 1 << 22, 16), None)


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1], [1, 2, 0]])
def test_rows_sent_apart_are_those_sent_together(setting, make, order):
    epochs_us = [100 * position for position in order]
    setting.append(epochs_us, ROWS[order], flags=[FLAGS[position] for position in order])
    alone = [
        setting.append([100 * position], ROWS[position : position + 1], flags=[FLAGS[position]])
        for position in range(3)
    ]
    assert [(receipt.accepted, receipt.duplicates) for receipt in alone] == [(0, 1)] * 3
    held = setting.rows()
    np.testing.assert_array_equal(np.array([row.power_dbm for row in held]), ROWS.astype(np.float64))
    assert [None if row.flags is None else tuple(row.flags.tolist()) for row in held] == list(FLAGS)
    blocks = list(setting.storage.archive.measurement_blocks(setting.id, make.ever))
    np.testing.assert_array_equal(np.vstack([block.power_dbm for block in blocks]).view("<u4"), ROWS.view("<u4"))


def test_another_last_bit_or_flag_is_a_conflict_and_the_other_sign_of_zero_is_not(setting):
    powers = np.array([[-50.12, 0.0, np.nan]], dtype=np.float32)
    setting.append([5], powers, flags=[(0, 0, 0)])
    others = [np.nextafter(powers, np.float32(0)), np.array([[-50.12, 0.0, 0.0]])]
    for other in others:
        assert setting.append([5], other, flags=[(0, 0, 0)]).refused[0].code == "measurement.conflict"
    for flags in ((0, 1, 0), None):
        assert setting.append([5], powers, flags=[flags]).refused[0].code == "measurement.conflict"
    assert setting.append([5], powers, flags=[(0, 0, 0)]).duplicates == 1
    assert setting.append([5], np.array([[-50.12, -0.0, np.nan]]), flags=[(0, 0, 0)]).duplicates == 1


def test_the_time_of_receipt_comes_back(setting):
    setting.append([5, 1_000_000_000_000_000], ROWS[:2])
    assert [row.received_at_us for row in setting.rows()] == [77, 77]
