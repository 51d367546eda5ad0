"""Archives of other formats than CSV and Parquet: what is read of them, and what is refused by line."""

from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from service.cli.own_data.tdm_archive import open_any_archive
from service.frontend.backfill.columns import ArchiveError

MESSAGE = """CCSDS_TDM_VERS = 2.0
META_START
TRACK_ID = sa-1/c01
TIME_SYSTEM = UTC
META_STOP
DATA_START
CARRIER_POWER = 2026-11-21T00:01:00.000000 -72.25
CARRIER_POWER = 2026-11-21T00:00:00.000000 -72.1
DATA_STOP
META_START
TRACK_ID = sa-1/c00
TIME_SYSTEM = UTC
META_STOP
DATA_START
CARRIER_POWER = 2026-11-21T00:00:00.000000 -80
PC_N0 = 2026-11-21T00:00:00.000000 70
DATA_STOP
"""
LINES = '{"epoch":"2026-11-21T00:00:00Z","c00_dbm":-40.5}\n\n{"c00_dbm":null,"epoch":"2026-11-21T00:00:01Z"}\n'


def read(path: Path, text: str) -> tuple[list[str], list[list[Any]]]:
    """Return header and cells of a file with this text."""
    path.write_text(text)
    with closing(open_any_archive(path)) as archive:
        rows = [row.cells for row in archive.rows()]
        assert archive.done == archive.total
        return archive.header, rows


def test_segments_of_a_message_become_rows(tmp_path: Path) -> None:
    header, rows = read(tmp_path / "powers.tdm", MESSAGE)
    assert header == ["epoch", "source", "c01_dbm", "c00_dbm"]
    assert rows == [[1_795_219_200_000_000, "sa-1", -42.1, -50.0], [1_795_219_260_000_000, "sa-1", -42.25, None]]


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [("sa-1/c01", "track 7", "TRACK_ID"), ("-72.25", "loud", "line 7"), ("CCSDS_TDM", "CCSDS_XXX", "line 1")],
)
def test_other_messages_are_refused(tmp_path: Path, old: str, new: str, word: str) -> None:
    with pytest.raises(ArchiveError, match=word):
        read(tmp_path / "powers.tdm", MESSAGE.replace(old, new))


def test_objects_are_read_by_name(tmp_path: Path) -> None:
    header, rows = read(tmp_path / "levels.ndjson", LINES)
    assert header == ["epoch", "c00_dbm"]
    assert rows == [["2026-11-21T00:00:00Z", -40.5], ["2026-11-21T00:00:01Z", None]]


@pytest.mark.parametrize(
    ("line", "word"),
    [("{", "line 4 is no JSON"), ("[1]", "line 4 is no JSON object"), ('{"epoch":1}', "line 4 has other names")],
)
def test_lines_that_are_no_such_objects_are_refused(tmp_path: Path, line: str, word: str) -> None:
    with pytest.raises(ArchiveError, match=word):
        read(tmp_path / "levels.ndjson", LINES + line + "\n")


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArchiveError):
        open_any_archive(tmp_path / "none.tdm")
