"""The spool keeps rows through restarts, full disks and spoiled files, and counts what it had to give up."""

import math
import random
import shutil
import sqlite3
import threading
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from spooled_rows import NOW_US, TASK, Hands, heal_disk, protect_disk, row, spool, sweep, waiting

from service.frontend.spool.file import Bounds, Owner, UploadLane
from service.frontend.spool.row import ARRAYS, ROW_OVERHEAD, SpooledTask, encode_row
from service.frontend.spool.schema import LAYOUT, SpoolFileError
from service.frontend.spool.spool import Spool, spool_path

ROW_BYTES = ROW_OVERHEAD + sum(map(len, encode_row(row(0))))


def test_a_row_comes_back_as_it_was(tmp_path: Path) -> None:
    with spool(tmp_path) as made:
        assert made.append(row(5))
    with spool(tmp_path) as made:
        (found,) = made.batch(UploadLane.LIVE, 0, 10)
    assert found.seq == 1
    assert found.task == TASK
    for name, kind in ARRAYS.items():
        wanted = getattr(row(5), name).astype(kind).astype(float)
        np.testing.assert_array_equal(getattr(found.row, name), wanted)
    assert found.row.flags.dtype == np.int64
    assert found.row.power_dbm.dtype == np.float64


def test_only_its_owner_can_read_a_spool(tmp_path: Path) -> None:
    with spool(tmp_path) as made:
        assert made.append(row(5))
        modes = {path.suffix: path.stat().st_mode & 0o777 for path in tmp_path.rglob("*") if path.is_file()}
        assert len(modes) >= 3
        assert set(modes.values()) == {0o600}


def test_numbers_go_on_for_ever_even_over_an_emptied_spool_and_a_restart(tmp_path: Path) -> None:
    for start in (0, 3, 6):
        with spool(tmp_path) as made:
            for number in range(start, start + 3):
                assert made.append(row(number))
            rows = made.batch(UploadLane.LIVE, 0, 10)
            assert [each.seq for each in rows] == [start + 1, start + 2, start + 3]
            made.settle(rows)
            assert made.waiting == 0
    with spool(tmp_path) as made:
        assert made.state.last_seq == 9
        assert made.state.dropped == {}


def test_the_same_epoch_is_stored_once_and_takes_no_number(tmp_path: Path) -> None:
    with spool(tmp_path) as made:
        assert made.append(row(1))
        assert made.append(row(1))
        assert made.append(row(2))
        assert waiting(made) == [(1, 1), (2, 2)]


def test_arrays_of_different_lengths_are_no_row(tmp_path: Path) -> None:
    spoiled = row(1)
    object.__setattr__(spoiled, "sigma_db", np.zeros(7))
    with spool(tmp_path) as made, pytest.raises(ValueError, match="different lengths"):
        made.append(spoiled)


def test_lanes_part_at_the_limit_of_lateness_and_batches_have_no_gap(tmp_path: Path) -> None:
    with spool(tmp_path) as made:
        for epoch in (10, 20, 30, 40, 15, 50):
            made.append(row(epoch))
        assert [each.seq for each in made.batch(UploadLane.LIVE, 20, 10)] == [2, 3, 4]
        assert [each.seq for each in made.batch(UploadLane.BACKFILL, 20, 10)] == [1]
        made.settle(made.batch(UploadLane.BACKFILL, 20, 10))
        assert [each.seq for each in made.batch(UploadLane.BACKFILL, 20, 10)] == [5]
        assert [each.seq for each in made.batch(UploadLane.LIVE, 20, 2)] == [2, 3]
        assert made.batch(UploadLane.BACKFILL, 0, 10) == []


def test_rows_of_another_task_are_another_batch(tmp_path: Path) -> None:
    with spool(tmp_path) as made:
        made.append(row(1))
    other = SpooledTask("e" * 64, ("c07", "c08", "c09"))
    with spool(tmp_path, task=other) as made:
        made.append(row(2, carriers=3))
        (first,) = made.batch(UploadLane.LIVE, 0, 10)
        made.settle([first])
        (second,) = made.batch(UploadLane.LIVE, 0, 10)
    assert (first.task, second.task) == (TASK, other)
    assert second.row.power_dbm.size == 3


