"""A disk that takes nothing, spoiled files and kills: the spool loses no row that could be kept, and goes on."""

import os
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from spooled_rows import NOW_US, OWNER, TASK, Hands, fill_disk, heal_disk, protect_disk, row, spool, waiting

from service.frontend.spool.file import Bounds, UploadLane
from service.frontend.spool.lock import MARK_STEP, SpoolInUseError
from service.frontend.spool.row import ROW_OVERHEAD, encode_row
from service.frontend.spool.spool import Spool

ROW_BYTES = ROW_OVERHEAD + sum(map(len, encode_row(row(0))))


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
        for number in range(5):
            made.append(row(number))
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


def test_what_can_be_read_of_a_spoiled_file_is_carried_over(tmp_path: Path) -> None:
    path = tmp_path / "sa-1.spool"
    with spool(tmp_path) as made:
        for number in range(3000):
            made.append(row(number, carriers=2))
    with path.open("r+b") as file:
        size = file.seek(0, os.SEEK_END)
        # one page of rows in the middle of the file
        file.seek(size // 2 // 4096 * 4096)
        file.write(b"\xff" * 4096)
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
        for number in range(2000):
            made.append(row(number))
        made._disk.file.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        made._disk.file.connection.execute("PRAGMA cache_size=1")
        with path.open("r+b") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(size // 2 // 4096 * 4096)
            file.write(b"\xff" * 4096)
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
        for number in range(5):
            made.append(row(number))
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
