"""Foreign tables are read back to the levels and epochs that another program wrote, or refused with a reason."""

import random
import tracemalloc
from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa
import pytest
from foreign_files import Truth, Writing, table, truth, write_table
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from service.cli.own_data.foreign_archive import ForeignArchive, sample_of
from service.formats.foreign.layout import StatedLayout, TableLayout
from service.formats.foreign.proposal import propose
from service.frontend.backfill.columns import ArchiveError

CARRIERS = ("c00", "c01", "c02")
PLAN = {each: each for each in CARRIERS}
STATED = StatedLayout(tz="UTC", unit="dBm")


def layout_of(path: Path, stated: StatedLayout) -> TableLayout:
    """Return the layout of a file that leaves no question."""
    proposal = propose(sample_of(path), stated, PLAN)
    assert proposal.questions == ()
    assert proposal.layout is not None
    return proposal.layout


def read(path: Path, stated: StatedLayout = STATED) -> dict[int, list[float | None]]:
    """Return levels by epoch, in the order of the carriers."""
    layout = layout_of(path, stated)
    archive = ForeignArchive(path, layout)
    order = list(dict.fromkeys(layout.carriers.values()))
    rows = list(archive.rows())
    archive.close()
    assert [row.detail for row in rows if row.fault] == []
    return {row.cells[0]: [row.cells[1 + order.index(name)] for name in CARRIERS if name in order] for row in rows}


def wanted(known: Truth) -> dict[int, list[float]]:
    """Return the truth by epoch."""
    return {
        round(epoch.timestamp() * 1e6): list(levels)
        for epoch, levels in zip(known.epochs, known.levels_dbm, strict=True)
    }


@pytest.mark.parametrize(
    ("writing", "stated"),
    [
        (Writing(), STATED),
        (Writing(separator=";", decimal=",", pattern="%d.%m.%Y %H:%M:%S", end="\r\n", mark=b"\xef\xbb\xbf"), STATED),
        (Writing(separator="\t", pattern="%m/%d/%Y %I:%M:%S %p"), STATED),
        (Writing(decimal=",", pattern="%Y/%m/%d %H:%M"), STATED),
        (Writing(pattern="1"), STATED),
        (Writing(pattern="1000"), STATED),
        (Writing(pattern="%Y-%m-%dT%H:%M:%S%z", zone="Asia/Tokyo"), StatedLayout(unit="dBm")),
        (Writing(zone="Europe/Moscow"), StatedLayout(tz="Europe/Moscow", unit="dBm")),
        (Writing(zone="Asia/Kolkata"), StatedLayout(tz="+05:30", unit="dBm")),
        (Writing(offset_db=30.0), StatedLayout(tz="UTC", unit="dBW")),
        (Writing(offset_db=30.0, names={each: f"{each} (dBW)" for each in CARRIERS}), StatedLayout(tz="UTC")),
        (Writing(time_name="epoch UTC", names={each: f"{each}_dBm" for each in CARRIERS}), StatedLayout()),
        (Writing(is_long=True), STATED),
        (Writing(is_long=True, separator=";", decimal=","), STATED),
        (
            Writing(names={"c00": "Ch 1", "c01": "Ch 2", "c02": "Ch=3"}),
            StatedLayout(tz="UTC", unit="dBm", carriers={"Ch 1": "c00", "Ch 2": "c01", "Ch=3": "c02"}),
        ),
        (
            Writing(is_long=True, names={"c00": "A", "c01": "B", "c02": "C"}),
            StatedLayout(tz="UTC", unit="dBm", carrier_column="Channel", carriers={"A": "c00", "B": "c01", "C": "c02"}),
        ),
    ],
)
def test_tables_are_read_back_to_what_was_written(tmp_path: Path, writing: Writing, stated: StatedLayout) -> None:
    # a day above the twelfth proves the order of day and month
    known = truth(CARRIERS, 200, datetime(2026, 3, 21, 20, 0, tzinfo=UTC))
    path = write_table(tmp_path / "levels.csv", table(known, writing), writing)
    assert read(path, stated) == wanted(known)


def test_long_tables_may_come_carrier_by_carrier(tmp_path: Path) -> None:
    known = truth(CARRIERS, 50)
    header, *rows = table(known, Writing(is_long=True))
    rows.sort(key=lambda row: row[1])
    assert read(write_table(tmp_path / "levels.csv", [header, *rows], Writing())) == wanted(known)


def test_a_second_level_of_one_carrier_at_one_epoch_is_kept_back(tmp_path: Path) -> None:
    header, *rows = table(truth(CARRIERS, 3), Writing(is_long=True))
    path = write_table(tmp_path / "levels.csv", [header, *rows, [*rows[0][:2], "-1.5"]], Writing())
    archive = ForeignArchive(path, layout_of(path, STATED))
    kept_back = [row for row in archive.rows() if row.fault]
    archive.close()
    assert [(row.line, row.fault) for row in kept_back] == [(11, "second level of one carrier at one epoch")]


def test_date_and_time_in_two_columns(tmp_path: Path) -> None:
    known = truth(CARRIERS, 20, datetime(2026, 3, 21, tzinfo=UTC))
    rows = [[*row[0].split(" "), *row[1:]] for row in table(known, Writing(pattern="%d.%m.%Y %H:%M:%S"))[1:]]
    path = write_table(tmp_path / "levels.csv", [["Date", "Clock", *CARRIERS], *rows], Writing())
    assert layout_of(path, STATED).time_columns == ("Date", "Clock")
    assert read(path) == wanted(known)


