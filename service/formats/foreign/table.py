"""Files of other programs as tables of cells: containers, encodings, separators, headers; every cell stays a text.

Text, workbooks (xlsx, xls, ods), Parquet and lines of JSON give one `Table`. Lines before the header, comments,
unit rows, repeated headers and footers are no rows and are named in the notes. A row of another width is a fault of its
line. Whatever a library raises becomes a `ForeignTableError` with what to do next.
"""

import csv
import gzip
import io
import json
import re
import zipfile
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import date, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

#: bytes of a file, unpacked
MOST_BYTES = 2 << 30
SEPARATORS = (",", ";", "\t", "|")
_BY_NAME = {"tab": "\t", "space": " ", "comma": ",", "semicolon": ";", "bar": "|"}
#: lines and rows from which separator and header are found
_SAMPLE = 600
#: lines below a table that are no rows, and not its faults
_MOST_FOOTER = 10
_TAB, _BLANK = "\t", " \t,;|"
_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe\0\0": "utf-32", b"\0\0\xfe\xff": "utf-32"}
_MARKS |= {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_NO_TABLE = {
    b"%PDF": "a PDF document",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
    b"\x89HDF": "an HDF5 file",
    b"MATLAB": "a MATLAB file",
    b"ARROW1": "an Arrow file",
    b"SQLite": "an SQLite database",
    b"7z\xbc\xaf": "a 7-Zip archive",
    b"Rar!": "a RAR archive",
    b"CDF": "a NetCDF file",
}
_PLAIN_SIGNS = dict.fromkeys("\r\x85\u2028\u2029\v\f", "\n") | {"\u2212": "-"}
_PLAIN_SIGNS |= dict.fromkeys("\xa0\u2007\u2009\u202f", " ")
#: single-byte encodings that are told apart; names only depend on them, numbers are ASCII in each
_ENCODINGS = ["cp1251", "koi8_r", "cp866", "cp1252"]
_COMMENT = re.compile(r"\s*(#|%|//|!)\s*")


def word_set(*words: str) -> frozenset[str]:
    """Return the words of texts."""
    return frozenset(" ".join(words).split())


#: cells without a reading, lower case; those of SCPI and spreadsheets among them
CODES = frozenset({"", "no data", "no signal", "нет данных"}) | word_set(
    "nan -nan null none na n/a #n/a - -- --- ---- * ** *** **** ? ?? ??? nil missing nodata no_data ovld ovl ovr ol",
    "over under uncal err error invalid fault bad off inf +inf -inf infinity -infinity #value! #div/0! #ref! #num!",
    "#null! #name? 1.#qnan -1.#ind 1.#inf -1.#inf н/д нет overload underrange overrange",
)
NUMBER = r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eEdD][+-]?\d+)?"
_VALUE = re.compile(
    rf"{NUMBER}|{NUMBER} ?(?:dBm|dBW|[mµu]?W|m?deg|°|rad|mrad|arcsec)"
    r"|[<>]=? ?[+-]?\d[\d.,]*"
    r"|(?:[^\W\d]{3,9}[., ]+)*\d{1,4} ?[-./:T ] ?(?:\d{1,3}|[^\W\d]{3,9})(?:[-./:T ]|, ?)?[\w:.\-/+ ]*,?\d*Z?"
    r"|\d{8}T?\d{4,6}[\d.]*Z?"
)
_UNIT_WORDS = word_set(
    "dbm dbw mw w µw uw nw pw db deg degree degrees ° mdeg rad mrad arcsec arcmin µrad urad utc gmt s sec "
    "ms us ns hz khz mhz ghz h min c k v a % yyyy-mm-dd hh:mm:ss dd.mm.yyyy град дбм дбвт - iso8601 iso "
    "text string"
)


class ForeignTableError(ValueError):
    """The file cannot be read; the text says why and what to do."""


class Question(NamedTuple):
    """One thing that a person must state, because no content proves it."""

    #: field of the manifest
    field: str
    text: str
    #: what may be answered; empty = free text
    choices: tuple[str, ...] = ()
    #: answer that the content suggests
    default: Any = None


