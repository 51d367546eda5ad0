"""Every storage answers the same before and after results are sealed, whenever that happens."""

import random

import numpy as np
import pytest
from sqlalchemy import func, select, update

from db import sealing
from db.encoding.segments import DAY_US
from db.measurements import closed_days
from db.results.stored_rows import pack_carriers
from db.storage import SqlStorage
from db.tables import attitude, segment, torque
from service.errors import StorageError
from service.ports.archive import LIVE, ListPart, Outcome
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS, Method
from service.records.levels.attitude import Axes, CarrierResults, Pulse

DAYS = 3
STEP_US = DAY_US // 8
ALWAYS = 1 << 60
REPLAYED = "replay-1"


def seal(setting, before_us=ALWAYS):
    return list(setting.storage.results.seal(setting.id, before_us))


def rows_in_tables(setting):
    with setting.storage._database.read() as connection:
        return [connection.scalar(select(func.count()).select_from(table)) for table in (attitude, torque)]


def segment_sizes(setting):
    with setting.storage._database.read() as connection:
        return connection.scalars(
            select(segment.c.row_count).where(segment.c.series != "measurement").order_by(segment.c.segment_id)
        ).all()


def pages(read, limit):
    after = None
    while page := read(limit, after):
        yield page
        after = page[-1].epoch_us, page[-1].number


def answers(setting, windows, alignment):
    """Return what every method of the port that reads results says, as text that tells every bit of it."""
    # nothing that was counted before helps
    results, name = type(setting.storage.results)(setting.storage._database), setting.id
    last = setting.storage.archive.head(name).result_sequence
    found = {
        "pending": [results.pending(name, chosen) for chosen in ([Method.PAPER], list(LIVE_METHODS))],
        "after the alignment": results.rows_after(name, alignment),
        "sequences": [results.results_after(name, after, 9) for after in range(0, last + 1, 7)],
        "carriers of sequences": [
            (sequence, *pack_carriers([each]))
            for after in range(0, last + 1, 7)
            for sequence, each in sorted(results.carriers_after(name, after, after + 9).items())
        ],
    }
    for version in (LIVE, REPLAYED):
        found[f"newest {version}"] = [results.newest_attitude(name, version, method) for method in LIVE_METHODS]
        found[f"newest command {version}"] = results.newest_command(name, version)
        for window in windows:

            def commands(limit, after, version=version, window=window):
                return results.commands(name, version, ListPart(window, limit, after))

            found[f"commands {version} {window}"] = [list(pages(commands, limit)) for limit in (4, 999)]
            for method in LIVE_METHODS:

                def rows(limit, after, version=version, window=window, method=method):
                    return results.attitude_rows(name, version, method, ListPart(window, limit, after))

                carriers = results.carrier_results(name, version, method, window)
                found[f"carriers {method} {version} {window}"] = [
                    (position, *pack_carriers([each])) for position, each in carriers.items()
                ]
                found[f"{method} {version} {window}"] = [list(pages(rows, limit)) for limit in (4, 999)]
    return {question: repr(answer) for question, answer in found.items()}


def outcome(make, row, dice, methods):
    """Return results of a row that no two rows have in common."""
    axes = [
        Axes(*(dice.choice([dice.gauss(0.0, 1.0), -0.0, float("nan"), float("inf")]) for _ in range(3)))
        for _ in range(3)
    ]
    pulses = tuple(Pulse(row.epoch_us + k, dice.random(), axes[2]) for k in range(dice.randrange(3)))
    rates = dice.choice([None, axes[1]])
    rows = tuple(make.attitude_row(row, method, attitude_deg=axes[0], rates_deg_s=rates) for method in methods)
    rows = rows if dice.random() < 0.8 else ()
    is_commanded = dice.random() < 0.7
    command = make.torque_command(row, torque_n_m=axes[1], schedule=pulses) if is_commanded else None
    carriers = tuple(dice.choice([None, carriers_of(dice, dice.randint(1, 3))]) for _ in rows)
    return Outcome(rows, command, carriers=carriers)


