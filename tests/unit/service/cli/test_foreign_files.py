"""Files of other programs, kind by kind: read right, asked about, or refused with the cause; never read differently.

Each case is a file of our own that reproduces what people report of neighbouring programs, with the sentence that the
reader answers. The table holds what must be asked (fields of the manifest), what is noted, or why it is refused.
"""

import gzip
import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest

from service.formats.foreign.columns import (
    Interpretation,
    PowersStatement,
    ReadingsStatement,
    interpret_powers,
)
from service.formats.foreign.readings import interpret_readings
from service.formats.foreign.table import Container, ForeignTableError, read_table

CARRIERS = {f"c{k:02d}": f"c{k:02d}" for k in range(3)}
START_S = 1_795_132_800  # 2026-11-20T00:00:00Z
NOW_US = (START_S + 86_400) * 1_000_000
ROWS = 60


def level(row: int, carrier: int) -> float:
    """Return a level, dBm, with two decimals."""
    return round(-45.0 - carrier + 0.3 * np.sin(1.7 * row + carrier) + 0.01 * (row % 7), 2)


def angle(row: int, axis: int) -> float:
    """Return an angle, deg, with four decimals."""
    return round(0.05 * np.sin(0.21 * row + axis) + 0.0001 * (row % 5), 4)


def epoch(row: int, form: str = "%Y-%m-%dT%H:%M:%SZ") -> str:
    """Return the epoch of a row, a minute after the other."""
    from datetime import UTC, datetime

    return datetime.fromtimestamp(START_S + 60 * row, UTC).strftime(form)


def table(
    *,
    separator: str = ",",
    time: Callable[[int], str] = epoch,
    names: str = "Time,c00 (dBm),c01 (dBm),c02 (dBm)",
    cell: Callable[[int, int], str] = lambda row, k: f"{level(row, k):.2f}",
    end: str = "\n",
    rows: int = ROWS,
) -> str:
    """Return a table of powers."""
    lines = [names.replace(",", separator) if separator != "," else names]
    lines += [separator.join((time(row), *(cell(row, k) for k in range(3)))) for row in range(rows)]
    return end.join((*lines, ""))


def readings(
    *,
    time: Callable[[int], str] = epoch,
    names: str = "Time,Yaw [deg],Roll [deg],Pitch [deg]",
    cell: Callable[[int, int], str] = lambda row, k: f"{angle(row, k):.4f}",
    rows: int = ROWS,
) -> str:
    """Return a table of angles."""
    return "\n".join((names, *(",".join((time(r), *(cell(r, k) for k in range(3)))) for r in range(rows)), ""))


def read(folder: Path, content: str | bytes, name: str = "file.csv", **stated: object) -> Interpretation:
    """Return how a file is read."""
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    is_readings = b"Yaw" in path.read_bytes() or "Крен" in str(content) or "columns" in stated
    if is_readings:
        readings_of = ReadingsStatement.model_validate({"file": name, **stated})
        return interpret_readings(read_table(path, readings_of), readings_of, NOW_US)
    powers = PowersStatement.model_validate({"file": name, **stated})
    return interpret_powers(read_table(path, powers), powers, CARRIERS, NOW_US)


def asked(found: Interpretation) -> set[str]:
    """Return the fields that must be stated."""
    return {each.field for each in found.questions}


def is_truth(found: Interpretation, *, rows: int = ROWS, is_readings: bool = False) -> bool:
    """Return whether the rows are those that were written."""
    if found.rows is None or len(found.rows.lines) != rows:
        return False
    value = angle if is_readings else level
    wanted = np.array([[value(row, k) for k in range(3)] for row in range(rows)])
    seconds = START_S + 60 * np.arange(rows)
    return bool(
        np.all(found.rows.epochs_us == seconds * 1_000_000) and np.allclose(found.rows.values, wanted, atol=5e-5)
    )


def comma(row: int, k: int) -> str:
    """Return a level with a decimal comma."""
    return f"{level(row, k):.2f}".replace(".", ",")