class Container(BaseModel):
    """Statement of a person about the container; None = not stated."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sheet: str | None = None
    encoding: str | None = None
    separator: str | None = None
    skip_lines: Annotated[int, Field(ge=0)] = 0


@dataclass(slots=True)
class Table:
    """Columns of texts, without blanks around them; an empty text is an empty cell."""

    header: list[str]
    #: arrays of pyarrow, one a column
    columns: list[Any]
    #: physical line of each row; of a workbook its row
    lines: NDArray[np.int64]
    #: line and reason of each row that is none
    faults: list[tuple[int, str]] = field(default_factory=list)
    #: how the file was understood
    notes: list[str] = field(default_factory=list)
    #: unit that the row below the header states, by column
    units: dict[str, str] = field(default_factory=dict)
    #: a standard states columns, units and what an absent value is
    is_standard: bool = False

    def column(self, name: str) -> Any:
        """Return a column by its name; ForeignTableError when there is none."""
        if name not in self.header:
            raise ForeignTableError(f"no column {name[:60]!r}; the columns are {', '.join(self.header[:20])}")
        return self.columns[self.header.index(name)]


def read_table(path: Path, stated: Container) -> Table:
    """Return the table of a file, read to its end.

    Raises
    ------
    ForeignTableError
        No table, several where none was stated, or one whose separator or header is not clear.
    """
    if path.stat().st_size > MOST_BYTES:
        raise ForeignTableError(f"the file is larger than {MOST_BYTES >> 30} GiB; split it by days")
    name, content = unpacked(path.name, path.read_bytes())
    if content[:4] == b"PAR1":
        return _of_parquet(content)
    commas = stated.model_copy(update={"separator": ","})
    if is_workbook(content):
        return _of_text(workbook_text(content, stated.sheet), commas, ["a sheet of a workbook"])
    text, notes = decoded_text(content, stated.encoding)
    if name.lower().endswith((".ndjson", ".jsonl")) or text.lstrip()[:1] in ("{", "["):
        return _of_text(_text_of_objects(text), commas, ["JSON objects"])
    return _of_text(text, stated, notes)


def unpacked(name: str, content: bytes) -> tuple[str, bytes]:
    """Return name and content of the only file in a packed one; ForeignTableError names what is no table."""
    try:
        if content[:2] == b"\x1f\x8b":
            with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
                return _bounded(name.removesuffix(".gz"), file.read(MOST_BYTES + 1))
        if content[:4] == b"PK\x03\x04" and not is_workbook(content):
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                names = [each for each in archive.namelist() if not re.search(r"/$|^__MACOSX|(^|/)\.", each)]
                if len(names) != 1:
                    raise ForeignTableError(f"a zip of {len(names)} files ({', '.join(names[:5])}): unpack it")
                with archive.open(names[0]) as member:
                    return _bounded(Path(names[0]).name, member.read(MOST_BYTES + 1))
    except (OSError, EOFError, zlib.error, zipfile.BadZipFile, RuntimeError, NotImplementedError) as error:
        raise ForeignTableError(f"the packed file cannot be unpacked: {error}; unpack it yourself") from None
    kind = next((kind for start, kind in _NO_TABLE.items() if content.startswith(start)), None)
    if kind is not None:
        raise ForeignTableError(f"{kind}, which is no table; export CSV, a workbook or Parquet")
    return name, content


def _bounded(name: str, content: bytes) -> tuple[str, bytes]:
    """Return an unpacked file unless it is too large."""
    if len(content) > MOST_BYTES:
        raise ForeignTableError(f"the file holds more than {MOST_BYTES >> 30} GiB; split it by days")
    return name, content


def is_workbook(content: bytes) -> bool:
    """Return whether a file is xlsx, xlsb, ods or xls."""
    if content[:8] == b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1":
        return True
    is_zip = content[:4] == b"PK\x03\x04"
    return is_zip and (b"xl/workbook" in content or b"application/vnd.oasis.opendocument.spreadsheet" in content[:200])


def decoded_text(content: bytes, encoding: str | None) -> tuple[str, list[str]]:
    """Return the text of a file with one end of lines, and how it was decoded.

    Raises
    ------
    ForeignTableError
        No such encoding, a text that is none in it, or bytes that are no text.
    """
    found = encoding or next((name for mark, name in _MARKS.items() if content.startswith(mark)), None)
    found = found or _encoding_of(content)
    try:
        text = content.decode(found)
    except LookupError:
        raise ForeignTableError(f"the encoding {found[:40]!r} is unknown; write utf-8, cp1251, koi8-r") from None
    except UnicodeDecodeError as error:
        raise ForeignTableError(f"the text is not {found}: {error.reason}; state encoding, as cp1251") from None
    text = text.removeprefix("\ufeff").rstrip("\0")
    if "\0" in text:
        raise ForeignTableError("the file holds zero bytes: a binary file, or one that was not written to its end")
    text = re.sub("\r*\n", "\n", text) if "\r" in text else text
    # ends of lines, and blanks and signs of typography, which no number has
    for sign, plain in _PLAIN_SIGNS.items():
        text = text.replace(sign, plain)
    return text, [] if found in ("utf-8", "utf-8-sig") else [f"encoding {found}"]


def _encoding_of(content: bytes) -> str:
    """Return the likely encoding of a text without a mark."""
    head = content[:4096]
    if head.count(0) > len(head) // 4:
        return "utf-16-le" if head[1::2].count(0) > head[::2].count(0) else "utf-16-be"
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        # a second that only such files need
        from charset_normalizer import from_bytes

        odd = b"\n".join(line for line in re.split(rb"[\r\n\x85]+", content[: 1 << 20]) if not line.isascii())[:4096]
        best = from_bytes(odd, cp_isolation=_ENCODINGS).best()
        if best is None and b"\x85" in content and b"\n" not in content:
            return "latin-1"
        return "cp1252" if best is None else best.encoding
    return "utf-8"


def is_value(cell: str) -> bool:
    """Return whether a cell is a number, a date, a time of day or a code for no reading, and no name."""
    return cell.lower() in CODES or _VALUE.fullmatch(cell) is not None


def _is_data(cells: Sequence[str]) -> bool:
    """Return whether a row holds values and no names."""
    held = [cell.strip() for cell in cells if cell.strip()]
    values = sum(map(is_value, held))
    return values > 0 and 2 * values >= len(held)


def _of_text(text: str, stated: Container, notes: list[str]) -> Table:
    separator, first = _stated_separator(stated.separator), stated.skip_lines
    if separator is None and (named := re.match(r'"?sep=(.)"?\s*\n', text)):
        separator, first = named.group(1), max(first, 1)
    if text.count('"') % 2:
        number = next(k for k, line in enumerate(text.split("\n"), start=1) if line.count('"') % 2)
        raise ForeignTableError(f"line {number}: a quote is not closed; correct it, or remove the sign")
    numbered, comments = _head_of(text, first)
    if len(numbered) < 2:
        raise ForeignTableError("the file has no header with lines below it")
    sample = [line for _, line in numbered]
    if separator is None:
        separator = _separator_of(sample)
        notes = [*notes, f"separated by {'tabs' if separator == _TAB else separator.replace(' ', 'blanks')}"]
    top = _top_of([_split(line, separator) for line in sample], comments, separator)
    if top.header_position > 0:
        notes = [f"{top.header_position} lines before the header", *notes]
    return _of_rows(text, numbered[top.first_row][0], separator, top, notes)


def _stated_separator(stated: str | None) -> str | None:
    if stated is None:
        return None
    found = _BY_NAME.get(stated.lower(), stated.replace("\\t", "\t"))
    if len(found) != 1 or found.isalnum() or found in '".-+':
        raise ForeignTableError(f"the separator {stated[:20]!r} is none; write one sign, tab or space")
    return found


def _head_of(text: str, first: int) -> tuple[list[tuple[int, str]], dict[int, str]]:
    """Return the first lines that hold something, with their numbers, and comments by the position of the line below.

    Lines that a quoted cell spans become one.
    """
    numbered: list[tuple[int, str]] = []
    comments: dict[int, str] = {}
    is_inside = False
    for number, line in enumerate(text.split("\n", first + 4 * _SAMPLE)[first : first + 4 * _SAMPLE], start=first + 1):
        is_odd = line.count('"') % 2 == 1
        if is_inside:
            begin, start = numbered[-1]
            numbered[-1], is_inside = (begin, f"{start} {line}"), not is_odd
        elif (mark := _COMMENT.match(line)) is not None:
            comments[len(numbered)] = line[mark.end() :]
        elif line.strip(_BLANK):
            numbered.append((number, line))
            is_inside = is_odd
        if len(numbered) > _SAMPLE:
            break
    return numbered[:_SAMPLE], comments


def _split(line: str, separator: str) -> list[str]:
    if '"' in line:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=separator != "\t"))
    return line.split() if separator == " " else line.split(separator)


def _separator_of(sample: list[str]) -> str:
    """Return the separator that leaves numbers, dates and codes in the cells of most lines."""
    scores: dict[str, float] = {}
    for mark in (*SEPARATORS, " "):
        rows = [_split(line, mark) for line in sample]
        ((width, count),) = Counter(map(len, rows)).most_common(1)
        cells = [cell.strip() for row in rows if len(row) == width for cell in row if cell.strip()]
        values = sum(map(is_value, cells))
        scores[mark] = 0.0 if width < 2 or not cells else values / len(cells) * count / len(rows)
    best = max(SEPARATORS, key=lambda mark: scores[mark])
    if scores[best] < 0.4 < scores[" "]:
        return " "
    rivals = [mark for mark in SEPARATORS if mark != best and scores[mark] > 0.8 * scores[best]]
    if scores[best] < 0.25 or rivals:
        shown = ", ".join(f"{mark!r} leaves {scores[mark]:.0%} values" for mark in SEPARATORS if scores[mark])
        detail = f"mixed separators: {shown}" if shown else "no comma, semicolon, tab or bar splits the lines alike"
        raise ForeignTableError(f"{detail}; state separator, or skip_lines for the lines before the header")
    return best


class _Top(NamedTuple):
    """Header of a table and where its rows begin."""

    header: list[str]
    width: int
    header_position: int
    first_row: int
    #: cells of the unit row, as it is written
    unit_row: list[str]

    @property
    def units(self) -> dict[str, str]:
        """Units by column."""
        pairs = zip(self.header, self.unit_row, strict=False)
        return {name: unit.strip(" ()[]") for name, unit in pairs if unit.strip()}


def _top_of(rows: list[list[str]], comments: dict[int, str], separator: str) -> _Top:
    """Return the header above the first row of values that has the width of most rows."""
    ((width, _),) = Counter(len(row) for row in rows if _is_data(row)).most_common(1) or [(0, 0)]
    first = next((k for k, row in enumerate(rows) if len(row) == width and _is_data(row)), None)
    if first is None:
        raise ForeignTableError("no line holds values of a table: no number, date or time of day")
    position, unit_row = first - 1, []
    while position >= 0 and _is_unit_row(rows[position]):
        unit_row, position = rows[position], position - 1
    header = rows[position] if position >= 0 else []
    commented = comments.get(first)
    if commented is not None and len(header) != width and len(_split(commented, separator)) == width:
        header, position = _split(commented, separator), 0
    while len(header) > width and not header[-1].strip():
        header = header[:-1]
    if len(header) == width - 1 and not any(row[-1].strip() for row in rows[first:] if len(row) == width):
        header = [*header, ""]
    if len(header) != width:
        shown = f"the line above has {len(header)}" if header else "there is no line of names above it"
        hint = "; a decimal comma needs another separator or quotes" if separator == "," and header else ""
        raise ForeignTableError(f"the first row of values has {width} cells, {shown}{hint}; write one header line")
    return _Top([" ".join(name.split()).strip("'\" ") for name in header], width, max(position, 0), first, unit_row)


def _is_unit_row(cells: Sequence[str]) -> bool:
    held = [cell.strip(" ()[]").lower() for cell in cells if cell.strip(" ()[]")]
    return bool(held) and all(cell in _UNIT_WORDS for cell in held) and any(cell not in CODES for cell in held)


def _of_rows(text: str, first_line: int, separator: str, top: _Top, notes: list[str]) -> Table:
    """Return the table of the rows from a line on; rows of another width are faults, or a footer below all others."""
    import pyarrow as pa

    text = text.split("\n", first_line - 1)[-1]
    columns, others = _cells_of(text, separator, top.width)
    count = len(columns[0]) + len(others)
    rows = np.delete(np.arange(count), [row for row, _, _ in others])
    spans = np.ones(count, dtype=np.int64)
    is_swallowed = np.zeros(len(rows), dtype=np.bool_)
    for column in columns if '"' in text else ():
        ends, marks = (_count_of(column, mark) for mark in ("\n", separator))
        spans[rows] += ends
        is_swallowed |= (ends > 0) & (marks > 0)
    for row, _, line in others:
        spans[row] += line.count("\n")
    lines = first_line + np.cumsum(spans) - spans
    reasons = {row: _fault_of(width, line, separator, top) for row, width, line in others}
    reasons |= dict.fromkeys(rows[is_swallowed].tolist(), "a quote spans the ends of lines and separators")
    is_row = ~is_swallowed & _is_row(columns, top.header[0])
    if not text.endswith("\n"):
        reasons[len(lines) - 1] = "the last line does not end; the file may be cut off"
        is_row &= rows < len(lines) - 1
    if not is_row.any():
        shown = next(filter(None, reasons.values()), "there is none")
        raise ForeignTableError(f"no row below the header can be read: {shown}")
    footer = [(row, line) for row, _, line in others if row > rows[is_row][-1] and reasons[row]]
    if text.endswith("\n") and 0 < len(footer) <= _MOST_FOOTER:
        notes = [*notes, f"below the table: {footer[0][1][:60]!r}"]
        reasons |= dict.fromkeys((row for row, _ in footer), None)
    # each line that a quote swallowed was a row of its own
    faults = [(int(lines[row]), why) for row, why in sorted(reasons.items()) for _ in range(spans[row]) if why]
    if not is_row.all():
        columns = [column.filter(pa.array(is_row)) for column in columns]
    return _finished(top.header, columns, lines[rows[is_row]], faults, notes, top.units)


def _cells_of(text: str, separator: str, width: int) -> tuple[list[Any], list[tuple[int, int, str]]]:
    """Return the columns of the rows of a width; number, width and text of the others."""
    # pyarrow costs what only tables need
    import pyarrow as pa
    import pyarrow.csv as arrow_csv

    if separator == " ":
        text = re.sub(r"(?m)^ +| +$", "", re.sub("[ \t]+", " ", text))
    others: list[tuple[int, int, str]] = []

    def leave_out(row: Any) -> str:
        others.append((row.number - 1, row.actual_columns, row.text))
        return "skip"

    names, content = [str(position) for position in range(width)], text.encode()
    try:
        found = arrow_csv.read_csv(
            pa.BufferReader(content),
            # one block: numbers of rows are those of the file, and a cell may span lines
            arrow_csv.ReadOptions(column_names=names, block_size=len(content) + 1, use_threads=False),
            arrow_csv.ParseOptions(
                delimiter=separator, ignore_empty_lines=False, newlines_in_values=True, invalid_row_handler=leave_out
            ),
            arrow_csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=False),
        )
    except (pa.ArrowInvalid, OverflowError) as error:
        raise ForeignTableError(f"the rows cannot be read: {error}; state separator, or split the file") from None
    return [column.combine_chunks() for column in found.columns], others


def _count_of(column: Any, mark: str) -> NDArray[np.int64]:
    """Return how often a sign occurs in each cell."""
    import pyarrow.compute as pc

    return np.asarray(pc.count_substring(column, mark).to_numpy(), dtype=np.int64)


def _fault_of(width: int, line: str, separator: str, top: _Top) -> str | None:
    """Return why a line of another width is no row; None: a comment or a blank line."""
    if _COMMENT.match(line) or not line.strip(_BLANK):
        return None
    if any(line.count(mark) + 1 == top.width for mark in SEPARATORS if mark != separator):
        return "the line has another separator than the header"
    return f"{width} cells, the header has {top.width}"


def _is_row(columns: list[Any], header_start: str) -> NDArray[np.bool_]:
    """Return which rows are neither comments, blank nor a repeated header."""
    import pyarrow as pa
    import pyarrow.compute as pc

    first = pc.utf8_trim(columns[0], " \t\"'")
    is_odd = pc.match_substring_regex(first, pattern=f"^(?:{_COMMENT.pattern})")
    if header_start:
        is_odd = pc.or_(is_odd, pc.equal(first, header_start))
    found = ~np.asarray(is_odd.to_numpy(zero_copy_only=False), dtype=np.bool_)
    blank = np.flatnonzero(pc.equal(first, "").to_numpy(zero_copy_only=False))
    for column in columns if len(blank) else ():
        texts = pc.utf8_trim_whitespace(column.take(pa.array(blank)))
        blank = blank[pc.equal(texts, "").to_numpy(zero_copy_only=False)]
    found[blank] = False
    return found


def _finished(
    header: list[str],
    columns: list[Any],
    lines: NDArray[np.int64],
    faults: list[tuple[int, str]],
    notes: list[str],
    units: dict[str, str],
) -> Table:
    """Return a table without blank columns, its cells trimmed; a column without a name is called by its position."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kept: dict[str, Any] = {}
    for position, (name, column) in enumerate(zip(header, columns, strict=True), start=1):
        texts = pc.utf8_trim_whitespace(pc.fill_null(column.cast(pa.string()), ""))
        if pc.any(pc.starts_with(texts, "'")).as_py():
            texts = pc.replace_substring_regex(texts, pattern=r"^'([=+\-@])", replacement=r"\1")
        if not name and pc.max(pc.utf8_length(texts)).as_py() in (0, None):
            continue
        name = name or f"column {position}"
        if name in kept:
            raise ForeignTableError(f"columns occur twice: {name}; name each column once")
        kept[name] = texts
    return Table(list(kept), list(kept.values()), lines, faults, notes, units)


