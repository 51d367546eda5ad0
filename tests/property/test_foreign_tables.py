"""A table that a random writer wrote is read equal or refused, never read differently.

The writer draws separator, decimal sign, encoding, ends of lines, order of columns, units, form and zone of the epochs,
codes for no reading, lines around the table, and a few spoiled cells. What the reader asks is answered as the writer
knows it, by field; a question that the writer has no answer to is a refusal.
"""

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from service.formats.foreign.columns import Interpretation, PowersStatement, interpret_powers
from service.formats.foreign.table import ForeignTableError, read_table

#: of every change, of continuous integration and of a night; 50 000 were run once
OF_PROFILE = {"fast": 50, "ci": 300}
EXAMPLES = int(os.environ.get("SOO_TABLE_EXAMPLES", OF_PROFILE.get(os.environ.get("SOO_TEST_PROFILE", "fast"), 2000)))
CARRIERS = ("c00", "c01", "Омск", "Ekb 2")
PLAN = {name: name for name in CARRIERS}
FORMS = {
    "%Y-%m-%dT%H:%M:%SZ": "UTC",
    "%Y-%m-%d %H:%M:%S": None,
    "%Y-%m-%d %H:%M:%S%z": "own",
    "%d.%m.%Y %H:%M:%S": None,
    "%m/%d/%Y %H:%M:%S": None,
    "%m/%d/%Y %I:%M:%S %p": None,
    "%d-%b-%Y %H:%M:%S": None,
    "%Y-%jT%H:%M:%S": None,
    "%d.%m.%Y|%H:%M:%S": None,
    "%Y/%m/%d|%H:%M:%S": None,
    "unix_s": "UTC",
    "unix_ms": "UTC",
    "mjd": None,
    "excel": None,
}
CODES = ("", "NaN", "---", "9.91E37", "OVLD", "<-80", "n/a")
OFFSETS_DB = {"dBm": 0.0, "dBW": 30.0, "mW": None}


class Writing(NamedTuple):
    """Choices of a writer of tables."""

    start_s: int
    step_s: int
    rows: int
    separator: str
    is_comma: bool
    encoding: str
    end: str
    unit: str
    names_unit: bool
    form: str
    zone: str
    names_zone: bool
    order: list[int]
    code: str
    coded: list[int]
    preamble: list[str]
    has_counter: bool
    spoiled: list[int]
    is_long: bool


def writings() -> st.SearchStrategy[Writing]:
    """Return the strategy of writers."""
    return st.builds(
        Writing,
        start_s=st.integers(1_767_225_600, 1_795_000_000),
        step_s=st.sampled_from([1, 10, 60, 300, 3600]),
        rows=st.integers(4, 40),
        separator=st.sampled_from([",", ";", "\t", "|"]),
        is_comma=st.booleans(),
        encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1251", "koi8-r"]),
        end=st.sampled_from(["\n", "\r\n", "\r"]),
        unit=st.sampled_from(list(OFFSETS_DB)),
        names_unit=st.booleans(),
        form=st.sampled_from(list(FORMS)),
        zone=st.sampled_from(["UTC", "Europe/Moscow", "America/New_York", "Asia/Kolkata"]),
        names_zone=st.booleans(),
        order=st.permutations(range(len(CARRIERS))),
        code=st.sampled_from(CODES),
        coded=st.lists(st.integers(0, 39), max_size=6),
        preamble=st.lists(st.sampled_from(["# logger", "Station: Dubna", "", "% RBW 30 kHz"]), max_size=3),
        has_counter=st.booleans(),
        spoiled=st.lists(st.integers(0, 39), max_size=2),
        is_long=st.booleans(),
    )


def level(row: int, carrier: int) -> float:
    """Return a level, dBm."""
    return round(-50.0 - 2.0 * carrier + np.sin(1.3 * row + carrier) + 0.013 * row, 3)


def epoch_cells(writing: Writing, row: int) -> list[str]:
    """Return the cells of an epoch."""
    seconds = writing.start_s + writing.step_s * row
    if writing.form.startswith("unix"):
        return [str(seconds if writing.form == "unix_s" else seconds * 1000)]
    zone = UTC if writing.form == "%Y-%m-%dT%H:%M:%SZ" else ZoneInfo(writing.zone)
    local = datetime.fromtimestamp(seconds, zone)
    if writing.form in ("mjd", "excel"):
        days = (local.replace(tzinfo=UTC) - datetime(1970, 1, 1, tzinfo=UTC)) / timedelta(days=1)
        text = f"{days + (40_587 if writing.form == 'mjd' else 25_569):.9f}"
        return [text.replace(".", ",") if writing.is_comma else text]
    return local.strftime(writing.form).split("|")