def xlsx(sheets: dict[str, str]) -> bytes:
    """Return a workbook of sheets, whose rows are given as XML."""
    out = io.BytesIO()
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    rel = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    with zipfile.ZipFile(out, "w") as file:
        entries, links, types = "", "", ""
        for number, (name, rows) in enumerate(sheets.items(), start=1):
            entries += f'<sheet name="{name}" sheetId="{number}" r:id="rId{number}"/>'
            links += f'<Relationship Id="rId{number}" Type="{rel}/worksheet" Target="worksheets/sheet{number}.xml"/>'
            kind = "application/vnd.openxmlformats-officedocument.spreadsheetml.worksheet+xml"
            types += f'<Override PartName="/xl/worksheets/sheet{number}.xml" ContentType="{kind}"/>'
            file.writestr(
                f"xl/worksheets/sheet{number}.xml",
                f'<worksheet xmlns="{main}"><sheetData>{rows}</sheetData></worksheet>',
            )
        styles = '<cellXfs count="2"><xf numFmtId="0"/><xf numFmtId="22" applyNumberFormat="1"/></cellXfs>'
        links += f'<Relationship Id="rId99" Type="{rel}/styles" Target="styles.xml"/>'
        file.writestr("xl/styles.xml", f'<styleSheet xmlns="{main}">{styles}</styleSheet>')
        file.writestr(
            "xl/workbook.xml", f'<workbook xmlns="{main}" xmlns:r="{rel}"><sheets>{entries}</sheets></workbook>'
        )
        package = "http://schemas.openxmlformats.org/package/2006"
        file.writestr(
            "xl/_rels/workbook.xml.rels", f'<Relationships xmlns="{package}/relationships">{links}</Relationships>'
        )
        file.writestr("[Content_Types].xml", f'<Types xmlns="{package}/content-types">{types}</Types>')
        root = f'<Relationship Id="rId1" Type="{rel}/officeDocument" Target="xl/workbook.xml"/>'
        file.writestr("_rels/.rels", f'<Relationships xmlns="{package}/relationships">{root}</Relationships>')
    return out.getvalue()


def sheet() -> str:
    """Return the rows of a sheet: instants as serial numbers of a date format."""
    names = ("Time (UTC)", "c00 (dBm)", "c01 (dBm)", "c02 (dBm)")
    lines = ["<row>" + "".join(f'<c t="inlineStr"><is><t>{name}</t></is></c>' for name in names) + "</row>"]
    for row in range(ROWS):
        serial = 25_569 + (START_S + 60 * row) / 86_400
        cells = "".join(f"<c><v>{level(row, k)}</v></c>" for k in range(3))
        lines.append(f'<row><c s="1"><v>{serial!r}</v></c>{cells}</row>')
    return "".join(lines)


def ods(text: str) -> bytes:
    """Return an OpenDocument workbook of texts."""
    kind = "application/vnd.oasis.opendocument.spreadsheet"
    rows = ""
    for line in text.splitlines():
        cells = "".join(
            f'<table:table-cell office:value-type="string"><text:p>{cell}</text:p></table:table-cell>'
            for cell in line.split(",")
        )
        rows += f"<table:table-row>{cells}</table:table-row>"
    names = "".join(
        f' xmlns:{name}="urn:oasis:names:tc:opendocument:xmlns:{name}:1.0"' for name in ("office", "table", "text")
    )
    body = f'<office:spreadsheet><table:table table:name="Levels">{rows}</table:table></office:spreadsheet>'
    content = f"<office:document-content{names}><office:body>{body}</office:body></office:document-content>"
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        file.writestr("mimetype", kind)
        file.writestr("content.xml", content)
        file.writestr("META-INF/manifest.xml", "<manifest/>")
    return out.getvalue()


def objects() -> list[str]:
    """Return the rows as objects of JSON."""
    return [json.dumps({"Time": epoch(r), **{f"c{k:02d} (dBm)": level(r, k) for k in range(3)}}) for r in range(ROWS)]