@pytest.mark.parametrize("zone", [None, "UTC", "Asia/Tokyo"])
@pytest.mark.parametrize("unit", ["us", "ns", "ms"])
def test_parquet_is_read_with_and_without_a_zone(tmp_path: Path, zone: str | None, unit: str) -> None:
    known = truth(CARRIERS, 30)
    levels = {name: [row[k] for row in known.levels_dbm] for k, name in enumerate(CARRIERS)}
    instants = pa.array([each.replace(tzinfo=None) for each in known.epochs], pa.timestamp(unit))
    if zone is not None:
        instants = instants.cast(pa.timestamp(unit, tz=zone))
    path = tmp_path / "levels.parquet"
    parquet.write_table(pa.table({"when": instants, **levels}), path)
    stated = STATED if zone is None else StatedLayout(unit="dBm")
    if zone is None:
        questions = propose(sample_of(path), StatedLayout(unit="dBm"), PLAN).questions
        assert [each.option for each in questions] == ["--tz"]
    assert read(path, stated) == wanted(known)


def test_cells_without_a_level_are_absent_and_odd_ones_are_kept_back(tmp_path: Path) -> None:
    header, *rows = table(truth(CARRIERS, 60), Writing())
    rows[3][1], rows[4][2], rows[5][3], rows[6][1] = "", "NaN", "n/a", "---"
    rows[7][1], rows[8][2], rows[9][0] = "overload", "-60,5", "2026-02-30 00:00:00"
    path = write_table(tmp_path / "levels.csv", [header, *rows], Writing())
    archive = ForeignArchive(path, layout_of(path, STATED))
    found = list(archive.rows())
    archive.close()
    assert [found[k].cells[n] for k, n in ((3, 1), (4, 2), (5, 3), (6, 1))] == [None] * 4
    odd = {row.line: row for row in found if row.fault}
    assert {line: row.fault for line, row in odd.items()} == {
        9: "level is no number with decimal point",
        10: "level is no number with decimal point",
        11: "epoch is not iso",
    }
    # under our own header: what is understood in dBm, the rest as it stands
    assert odd[9].cells[1] == "overload"
    assert odd[11].cells == ["2026-02-30 00:00:00", *map(float, rows[9][1:])]


def test_a_file_that_was_cut_off_does_not_give_a_cut_number(tmp_path: Path) -> None:
    known = truth(CARRIERS, 20)
    path = write_table(tmp_path / "levels.csv", table(known, Writing()), Writing())
    whole = path.read_bytes()
    draw = random.Random(3)
    for _ in range(40):
        path.write_bytes(whole[: draw.randrange(len(whole) // 2, len(whole) - 1)])
        archive = ForeignArchive(path, layout_of(path, STATED))
        rows = list(archive.rows())
        archive.close()
        readable = {row.cells[0]: row.cells[1:] for row in rows if not row.fault}
        assert readable.items() <= wanted(known).items()
        assert len(readable) >= 8


@pytest.mark.parametrize("zone", ["Europe/Berlin", "America/New_York"])
def test_hours_that_a_change_of_the_clocks_repeats_are_kept_back(tmp_path: Path, zone: str) -> None:
    known = truth(CARRIERS, 8, datetime(2025, 10, 26, tzinfo=UTC), step_s=900.0)
    if zone == "America/New_York":
        known = truth(CARRIERS, 8, datetime(2025, 11, 2, 5, tzinfo=UTC), step_s=900.0)
    path = write_table(tmp_path / "levels.csv", table(known, Writing(zone=zone)), Writing())
    archive = ForeignArchive(path, layout_of(path, StatedLayout(tz=zone, unit="dBm")))
    faults = [row.fault for row in archive.rows()]
    archive.close()
    assert faults == ["epoch in an hour that the change of the clocks repeats or leaves out"] * 8


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no header with lines"),
        (b"\xff\xfet\x00", "UTF-16"),
        ("Время;c00\n2026;-1\n".encode("cp1251"), "not UTF-8"),
        (b"Time,c00;c01\n" + b"2026-03-01 00:00:00;-60.5;-61\n" * 5, "mixed separators"),
        (b"Time,c00,c01\n" + b"2026-03-01 00:00:00,-60,5,-61,25\n" * 5, "decimal comma"),
        (b"x" * (1 << 20) + b"\n", "this is no table"),
        (b'Time,c00\n"2026,-1\n' + b"2026,-1\n" * 40_000, "check the quotes|no header|separator"),
        (b"nothing of a table\nat all\n", "mixed separators"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "levels.csv"
    path.write_bytes(content)
    with pytest.raises(ArchiveError, match=message):
        sample_of(path)


def test_a_parquet_file_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "levels.parquet"
    parquet.write_table(pa.table({"Time": ["2026-03-01 00:00:00"] * 100, "c00": [-60.0] * 100}), path)
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(ArchiveError, match="cut off"):
        sample_of(path)


@pytest.mark.parametrize("is_long", [False, True])
def test_memory_does_not_grow_with_the_file(tmp_path: Path, is_long: bool) -> None:
    writing = Writing(is_long=is_long)
    path = write_table(tmp_path / "levels.csv", table(truth(CARRIERS, 200), writing), writing)
    layout = layout_of(path, STATED)
    peaks = []
    for rows in (500, 5_000):
        write_table(path, table(truth(CARRIERS, rows), writing), writing)
        archive = ForeignArchive(path, layout)
        tracemalloc.start()
        assert sum(1 for _ in archive.rows()) == rows
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        archive.close()
    assert peaks[1] < 1.5 * peaks[0] + 100_000
    print(f"peak {peaks[1] / 1e6:.2f} MB")


@settings(deadline=None)
@given(st.binary(max_size=400))
def test_no_bytes_end_in_anything_but_a_refusal(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("bytes") / "levels.csv"
    path.write_bytes(b"Time,c00\n" + content)
    try:
        sample = sample_of(path)
    except ArchiveError:
        return
    assert all(len(row) == len(sample.header) for row in sample.rows)