def carriers_of(dice, count):
    """Return results of the carriers of a plan, whose number is how many they are, one of them not known."""
    levels_db = np.array([[dice.gauss(0.0, 9.0) for _ in range(count)] for _ in range(2)])
    levels_db[0, dice.randrange(count)] = np.nan
    words = [np.array([dice.randrange(5) for _ in range(count)]) for _ in range(2)]
    return CarrierResults(count, *levels_db, *words)


@pytest.mark.parametrize("seed", range(4))
def test_sealing_at_random_moments_changes_no_answer(new_setting, make, monkeypatch, seed):
    """Two spacecraft live the same life; results of one are sealed again and again, into segments of few rows."""
    most = {"attitude": 3, "torque": 3} if seed % 2 else {}
    monkeypatch.setattr(sealing, "SEGMENT_ROWS", sealing.SEGMENT_ROWS | most)
    settings = plain, sealed = new_setting(), new_setting()
    dice = random.Random(seed)
    moved = 0
    alignment = None
    for step in range(12):
        epochs_us = [dice.randrange(8 * DAYS) * STEP_US + dice.choice([0, 0, 1]) for _ in range(dice.randint(1, 9))]
        source, thrown = dice.choice(["sa-1", "sa-2"]), dice.random()
        methods = dice.choice([[Method.ROBUST], list(LIVE_METHODS)])
        version = LIVE if step < 6 or dice.random() < 0.7 else REPLAYED
        for setting in settings:
            setting.append(epochs_us, source=source)
            if step in (2, 8):
                setting.calibrate()
                alignment = setting.align(STEP_US * 5)
            if step == 4:
                setting.storage.archive.select_source(setting.id, "sa-2")
            made = random.Random(thrown)
            rows = [row for row in setting.rows() if row.feeds_estimator][: int(1 + thrown * 40)]
            setting.consume([outcome(make, row, made, methods) for row in rows], version)
        if dice.random() < 0.6:
            moved += sum(part.rows for part in seal(sealed, dice.randint(0, DAYS) * DAY_US + 5))
            # those of the journal fall together with those of results only by chance
            list(sealed.storage.archive.seal(sealed.id, dice.randint(0, DAYS) * DAY_US, ALWAYS))
    moved += sum(part.rows for part in seal(sealed))
    assert moved == sum(rows_in_tables(plain)), f"seed {seed}"
    assert rows_in_tables(sealed) == rows_in_tables(plain), "of the two spacecraft together one is sealed"
    stops = sorted(dice.sample(range(-1, DAYS * DAY_US + 2), 4))
    windows = [make.ever, Window(stops[0], stops[2]), Window(stops[1], stops[3])]
    said = [answers(setting, windows, alignment) for setting in settings]
    for question, answer in said[0].items():
        assert said[1][question] == answer, f"seed {seed}: {question}"


def lived(setting, make, days=3, version=LIVE):
    """Let a spacecraft have three rows a day with all results."""
    for day in range(days):
        setting.append([day * DAY_US + second for second in (5, 6, 7)])
    rows = [row for row in setting.rows() if row.epoch_us < days * DAY_US]
    both = [tuple(make.attitude_row(row, method) for method in LIVE_METHODS) for row in rows]
    setting.consume([Outcome(each, make.torque_command(row)) for each, row in zip(both, rows, strict=True)], version)
    return setting


def test_open_days_stay_rows(setting, make):
    lived(setting, make)
    parts = seal(setting, 2 * DAY_US - 1)
    assert [(part.series, part.version, part.method, part.rows) for part in parts] == [
        ("attitude", LIVE, "paper", 3),
        ("attitude", LIVE, "robust", 3),
        ("torque", LIVE, None, 3),
    ]
    assert rows_in_tables(setting) == [12, 6]
    assert seal(setting, 2 * DAY_US - 1) == []


def test_a_result_stored_again_stays_as_it_is_when_it_is_sealed(setting, make):
    lived(setting, make, 1)
    lived(setting, make, 1, REPLAYED)
    seal(setting)
    head = setting.storage.archive.head(setting.id)
    for version in (LIVE, REPLAYED):
        changed = [
            Outcome((make.attitude_row(row, common_db=9.0),), make.torque_command(row)) for row in setting.rows()
        ]
        assert setting.consume(changed, version) == head.result_sequence
    assert rows_in_tables(setting) == [0, 0]
    (found, *_) = setting.storage.results.attitude_rows(setting.id, LIVE, Method.ROBUST, ListPart(make.ever, 9))
    assert found.common_db != 9.0