def number(writing: Writing, row: int, carrier: int) -> str:
    """Return the cell of a level."""
    if row in writing.spoiled and carrier == 1:
        return "broken"
    if row in writing.coded and carrier == 0:
        return writing.code
    dbm = level(row, carrier)
    offset_db = OFFSETS_DB[writing.unit]
    text = f"{10 ** (dbm / 10):.9e}" if offset_db is None else f"{dbm - offset_db:.3f}"
    return text.replace(".", ",") if writing.is_comma else text


def written(writing: Writing) -> bytes:
    """Return the file."""
    zone = f" ({writing.zone})" if writing.names_zone else ""
    times = [f"Date{zone}", f"Time{zone}"] if "|" in writing.form else [f"Time{zone}"]
    if writing.form in ("mjd", "excel"):
        times = [f"{writing.form.upper()} time{zone}"]
    unit = f" [{writing.unit}]" if writing.names_unit else ""
    counter = ["Record"] if writing.has_counter else []
    lines = []
    if writing.is_long:
        lines.append([*times, *counter, "Carrier", f"Level{unit}"])
    else:
        lines.append([*times, *counter, *(f"{CARRIERS[k]}{unit}" for k in writing.order)])
    for row in range(writing.rows):
        head = [*epoch_cells(writing, row), *([str(1_000_000_000 + row)] if counter else [])]
        if writing.is_long:
            lines += [[*head, CARRIERS[k], number(writing, row, k)] for k in writing.order]
        else:
            lines.append([*head, *(number(writing, row, k) for k in writing.order)])
    text = [*writing.preamble, *(writing.separator.join(line) for line in lines), ""]
    return writing.end.join(text).encode(writing.encoding)


def answers(writing: Writing) -> dict[str, Any]:
    """Return what the writer answers, by field."""
    newest = datetime.fromtimestamp(writing.start_s + writing.step_s * (writing.rows - 1), UTC)
    form = writing.form.replace("|", " ")
    return {
        "tz": writing.zone,
        "unit": writing.unit,
        "time_format": form if form != "%Y-%m-%dT%H:%M:%SZ" else "iso",
        "last_day": newest.strftime("%Y-%m-%d"),
        "missing": ["none"],
        "encoding": writing.encoding,
        "decimal": "comma" if writing.is_comma else "point",
    }


def read(path: Path, writing: Writing) -> Interpretation | None:
    """Return how the file is read once the questions are answered; None: refused."""
    stated: dict[str, Any] = {"file": path.name}
    known = answers(writing)
    now_us = (writing.start_s + 86_400) * 1_000_000
    for _ in range(8):
        statement = PowersStatement.model_validate(stated)
        try:
            found = interpret_powers(read_table(path, statement), statement, PLAN, now_us)
        except ForeignTableError:
            return None
        if not found.questions:
            return found
        if any(each.field not in known or each.field in stated for each in found.questions):
            return None
        stated |= {each.field: known[each.field] for each in found.questions}
    return None


def judge(path: Path, writing: Writing) -> bool:
    """Return whether the file is read; fail where it is read differently from what was written."""
    path.write_bytes(written(writing))
    found = read(path, writing)
    if found is None:
        return False
    rows = found.rows
    assert rows is not None
    wanted = {}
    for row in range(writing.rows):
        levels = [level(row, k) for k in range(len(CARRIERS))]
        if row in writing.coded:
            levels[0] = np.nan
        if row in writing.spoiled:
            # a row with a cell that is none is left out, of a long table that cell alone
            levels[1] = np.nan
            if not writing.is_long:
                continue
        wanted[(writing.start_s + writing.step_s * row) * 1_000_000] = levels
    for epoch_us, levels in zip(rows.epochs_us.tolist(), rows.values, strict=True):
        nearest = min(wanted, key=lambda each, epoch_us=epoch_us: abs(each - epoch_us))
        assert abs(nearest - epoch_us) <= 1000, (epoch_us, writing)
        np.testing.assert_allclose(levels, wanted.pop(nearest), atol=2e-3, err_msg=str(writing))
    assert len(wanted) <= max(3, len(found.rows.faults) if found.rows else 0), wanted
    return True


def test_a_written_table_is_read_equal_or_refused(tmp_path: Path) -> None:
    is_read = []

    @settings(max_examples=EXAMPLES, database=None)
    @given(writings())
    def write_and_read(writing: Writing) -> None:
        is_read.append(judge(tmp_path / "table.csv", writing))

    write_and_read()
    print(f"{sum(is_read)} of {len(is_read)} tables were read, the others refused")
    assert any(is_read)
    # of few drawn tables, of which some resemble each other, the share falls below a half by chance
    if len(is_read) >= OF_PROFILE["ci"]:
        assert sum(is_read) > 0.5 * len(is_read)