def workbook_text(content: bytes, sheet: str | None) -> str:
    """Return a workbook's sheet as lines with commas; ForeignTableError where several sheets hold something."""
    from python_calamine import CalamineError, CalamineWorkbook

    try:
        book = CalamineWorkbook.from_filelike(io.BytesIO(content))
        sheets = {name: book.get_sheet_by_name(name).to_python(skip_empty_area=False) for name in book.sheet_names}
    except (CalamineError, OSError, ValueError, KeyError, RuntimeError) as error:
        raise ForeignTableError(f"the workbook cannot be read: {error}; save it as xlsx or CSV") from None
    filled = [name for name, rows in sheets.items() if any(any(cell != "" for cell in row) for row in rows)]
    if sheet is not None and sheet not in sheets:
        raise ForeignTableError(f"no sheet {sheet[:40]!r}; the sheets are {', '.join(sheets)}")
    if sheet is None and len(filled) != 1:
        raise ForeignTableError(f"an Excel workbook with {len(filled)} sheets ({', '.join(filled)}): state sheet")
    columns = [_texts_of(cells) for cells in zip(*sheets[sheet or filled[0]], strict=True)]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(zip(*columns, strict=True))
    return text.getvalue()


def _texts_of(cells: Sequence[Any]) -> list[str]:
    """Return the cells of a workbook's column as texts; in a column of instants, midnight is one of them."""
    has_instants = any(isinstance(cell, datetime) for cell in cells)
    return [" ".join(_cell_text(cell, is_midnight=has_instants).split()) for cell in cells]