def test_late_results_go_into_the_segment_later_and_a_busy_day_is_several(setting, make, monkeypatch):
    monkeypatch.setitem(sealing.SEGMENT_ROWS, "attitude", 10)
    setting.append(range(0, 64, 2))
    setting.consume([Outcome((make.attitude_row(row),), None) for row in setting.rows()])
    assert [part.rows for part in seal(setting)] == [10, 10, 10, 2]
    setting.append(range(1, 40, 2))
    setting.consume([Outcome((make.attitude_row(row),), None) for row in setting.rows()])
    read = setting.storage.results.attitude_rows(setting.id, LIVE, Method.ROBUST, ListPart(make.ever, 99))
    assert [row.epoch_us for row in read] == [*range(40), *range(40, 64, 2)]
    seal(setting)
    assert setting.storage.results.attitude_rows(setting.id, LIVE, Method.ROBUST, ListPart(make.ever, 99)) == read
    sizes = segment_sizes(setting)
    assert sum(sizes) == 52
    assert max(sizes) <= 15


def test_rows_of_one_epoch_lie_in_one_segment(setting, make, monkeypatch):
    monkeypatch.setitem(sealing.SEGMENT_ROWS, "attitude", 2)
    for source in ("sa-1", "sa-2", "sa-3"):
        setting.append([10, 20], source=source)
    setting.consume([Outcome((make.attitude_row(row),), None) for row in setting.rows()])
    assert sum(part.rows for part in seal(setting)) == 6
    assert segment_sizes(setting) == [3, 3]


@pytest.mark.parametrize("is_other_first", [False, True])
def test_what_changes_while_a_day_is_packed_is_neither_lost_nor_doubled(
    setting, make, url, monkeypatch, is_other_first
):
    lived(setting, make, 1)
    before = sealing.carry_out

    def carry_out(connection, change):
        monkeypatch.setattr(sealing, "carry_out", before)
        if is_other_first:
            # another process has read the same rows and was faster
            assert before(connection, change)
            return before(connection, change)
        stored = dict(connection.execute(select(attitude).limit(1)).mappings().one())
        del stored["checksum"]
        late = {"method": change.of.method, "epoch_us": 6, "number": 77, "sequence": 99}
        connection.execute(attitude.insert().values({**stored, **late}))
        return before(connection, change)

    monkeypatch.setattr(sealing, "carry_out", carry_out)
    other = SqlStorage(url)
    list(other.results.seal(setting.id, ALWAYS))
    seal(setting)
    other.close()
    assert rows_in_tables(setting) == [0, 0]
    assert sum(segment_sizes(setting)) == 9 + (not is_other_first)


@pytest.mark.parametrize(
    "column", ["content", "checksum", "row_count", "first_epoch_us", "last_number", "last_sequence", "version"]
)
def test_a_damaged_segment_is_told_and_touches_no_other_day(setting, make, column):
    lived(setting, make)
    seal(setting)
    results, damaged_us = setting.storage.results, DAY_US + 5
    is_it = (segment.c.first_epoch_us == damaged_us) & (segment.c.method == Method.ROBUST.value)
    with setting.storage._database.engines.write.begin() as connection:
        found = connection.scalar(select(segment.c[column]).where(is_it))
        if isinstance(found, bytes):
            changed = found[:-1] + bytes([found[-1] ^ 1])
        else:
            changed = found + (1 if isinstance(found, int) else "x")
        connection.execute(update(segment).where(is_it).values({column: changed}))
    if column != "version":
        with pytest.raises(StorageError, match=r"storage\.corrupt") as caught:
            results.attitude_rows(setting.id, LIVE, Method.ROBUST, ListPart(make.ever, 99))
        assert setting.id in caught.value.detail
        assert "1970-01-02" in caught.value.detail
    for window in (Window(0, DAY_US), Window(2 * DAY_US, 3 * DAY_US)):
        assert len(results.attitude_rows(setting.id, LIVE, Method.ROBUST, ListPart(window, 99))) == 3
    assert len(results.attitude_rows(setting.id, LIVE, Method.PAPER, ListPart(make.ever, 99))) == 9
    assert results.newest_attitude(setting.id, LIVE, Method.ROBUST).epoch_us == 2 * DAY_US + 7
    # late rows of the damaged day wait in the table of rows, and other days are sealed
    setting.append([DAY_US + 9, 9])
    late = [row for row in setting.rows() if row.epoch_us % DAY_US == 9]
    setting.consume([Outcome((make.attitude_row(row),), None) for row in late])
    assert [part.first_epoch_us for part in seal(setting)] == [9] if column != "version" else True