def test_beyond_its_size_the_oldest_rows_go_and_leave_a_gap(tmp_path: Path) -> None:
    with spool(tmp_path, Bounds(rows_bytes=4 * ROW_BYTES)) as made:
        for number in range(10):
            assert made.append(row(number))
        assert waiting(made) == [(7, 6), (8, 7), (9, 8), (10, 9)]
        assert made.state.dropped == {"full": 6}
        (warning,) = made.warnings
        assert warning.code == "spool.full"
        assert "6 rows given up" in warning.detail
        assert set(warning.as_json()) == {"code", "detail", "since"}
        made.settle(made.batch(UploadLane.LIVE, 0, 10))
        assert made.warnings == []
        state = made.state
    # every number is settled or given up
    assert state.last_seq == 10
    with spool(tmp_path) as made:
        assert made.state.dropped == {"full": 6}


def test_rows_that_are_being_sent_are_not_given_up(tmp_path: Path) -> None:
    with spool(tmp_path, Bounds(rows_bytes=3 * ROW_BYTES)) as made:
        for number in range(3):
            made.append(row(number))
        sent = made.batch(UploadLane.LIVE, 0, 2)
        made.append(row(3))
        assert made.state.dropped == {"full": 1}
        made.settle(sent)
        assert waiting(made) == [(4, 3)]
        assert made.state.dropped == {"full": 1}


def test_rows_that_wait_too_long_go(tmp_path: Path) -> None:
    hands = Hands()
    with spool(tmp_path, Bounds(age_s=60.0), hands) as made:
        made.append(row(0))
        hands.now_s += 50.0
        made.append(row(1))
        assert made.warnings == []
        hands.now_s += 20.0
        made.append(row(2))
        assert waiting(made) == [(2, 1), (3, 2)]
        assert made.state.dropped == {"aged": 1}
        assert [each.code for each in made.warnings] == ["spool.aged"]


def test_a_spool_of_another_source_is_refused(tmp_path: Path) -> None:
    with spool(tmp_path):
        pass
    with pytest.raises(SpoolFileError, match="holds rows of sc, source sa-1"):
        Spool(tmp_path / "sa-1.spool", Owner("sc", "sa-2"), TASK, lambda: NOW_US)


def test_refused_rows_are_kept_apart_bounded_and_counted(tmp_path: Path) -> None:
    with spool(tmp_path, Bounds(refused_rows=3)) as made:
        for number in range(6):
            made.append(row(number))
        rows = made.batch(UploadLane.LIVE, 0, 10)
        made.settle(rows, {position: ("time.future", f"row {position}") for position in range(1, 6)})
        assert made.state.refused == 5
        assert made.waiting == 0
        kept = made._disk.file.connection.execute("SELECT seq, epoch_us, code, detail FROM refused").fetchall()
    assert kept == [(number + 1, number, "time.future", f"row {number}") for number in (3, 4, 5)]


def test_traces_are_a_ring_bounded_by_count_and_bytes(tmp_path: Path) -> None:
    with spool(tmp_path, Bounds(traces=3), trace_period_s=0.0) as made:
        for number in range(5):
            made.append_trace(sweep(number))
            made.append(row(number))
        made.append_trace(sweep(4))
        made.append(row(5))
        traces = made.traces(10)
        assert [each.epoch_us for each in traces] == [2, 3, 4]
        levels = np.frombuffer(traces[0].power_dbm, dtype="<f4")
        np.testing.assert_allclose(levels[:-1], -60.0, atol=1e-5)
        assert math.isnan(levels[-1])
        assert traces[0].step_hz == pytest.approx(1e6)
        assert made.state.traces_dropped == 2
        made.settle_traces(traces[:2])
        assert made.traces_waiting == 1
    with spool(tmp_path, Bounds(traces_bytes=100), trace_period_s=0.0) as made:
        for number in range(6, 9):
            made.append_trace(sweep(number))
            made.append(row(number))
        assert [each.epoch_us for each in made.traces(10)] == [7, 8]