def zipped(**files: str) -> bytes:
    """Return a zip of files."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        for name, text in files.items():
            file.writestr(name.replace("_csv", ".csv"), text)
    return out.getvalue()


#: what each kind reads to, without a question
RIGHT: dict[str, str | bytes] = {
    "as usual": table(),
    "sep line": "sep=;\n" + table(separator=";"),
    "comments before the header": "# logger v2\n# RBW=30kHz, VBW=300kHz\n" + table(),
    "header in a comment": "# " + table(),
    "preamble of other width": "Station;Dubna\nAnalyzer;FSV\n\n" + table(separator=";"),
    "decimal commas and commas in names": table(
        separator=";", names="Time,c00§ dBm,c01§ dBm,c02§ dBm", cell=comma
    ).replace("§", ","),
    "tabs": table(separator="\t"),
    "blanks": table(separator=" ", names="Time,c00_dbm,c01_dbm,c02_dbm"),
    "CR only": table(end="\r"),
    "CR LF": table(end="\r\n"),
    "U+0085": table(end="\x85"),
    "UTF-16": table().encode("utf-16"),
    "UTF-16 without a mark": table().encode("utf-16-le"),
    "byte order mark": b"\xef\xbb\xbf" + table().encode(),
    "gzip": gzip.compress(table().encode()),
    "zip of one": zipped(levels_csv=table()),
    "unit row": table(names="Time,c00,c01,c02").replace("c02\n", "c02\nUTC,dBm,dBm,dBm\n"),
    "repeated header": table().replace(epoch(30), "Time,c00 (dBm),c01 (dBm),c02 (dBm)\n" + epoch(30)),
    "footer": table() + "End of file\n",
    "footer of the same width": table() + "Mean,-45.1,-46.1,-47.1\n",
    "blank columns": table().replace("\n", ",\n"),
    "blank rows": table().replace("\n", "\n,,,\n\n"),
    "quoted": table(cell=lambda row, k: f'"{level(row, k):.2f}"'),
    "date and time apart, a counter": table(
        time=lambda r: f"{epoch(r, '%d.%m.%Y,%H:%M:%S')},{1_000_000_000 + r}",
        names="Date (UTC),Time (UTC),Record,c00 (dBm),c01 (dBm),c02 (dBm)",
    ),
    "a frequency of oscillators": table(
        time=lambda r: f"{epoch(r, '%Y-%m-%d,%H:%M:%SZ')},975000000",
        names="Date,Time,LO Freq (Hz),c00 (dBm),c01 (dBm),c02 (dBm)",
    ),
    "month names": table(time=lambda r: epoch(r, "%d-%b-%Y %H:%M:%S"), names="Time UTC,c00 (dBm),c01 (dBm),c02 (dBm)"),
    "half days": table(time=lambda r: epoch(r, "%Y-%m-%d %I:%M:%S %p"), names="Time GMT,c00 (dBm),c01 (dBm),c02 (dBm)"),
    "day of the year": table(time=lambda r: epoch(r, "%Y-%jT%H:%M:%S.000Z")),
    "day of the year and a blank": table(time=lambda r: epoch(r, "%Y-%j %H:%M:%SZ")),
    "zone in the name": table(
        time=lambda r: epoch(r + 180, "%d.%m.%Y %H:%M:%S"), names="Time (UTC+3),c00 (dBm),c01 (dBm),c02 (dBm)"
    ),
    "offsets": table(time=lambda r: epoch(r + 180, "%Y-%m-%d %H:%M:%S+0300")),
    "unix seconds": table(time=lambda r: str(START_S + 60 * r), names="unix time,c00 (dBm),c01 (dBm),c02 (dBm)"),
    "unix milliseconds": table(time=lambda r: f"{START_S + 60 * r}000", names="timestamp_ms,c00_dbm,c01_dbm,c02_dbm"),
    "unix nanoseconds": table(time=lambda r: f"{START_S + 60 * r}000000000", names="epoch,c00_dbm,c01_dbm,c02_dbm"),
    "milliwatts": table(
        names="Time,c00 (mW),c01 (mW),c02 (mW)", cell=lambda row, k: f"{10 ** (level(row, k) / 10):.10e}"
    ),
    "units in the cells": table(names="Time,c00,c01,c02", cell=lambda row, k: f"{level(row, k):.2f} dBm"),
    "one level a line": "Time,Carrier,Level dBm\n"
    + "".join(f"{epoch(r)},c{k:02d},{level(r, k):.2f}\n" for r in range(ROWS) for k in range(3)),
    "sign of typography": table(cell=lambda row, k: f"\N{MINUS SIGN}{-level(row, k):.2f}"),
    "a workbook": xlsx({"Levels": sheet(), "Empty": ""}),
    "an OpenDocument sheet": ods(table()),
    "JSON lines": "".join(f"{each}\n" for each in objects()),
    "an array of objects": f"[{','.join(objects())}]",
}


@pytest.mark.parametrize("kind", RIGHT)
def test_kinds_of_files_are_read_right(tmp_path: Path, kind: str) -> None:
    found = read(tmp_path, RIGHT[kind])
    assert (asked(found), found.rows and found.rows.faults) == (set(), []), found.questions
    assert is_truth(found), found.notes


@pytest.mark.parametrize("encoding", ["utf-8", "cp1251", "koi8-r", "cp866", "utf-16"])
def test_names_in_other_encodings_are_read(tmp_path: Path, encoding: str) -> None:
    names = "Время (UTC);Рыскание, град;Крен, град;Тангаж, град"
    text = readings(time=lambda r: epoch(r, "%d.%m.%Y %H:%M:%S"), names="@").replace(",", ";").replace(".", ",")
    text = text.replace("@", names).replace("20,11,2026", "20.11.2026")
    found = read(tmp_path, text.encode(encoding), columns={})
    assert asked(found) == set()
    assert is_truth(found, is_readings=True)


def spoiled(rows: dict[int, str], carrier: int = 0) -> str:
    """Return a table with other cells of one carrier in some rows."""
    return table(cell=lambda row, k: rows.get(row, "") if row in rows and k == carrier else f"{level(row, k):.2f}")


@pytest.mark.parametrize(
    "code", ["9.91E+37", "9.91e37", "9.9E37", "-9.9E37", "OVLD", "<-80", "---", "n/a", "NaN", "", "#N/A", "-inf"]
)
def test_a_cell_without_a_reading_is_absent_and_its_row_stays(tmp_path: Path, code: str) -> None:
    found = read(tmp_path, spoiled(dict.fromkeys(range(0, 40, 2), code)))
    assert asked(found) == set()
    assert found.rows is not None
    assert len(found.rows.lines) == ROWS
    absent = np.isnan(found.rows.values)
    assert np.flatnonzero(absent[:, 0]).tolist() == list(range(0, 40, 2))
    assert not absent[:, 1:].any()


#: what each kind asks, and the guess
ASKED: dict[str, tuple[str, dict[str, object]]] = {
    "no zone": (table(time=lambda r: epoch(r, "%Y-%m-%d %H:%M:%S")), {"tz": "UTC"}),
    "local time": (
        table(time=lambda r: epoch(r, "%Y-%m-%d %H:%M:%S"), names="Local time,c00 (dBm),c01 (dBm),c02 (dBm)"),
        {"tz": "UTC"},
    ),
    "GPS calendar": (
        table(time=lambda r: epoch(r, "%Y-%m-%d %H:%M:%S"), names="GPS time,c00 (dBm),c01 (dBm),c02 (dBm)"),
        {"tz": "GPS"},
    ),
    "carriers among other words": (
        table(names="Time,Уровень c00 (дБм),Уровень c01 (дБм),Уровень c02 (дБм)"),
        {"carriers": {f"Уровень c{k:02d} (дБм)": f"c{k:02d}" for k in range(3)}},
    ),
    "GPS in the name, Z in the cells": (table(names="GPS time,c00 (dBm),c01 (dBm),c02 (dBm)"), {"tz": "UTC"}),
    "GPS seconds": (
        table(
            time=lambda r: str(START_S + 60 * r - 315_964_800 + 18), names="gps_seconds,c00 (dBm),c01 (dBm),c02 (dBm)"
        ),
        {"tz": "GPS"},
    ),
    "GPS week": (
        table(time=lambda r: f"2445,{432_018 + 60 * r}", names="GPS week,TOW (s),c00 (dBm),c01 (dBm),c02 (dBm)"),
        {"tz": "GPS"},
    ),
    "day and month": (
        table(time=lambda r: epoch(r, "%Y-%m-%dT%H:%M:%SZ").replace("2026-11-20", "10/11/2026")),
        {"time_format": "%d/%m/%Y %H:%M:%S"},
    ),
    "year or day first": (
        table(time=lambda r: epoch(r, "%H:%M:%SZ").join(("11.10.12 ", ""))),
        {"time_format": "%d.%m.%y %H:%M:%S"},
    ),
    "MJD": (
        table(time=lambda r: f"{40_587 + (START_S + 60 * r) / 86_400:.8f}", names="MJD,c00 (dBm),c01 (dBm),c02 (dBm)"),
        {"tz": "UTC"},
    ),
    "serial numbers of a workbook": (
        table(time=lambda r: f"{25_569 + (START_S + 60 * r) / 86_400:.8f}"),
        {"tz": "UTC"},
    ),
    "time of day only": (table(time=lambda r: epoch(r, "%H:%M:%S")), {"date": None}),
    "two clocks": (
        table(time=lambda r: f"{epoch(r)},{epoch(r + 1)}", names="Begin,End,c00 (dBm),c01 (dBm),c02 (dBm)"),
        {"time_columns": "Begin"},
    ),
    "no unit": (table(names="Time,c00,c01,c02"), {"unit": "dBm"}),
    "milliwatts without a unit": (
        table(names="Time,c00,c01,c02", cell=lambda row, k: f"{10 ** (level(row, k) / 10):.4e}"),
        {"unit": "mW"},
    ),
    "milliwatts called dBm": (table(cell=lambda row, k: f"{10 ** (level(row, k) / 10):.4e}"), {"unit": "mW"}),
    "two columns of one carrier": (
        table(names="Time,c00 (dBm),C00 (dBm),c02 (dBm)"),
        {"carriers": None},
    ),
    "a repeated code": (spoiled(dict.fromkeys((3, 9, 27), "-99.99")), {"missing": ["-99.99"]}),
    "a repeated zero": (spoiled(dict.fromkeys((3, 9), "0.00")), {"missing": ["0"]}),
    "a column that never changes": (
        table(cell=lambda row, k: "-200.00" if k == 1 else f"{level(row, k):.2f}"),
        {"missing": ["-200"]},
    ),
    "old": (table().replace("2026-11-20", "2025-11-20"), {"last_day": "2025-11-20"}),
    "in the future": (table().replace("2026-11-20", "2027-11-20"), {"last_day": "2027-11-20"}),
    "angles without a unit": (readings(names="Time,Yaw,Roll,Pitch"), {"unit": "deg"}),
    "millidegrees called deg": (readings(cell=lambda row, k: f"{1000 * angle(row, k):.1f}"), {"unit": "mdeg"}),
    "angles beyond the disc": (readings(cell=lambda r, k: f"{20.0 + r + angle(r, k):.4f}", rows=30), {"unit": "mdeg"}),
    "tiny angles": (readings(names="Time,Yaw [arcsec],Roll [arcsec],Pitch [arcsec]"), {"unit": "deg"}),
    "angles of a code": (
        readings(cell=lambda row, k: "-99.99" if row % 20 == 0 else f"{angle(row, k):.4f}"),
        {"missing": ["-99.99"]},
    ),
    "rows of zeros": (
        readings(cell=lambda row, k: "0.00" if row % 20 == 0 else f"{angle(row, k) + 0.11:.4f}"),
        {"missing": ["0"]},
    ),
}


@pytest.mark.parametrize("kind", ASKED)
def test_what_no_content_proves_is_asked_with_a_guess(tmp_path: Path, kind: str) -> None:
    text, wanted = ASKED[kind]
    found = read(tmp_path, text)
    guesses = {each.field: each.default for each in found.questions}
    assert {name: guesses.get(name, "not asked") for name in wanted} == wanted


@pytest.mark.parametrize(
    ("kind", "stated", "more"),
    [
        ("GPS calendar", {"tz": "GPS"}, -18),
        ("GPS seconds", {"tz": "GPS"}, 0),
        ("GPS week", {"tz": "GPS"}, 0),
        ("MJD", {"tz": "UTC"}, 0),
        ("time of day only", {"date": "2026-11-20", "tz": "UTC"}, 0),
    ],
)
def test_what_is_stated_is_obeyed(tmp_path: Path, kind: str, stated: dict[str, object], more: int) -> None:
    found = read(tmp_path, ASKED[kind][0], **stated)
    assert asked(found) == set()
    assert found.rows is not None
    wanted = (START_S + more + 60 * np.arange(ROWS)) * 1_000_000
    assert np.abs(found.rows.epochs_us - wanted).max() <= 1000


#: why each kind is refused
REFUSED: dict[str, tuple[str | bytes, str]] = {
    "several sheets": (xlsx({"A": sheet(), "B": sheet(), "C": sheet()}), "an Excel workbook with 3 sheets"),
    "zip of two": (zipped(a_csv=table(), b_csv=table()), "a zip of 2 files"),
    "a picture": (b"\x89PNG\r\n\x1a\n" + bytes(100), "a picture, which is no table"),
    "decimal commas between commas": (table(cell=comma), "needs another separator or quotes"),
    "columns twice": (table(names="Time,c00 (dBm),c00 (dBm),c02 (dBm)"), "columns occur twice"),
    "decimals of two kinds": (
        table(separator=";", cell=lambda r, k: comma(r, k) if k else f"{level(r, k):.2f}"),
        "decimals of two kinds",
    ),
    "no names": ("\n".join(table().splitlines()[1:]) + "\n", "no line of names"),
    "a tenth is no number": (spoiled(dict.fromkeys(range(6), "high")), "6 of 60 rows cannot be read"),
    "a word for no reading": (spoiled(dict.fromkeys(range(6), "UNLOCK")), "like 'UNLOCK'"),
    "an open quote": (table().replace("-45.", '"-45.', 1), "a quote is not closed"),
    "quotes that swallow rows": (
        table(cell=lambda r, k: f"{'' if k or r not in (5, 20) else chr(34)}{level(r, k):.2f}"),
        "a quote spans",
    ),
    "another separator": (table() + table(separator=";").split("\n", 1)[1], "another separator than the header"),
    "seconds cut off": (
        table(time=lambda r: epoch(r // 6, "%Y-%m-%d %H:%MZ")),
        "are the seconds cut off",
    ),
    "half of the epochs": (table(time=lambda r: epoch(r) if r % 2 else "power fail"), "cannot be read"),
    "zero bytes": (table().encode()[:300] + bytes(50) + table().encode()[300:], "zero bytes"),
    "levels that no analyzer shows": (table(cell=lambda r, k: f"{level(r, k) + 900:.2f}"), "the middle level"),
    "a column in two units": (
        readings(names="Time,Yaw [deg],Yaw [deg],Pitch [deg]"),
        "columns occur twice",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_read_right_is_refused_with_the_cause(tmp_path: Path, kind: str) -> None:
    content, message = REFUSED[kind]
    with pytest.raises(ForeignTableError) as refusal:
        read(tmp_path, content)
    assert message in str(refusal.value)


@pytest.mark.parametrize("rows", [1, 3])
def test_few_rows_are_left_out_with_their_lines(tmp_path: Path, rows: int) -> None:
    found = read(tmp_path, spoiled(dict.fromkeys(range(10, 10 + rows), "high")))
    assert found.rows is not None
    assert [line for line, _ in found.rows.faults] == list(range(12, 12 + rows))
    assert "'c00 (dBm)' holds no number" in found.rows.faults[0][1]
    assert f"{rows} rows" in found.notes[-1]


def test_partial_stores_the_rest(tmp_path: Path) -> None:
    found = read(tmp_path, spoiled(dict.fromkeys(range(20), "high")), partial=True)
    assert found.rows is not None
    assert (len(found.rows.lines), len(found.rows.faults)) == (ROWS - 20, 20)


def test_angles_of_a_whole_turn_are_wrapped(tmp_path: Path) -> None:
    found = read(tmp_path, readings(cell=lambda row, k: f"{angle(row, k) % 360.0:.4f}"))
    assert asked(found) == set()
    assert is_truth(found, is_readings=True)


def test_a_single_reading_beyond_the_disc_is_refused_by_itself(tmp_path: Path) -> None:
    found = read(tmp_path, readings(cell=lambda row, k: "-99.99" if row == 7 else f"{angle(row, k):.4f}"))
    assert found.rows is not None
    ((line, reason),) = found.rows.faults
    assert (line, "beyond the Earth's disc" in reason) == (9, True)


def test_a_clock_that_was_not_set_costs_its_rows_only(tmp_path: Path) -> None:
    found = read(tmp_path, table(time=lambda r: epoch(r) if r > 1 else f"2000-01-01T00:0{r}:00Z"))
    assert found.rows is not None
    assert [line for line, _ in found.rows.faults] == [2, 3]
    assert "years apart" in found.rows.faults[0][1]


def test_the_order_of_the_days_proves_day_and_month(tmp_path: Path) -> None:
    from datetime import UTC, datetime

    def local(row: int) -> str:
        return datetime.fromtimestamp(1_794_182_400 + 600 * row, UTC).strftime("%d.%m.%Y %H:%M:%S")

    found = read(tmp_path, table(time=local, rows=200), tz="UTC", last_day="2026-11-10")
    assert asked(found) == set()
    assert found.rows is not None
    assert found.rows.epochs_us[0] == 1_794_182_400_000_000


def test_times_of_day_roll_over_at_midnight(tmp_path: Path) -> None:
    found = read(tmp_path, table(time=lambda r: epoch(r + 1410, "%H:%M:%S")), date="2026-11-20", tz="UTC")
    assert found.rows is not None
    assert found.rows.epochs_us.tolist() == [(START_S + 60 * (r + 1410)) * 1_000_000 for r in range(ROWS)]


def test_hours_that_the_clocks_repeat_are_told_apart_by_their_order(tmp_path: Path) -> None:
    from datetime import UTC, datetime
    from zoneinfo import ZoneInfo

    start_s = int(datetime(2026, 10, 25, 0, 0, tzinfo=UTC).timestamp())
    zone = ZoneInfo("Europe/Berlin")

    def local(row: int) -> str:
        return datetime.fromtimestamp(start_s + 300 * row, zone).strftime("%Y-%m-%d %H:%M:%S")

    found = read(tmp_path, table(time=local), tz="Europe/Berlin", last_day="2026-10-25")
    assert found.rows is not None
    assert found.rows.epochs_us.tolist() == [(start_s + 300 * row) * 1_000_000 for row in range(ROWS)]


def test_a_last_line_without_its_end_is_left_out(tmp_path: Path) -> None:
    found = read(tmp_path, table()[:-3])
    assert found.rows is not None
    assert (len(found.rows.lines), found.rows.faults[0][1]) == (
        ROWS - 1,
        "the last line does not end; the file may be cut off",
    )


@pytest.mark.parametrize("zone", [None, "UTC", "Asia/Tokyo"])
@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_parquet_is_read_with_and_without_a_zone(tmp_path: Path, zone: str | None, unit: str) -> None:
    seconds = np.array([START_S + 60 * row for row in range(ROWS)])
    times = pa.array(seconds * 1000, pa.timestamp("ms")).cast(pa.timestamp(unit, tz=zone))
    columns = {f"c{k:02d}_dbm": [level(row, k) for row in range(ROWS)] for k in range(3)}
    parquet.write_table(pa.table({"time": times, **columns}), tmp_path / "t.parquet")
    found = read(tmp_path, (tmp_path / "t.parquet").read_bytes(), "t.parquet")
    assert asked(found) == (set() if zone else {"tz"})
    assert is_truth(found)


def test_a_carrier_name_that_two_have_is_asked(tmp_path: Path) -> None:
    path = tmp_path / "file.csv"
    path.write_text(table(names="Time,Omsk (dBm),c01 (dBm),c02 (dBm)"))
    powers = PowersStatement(file="file.csv")
    found = interpret_powers(read_table(path, Container()), powers, CARRIERS | {"Omsk": ""}, NOW_US)
    assert "carriers" in asked(found)


def test_stated_separator_lines_and_encoding_are_obeyed(tmp_path: Path) -> None:
    text = "a,b,c,d\n1,2,3,4\n" + table()
    found = read(tmp_path, text.encode("cp1251"), skip_lines=2, separator=",", encoding="cp1251")
    assert is_truth(found)
    for wrong, message in (({"separator": "ab"}, "write one sign"), ({"encoding": "klingon"}, "encoding 'klingon'")):
        with pytest.raises(ForeignTableError, match=message):
            read(tmp_path, text, **wrong)