def test_a_damaged_row_is_not_sealed(setting, make, caplog):
    lived(setting, make, 1)
    is_it = (attitude.c.method == Method.ROBUST.value) & (attitude.c.epoch_us == 6)
    with setting.storage._database.engines.write.begin() as connection:
        connection.execute(update(attitude).where(is_it).values(common_db=77.0))
    assert [part.rows for part in seal(setting)] == [3, 2, 3]
    assert rows_in_tables(setting) == [1, 0]
    assert "1 attitude rows differ from their checksum" in caplog.text
    read = setting.storage.results.attitude_rows
    with pytest.raises(StorageError, match=r"storage\.corrupt: The attitude row of .*000006Z number \d+ differs"):
        read(setting.id, LIVE, Method.ROBUST, ListPart(make.ever, 9))
    for window in (Window(0, 6), Window(7, DAY_US)):
        assert len(read(setting.id, LIVE, Method.ROBUST, ListPart(window, 9))) == 1


@pytest.mark.parametrize("series", ["attitude", "torques"])
def test_retention_drops_sealed_days_of_every_version(setting, make, monkeypatch, series):
    monkeypatch.setattr(closed_days, "SEGMENTS_AT_ONCE", 1)
    lived(setting, make)
    lived(setting, make, version=REPLAYED)
    archive, results = setting.storage.archive, setting.storage.results
    rows = 12 if series == "attitude" else 6
    seal(setting, 2 * DAY_US)
    assert archive.fitting_us(setting.id, series, 1) == 2 * DAY_US
    assert archive.fitting_us(setting.id, series, 1 << 30) is None
    assert sum(dropped.rows for dropped in archive.drop_before(setting.id, series, DAY_US + 7)) == rows
    assert sum(dropped.rows for dropped in archive.drop_before(setting.id, series, 3 * DAY_US)) == 2 * rows
    for version in (LIVE, REPLAYED):
        attitudes = results.attitude_rows(setting.id, version, Method.PAPER, ListPart(make.ever, 99))
        commands = results.commands(setting.id, version, ListPart(make.ever, 99))
        assert (len(attitudes), len(commands)) == ((0, 9) if series == "attitude" else (9, 0))


def test_a_resumed_stream_goes_on_behind_sealed_days_that_were_dropped(setting, make):
    lived(setting, make)
    seal(setting)
    for series in ("attitude", "torques"):
        list(setting.storage.archive.drop_before(setting.id, series, DAY_US))
    found = setting.storage.results.results_after(setting.id, 0, 2)
    assert [(sequence, result.epoch_us) for sequence, result in found] == [(10, DAY_US + 5), (11, DAY_US + 5)]
    assert setting.storage.results.results_after(setting.id, 27, 2) == []


def test_figures_of_a_day_take_a_third_of_its_rows(setting, make):
    dice = np.random.default_rng(2)
    setting.append(range(1440))
    rows = setting.rows()
    outcomes = []

    def angles():
        return Axes(*dice.normal(size=3).tolist())

    for row in rows:
        both = tuple(make.attitude_row(row, method, attitude_deg=angles()) for method in LIVE_METHODS)
        outcomes.append(Outcome(both, make.torque_command(row, torque_n_m=angles())))
    setting.consume(outcomes)
    seal(setting)
    with setting.storage._database.read() as connection:
        size = connection.scalar(select(func.sum(func.length(segment.c.content))))
    # nine doubles that nothing tells beforehand take 66 bytes, the rest of 64 columns little
    assert size / len(rows) < 80