def test_traces_are_kept_at_a_pace_for_each_sweep(tmp_path: Path) -> None:
    hands = Hands()
    with spool(tmp_path, elapsed_s=hands, trace_period_s=10.0) as made:
        for number in range(30):
            made.append_trace(sweep(number, "a"))
            made.append_trace(sweep(number, "b"))
            made.append(row(number))
            hands.now_s += 1.0
        assert [(each.sweep, each.epoch_us) for each in made.traces(10)] == [
            (name, number) for number in (0, 10, 20) for name in "ab"
        ]


def test_an_emptied_file_gives_its_pages_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.frontend.spool.spool._IDLE_BYTES", 1 << 16)
    with spool(tmp_path) as made:
        for number in range(2000):
            made.append(row(number))
        made.settle(made.batch(UploadLane.LIVE, 0, 5000))
        made._disk.file.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        assert (tmp_path / "sa-1.spool").stat().st_size < 1 << 16


def test_threads_append_and_settle_at_the_same_time(tmp_path: Path) -> None:
    taken: list[int] = []
    with spool(tmp_path) as made:
        measuring = threading.Thread(target=lambda: [made.append(row(number)) for number in range(500)])
        measuring.start()
        while len(taken) < 500:
            made.await_rows(1, 5.0)
            rows = made.batch(UploadLane.LIVE, 0, 20)
            taken += [each.seq for each in rows]
            made.settle(rows)
        measuring.join()
        assert taken == list(range(1, 501))
        assert made.state.waiting == 0


def test_a_copy_of_the_files_at_any_moment_is_whole(tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    copy.mkdir()
    with spool(tmp_path) as made:
        for number in range(30):
            made.append(row(number))
        for path in tmp_path.glob("sa-1.spool*"):
            shutil.copy(path, copy)
    with spool(copy) as made:
        assert len(waiting(made)) == 30


def test_names_of_files_are_safe_and_different() -> None:
    names = {spool_path(Path(), sc, source).name for sc, source in (("a/b", "c"), ("a", "b/c"), ("a b", "ä"))}
    assert names == {"c@a%2fb.spool", "b%2fc@a.spool", "%e4@a%20b.spool"}


@pytest.mark.parametrize("layout", [LAYOUT - 1, LAYOUT + 1])
def test_a_spool_of_another_layout_is_refused_and_left_as_it_is(tmp_path: Path, layout: int) -> None:
    with spool(tmp_path) as made:
        made.append(row(1))
    path = tmp_path / "sa-1.spool"
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"PRAGMA user_version={layout}")
    with pytest.raises(SpoolFileError, match=f"has layout {layout}, .* send the rows that wait in it"):
        spool(tmp_path)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"PRAGMA user_version={LAYOUT}")
    with spool(tmp_path) as made:
        assert len(waiting(made)) == 1


@pytest.mark.parametrize("seed", range(4))
def test_every_number_is_settled_waiting_or_given_up_whatever_happens(tmp_path: Path, seed: int) -> None:
    print(f"seed {seed}")
    draw, hands, bounds = random.Random(seed), Hands(), Bounds(rows_bytes=12 * ROW_BYTES, held_rows=4, age_s=50.0)
    made, number, settled, seen = spool(tmp_path, bounds, hands), 0, 0, set()
    for _ in range(300):
        act = draw.random()
        if act < 0.6:
            made.append(row(number))
            number += 1
        elif act < 0.75:
            rows = made.batch(draw.choice(list(UploadLane)), number - 5, draw.randrange(1, 6))
            seqs = [each.seq for each in rows if each.seq is not None]
            assert not seen & set(seqs)
            seen |= set(seqs)
            settled += len(seqs)
            made.settle(rows)
        elif act < 0.82:
            protect_disk(made)
        elif act < 0.92:
            heal_disk(made)
        elif act < 0.96 and "store" not in vars(made._disk.file):
            made.close()
            made = spool(tmp_path, bounds, hands, now_us=NOW_US + 1000 * number)
        hands.now_s += draw.choice([0.0, 0.4, 2.0])
    heal_disk(made)
    hands.now_s += 2.0
    assert made.append(row(number))
    state = made.state
    assert state.held == 0
    assert state.last_seq == settled + state.waiting + sum(state.dropped.values())
    assert {"memory", "full"} <= state.dropped.keys()
    made.close()