def _cell_text(cell: Any, *, is_midnight: bool) -> str:
    """Return a cell of a workbook as text; instants are rounded to the millisecond, which its format holds."""
    if isinstance(cell, datetime):
        return str((cell + timedelta(microseconds=500)).isoformat(" ", "milliseconds"))
    if isinstance(cell, date):
        if cell.year < 1901:
            return "00:00:00"
        return f"{cell.isoformat()} 00:00:00" if is_midnight else cell.isoformat()
    if isinstance(cell, timedelta):
        return str(timedelta(milliseconds=round(cell / timedelta(milliseconds=1))))
    if isinstance(cell, float) and cell.is_integer() and abs(cell) < 1e15:
        return str(int(cell))
    return str(cell)


def _of_parquet(content: bytes) -> Table:
    """Return the table of a Parquet file; a zoned instant ends with Z, one without a zone has no offset."""
    import pyarrow as pa
    import pyarrow.parquet as parquet

    try:
        found = parquet.read_table(pa.BufferReader(content))
    except (pa.ArrowInvalid, OSError, NotImplementedError) as error:
        raise ForeignTableError(f"no Parquet file, or it is cut off: {error}") from None
    header, columns = [], []
    for name, column in zip(found.column_names, found.columns, strict=True):
        kind = column.type
        if pa.types.is_nested(kind):
            continue
        if pa.types.is_dictionary(kind):
            column = column.cast(kind.value_type)
        if pa.types.is_timestamp(kind):
            # nanoseconds beyond the microsecond are cut off
            column = column.cast(pa.timestamp("us", tz=None if kind.tz is None else "UTC"), safe=False)
        header.append(" ".join(str(name).split()))
        columns.append(column.cast(pa.string()).combine_chunks())
    if found.num_rows == 0 or not header:
        raise ForeignTableError("the Parquet file holds no rows")
    return _finished(header, columns, np.arange(1, found.num_rows + 1), [], ["Parquet"], {})


def _text_of_objects(text: str) -> str:
    """Return JSON, one object a line or an array of flat objects, as lines with commas."""
    is_array = text.lstrip().startswith("[")
    out = io.StringIO()
    try:
        objects = json.loads(text) if is_array else [json.loads(line) for line in text.split("\n") if line.strip()]
        writer = csv.DictWriter(out, list(objects[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(objects)
    except (ValueError, RecursionError, LookupError, TypeError, AttributeError) as error:
        raise ForeignTableError(f"no JSON objects of the same names: {error}") from None
    return out.getvalue()
