"""The spool keeps rows through restarts, full disks, spoiled files and kills, and counts what it had to give up."""

import math
import os
import random
import shutil
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from scripted_service import fill
from spooled_rows import NOW_US, OWNER, TASK, Hands, fill_disk, heal_disk, protect_disk, row, spool, sweep, waiting

from service.frontend.spool.disk import MARK_STEP, SpoolInUseError
from service.frontend.spool.file import Bounds, Owner, UploadLane
from service.frontend.spool.row import ARRAYS, LAYOUT, ROW_OVERHEAD, SpooledTask, SpoolFileError, encode_row
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
            fill(made, 3, first=start)
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
        fill(made, 10)
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
        fill(made, 3)
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
        fill(made, 6)
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
        fill(made, 2000)
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
        fill(made, 30)
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


@pytest.mark.parametrize(("disable", "code"), [(fill_disk, "spool.disk_full"), (protect_disk, "spool.unwritable")])
def test_a_disk_that_takes_nothing_stops_neither_measuring_nor_sending(tmp_path: Path, disable, code: str) -> None:
    hands = Hands()
    with spool(tmp_path, Bounds(held_rows=60), hands) as made:
        made.append(row(0))
        made.append(row(1))
        disable(made)
        on_disk = next(number for number in range(2, 1000) if not made.append(row(number)))
        for number in range(on_disk + 1, on_disk + 40):
            assert not made.append(row(number))
        assert [each.code for each in made.warnings] == [code]
        assert made.waiting == on_disk + 40
        # what is on the disk is sent, and not again although it cannot be deleted
        rows = made.batch(UploadLane.LIVE, 0, 1000)
        assert len(rows) == on_disk
        made.settle(rows, {1: ("value.out_of_range", "because")})
        assert made.waiting == 40
        # what is in memory is sent without a number
        first = made.batch(UploadLane.LIVE, 0, 5)
        assert [(each.seq, each.row.epoch_us) for each in first] == [(None, on_disk + k) for k in range(5)]
        made.settle(first)
        assert made.waiting == 35
        heal_disk(made)
        assert not made.append(row(on_disk + 40))
        hands.now_s += 1.5
        assert made.append(row(on_disk + 41))
        assert made.warnings == []
        # rows that went out of memory took no number
        assert waiting(made) == [(seq, seq + 4) for seq in range(on_disk + 1, on_disk + 38)]
        assert (made.state.held, made.state.dropped, made.state.refused) == (0, {}, 1)


def test_beyond_the_bound_in_memory_the_oldest_rows_go_and_their_numbers_with_them(tmp_path: Path) -> None:
    hands = Hands()
    with spool(tmp_path, Bounds(held_rows=3), hands) as made:
        made.append(row(0))
        protect_disk(made)
        for number in range(1, 9):
            assert not made.append(row(number))
        assert made.state.dropped == {"memory": 5}
        assert {each.code for each in made.warnings} == {"spool.unwritable", "spool.full"}
        heal_disk(made)
        hands.now_s += 1.5
        assert made.append(row(9))
        # memory held 3 rows, the tenth one made a sixth of them go
        assert made.state.dropped == {"memory": 6}
        assert waiting(made)[0] == (1, 0)
        made.settle(made.batch(UploadLane.LIVE, 0, 1))
        assert waiting(made) == [(8, 7), (9, 8), (10, 9)]


def test_a_folder_that_cannot_be_made_holds_the_rows_until_it_can(tmp_path: Path) -> None:
    hands = Hands()
    blocker = tmp_path / "folder"
    blocker.write_text("in the way")
    with Spool(blocker / "x.spool", OWNER, TASK, lambda: NOW_US, elapsed_s=hands) as made:
        assert [each.code for each in made.warnings] == ["spool.unwritable"]
        assert not made.append(row(1))
        assert waiting(made) == [(None, 1)]
        blocker.unlink()
        hands.now_s += 1.5
        assert made.append(row(2))
        assert waiting(made) == [(1, 1), (2, 2)]
        assert made.warnings == []


def test_a_file_that_is_no_database_is_set_aside_and_numbers_go_on(tmp_path: Path) -> None:
    with spool(tmp_path) as made:
        fill(made, 5)
    (tmp_path / "sa-1.spool").write_bytes(b"no database" * 1000)
    with spool(tmp_path) as made:
        (warning,) = made.warnings
        assert warning.code == "spool.corrupt"
        assert "an unknown number lost" in warning.detail
        made.append(row(9))
        # above every number that may have been given: at most a step of the mark further on
        ((seq, _),) = waiting(made)
        assert 5 < seq <= 5 + MARK_STEP + 2
    (aside,) = tmp_path.glob("*.damaged-*")
    assert aside.read_bytes().startswith(b"no database")


def spoil(path: Path) -> None:
    """Write over one page of rows in the middle of a file."""
    with path.open("r+b") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(size // 2 // 4096 * 4096)
        file.write(b"\xff" * 4096)


def test_what_can_be_read_of_a_spoiled_file_is_carried_over(tmp_path: Path) -> None:
    path = tmp_path / "sa-1.spool"
    with spool(tmp_path) as made:
        for number in range(3000):
            made.append(row(number, carriers=2))
    spoil(path)
    with spool(tmp_path) as made:
        (warning,) = made.warnings
        assert warning.code == "spool.corrupt"
        rows = waiting(made, 10_000)
        assert rows[0] == (1, 0)
        assert made.waiting > 2900
        made.append(row(5000))
        assert made.state.last_seq == 3001
        assert "integrity" not in warning.detail
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_a_file_that_is_spoiled_while_in_use_loses_no_row_that_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "sa-1.spool"
    hands = Hands()
    with spool(tmp_path, elapsed_s=hands) as made:
        fill(made, 2000)
        made._disk.file.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        made._disk.file.connection.execute("PRAGMA cache_size=1")
        spoil(path)
        epochs, last = set(), 2000
        made.append(row(last))
        while rows := made.batch(UploadLane.LIVE, 0, 50):
            epochs |= {each.row.epoch_us for each in rows}
            made.settle(rows)
        assert [each.code for each in made.warnings] == ["spool.corrupt"]
        lost = made.state.dropped.get("corrupt", 0)
        assert 0 < lost < 100
        assert len(epochs) == 2001 - lost
        assert last in epochs


def test_a_file_removed_while_in_use_is_begun_anew_with_its_rows(tmp_path: Path) -> None:
    with spool(tmp_path) as made:
        fill(made, 5)
        for path in tmp_path.iterdir():
            path.unlink()
        assert made.append(row(5))
        assert [each.code for each in made.warnings] == ["spool.corrupt"]
    with spool(tmp_path) as made:
        assert waiting(made) == [(number + 1, number) for number in range(6)]


def test_one_process_owns_a_spool(tmp_path: Path) -> None:
    with spool(tmp_path), pytest.raises(SpoolInUseError, match=f"in use by process {os.getpid()}"):
        spool(tmp_path)
    with spool(tmp_path) as made:
        assert made.append(row(1))


def test_a_kill_gives_the_spool_free_and_keeps_every_row(tmp_path: Path) -> None:
    program = (
        "import os, sys, pathlib; sys.path.insert(0, 'tests/fakes/drivers'); import spooled_rows as s\n"
        f"made = s.spool(pathlib.Path({str(tmp_path)!r}))\n"
        "assert all(made.append(s.row(k)) for k in range(20))\n"
        "os.kill(os.getpid(), 9)\n"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False, timeout=120).returncode == -9
    with spool(tmp_path) as made:
        assert waiting(made) == [(number + 1, number) for number in range(20)]
