"""Carrier plans as CSV (RFC 4180), for the spreadsheets in which operators keep them.

One carrier a line, columns by name in any order, an empty cell = absent. What is read is a document as the JSON
interface takes it, so both ways in are judged by the same rules. Written plans read back equal: numbers are written in
their shortest form that does, and a name that a spreadsheet would take for a formula gets an apostrophe, which is
removed on reading.
"""

import csv
import io
from collections.abc import Sequence
from typing import Any

from service.errors import FieldError, InvalidInputError
from service.records.catalogue import Carrier
from service.records.csv_guard import guarded, unguarded

_TEXT_COLUMNS = (
    "id",
    "name",
    "band",
    "transponder",
    "polarization",
    "kind",
    "uplink_power_control",
    "transponder_mode",
)
_NUMBER_COLUMNS = ("uplink_hz", "downlink_hz", "intermediate_hz", "bandwidth_hz")
_STATION_COLUMNS = ("station_name", "station_latitude_deg", "station_longitude_deg")
COLUMNS = (
    "id",
    "name",
    *_STATION_COLUMNS,
    "band",
    "transponder",
    "polarization",
    *_NUMBER_COLUMNS,
    "kind",
    "uplink_power_control",
    "transponder_mode",
    "enabled",
)
_REQUIRED_COLUMNS = ("id", "band", "transponder", "downlink_hz", "bandwidth_hz")
_TRUTHS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
#: no cell of a plan is longer
_MAX_CELL = 4096


def write_carrier_plan(carriers: Sequence[Carrier]) -> str:
    """Return a plan as CSV with a header.

    Parameters
    ----------
    carriers : sequence of Carrier
        In the order of the plan.
    """
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer, lineterminator="\r\n")
    writer.writerow(COLUMNS)
    writer.writerows([_cell(value) for value in _values(carrier)] for carrier in carriers)
    return buffer.getvalue()


def read_carrier_plan(raw: bytes) -> list[dict[str, Any]]:
    """Return the carriers of a CSV as documents of the JSON interface.

    Parameters
    ----------
    raw : bytes
        UTF-8, with or without a byte order mark; separated by commas, or by semicolons when the header is.

    Raises
    ------
    InvalidInputError
        ``csv.malformed``: no text, no header, a column unknown, repeated or missing, a line of another length, a cell
        that is no number or truth value. Pointers name the carrier and field as in JSON.
    """
    lines = _lines(raw)
    header = [name.strip() for name in lines[0]] if lines else []
    _check_header(header)
    documents = []
    for index, cells in enumerate(line for line in lines[1:] if any(cell.strip() for cell in line)):
        if len(cells) != len(header):
            raise _malformed(f"/carriers/{index}", f"the line has {len(cells)} cells, the header {len(header)}")
        documents.append(_document(index, dict(zip(header, (cell.strip() for cell in cells), strict=True))))
    return documents


def _lines(raw: bytes) -> list[list[str]]:
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise _malformed("", "the file is not UTF-8") from None
    header = text.partition("\n")[0]
    delimiter = ";" if header.count(";") > header.count(",") else ","
    try:
        lines = list(csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise _malformed("", f"the file is not CSV: {error}") from None
    if any(len(cell) > _MAX_CELL for line in lines for cell in line):
        raise _malformed("", f"a cell is longer than {_MAX_CELL} characters: a quote may be missing")
    return lines


def _check_header(header: list[str]) -> None:
    """Refuse a header that names something unknown, twice, or too little."""
    unknown = [name for name in header if name not in COLUMNS]
    if unknown:
        raise _malformed("", f"column {unknown[0][:64]!r} is not known; the columns are {', '.join(COLUMNS)}")
    repeated = [name for name in header if header.count(name) > 1]
    if repeated:
        raise _malformed("", f"column {repeated[0]!r} stands twice in the header")
    missing = [name for name in _REQUIRED_COLUMNS if name not in header]
    if missing:
        raise _malformed("", f"column {missing[0]!r} is missing; the first line must name the columns")


def _document(index: int, cells: dict[str, str]) -> dict[str, Any]:
    stated = {name: cell for name, cell in cells.items() if cell}
    document: dict[str, Any] = {name: unguarded(stated[name]) for name in _TEXT_COLUMNS if name in stated}
    document |= {name: _number(index, name, stated[name]) for name in _NUMBER_COLUMNS if name in stated}
    if "enabled" in stated:
        document["enabled"] = _truth(index, stated["enabled"])
    station = {name.removeprefix("station_"): stated[name] for name in _STATION_COLUMNS if name in stated}
    if station:
        numbers = {
            name: _number(index, f"station/{name}", cell) for name, cell in station.items() if name.endswith("_deg")
        }
        document["station"] = {name: unguarded(cell) for name, cell in station.items()} | numbers
    return document


def _number(index: int, name: str, cell: str) -> float:
    """Return the number of a cell; NaN and infinity pass and are judged by the interface."""
    try:
        return float(cell)
    except ValueError:
        raise _malformed(f"/carriers/{index}/{name}", f"{cell[:40]!r} is not a number") from None


def _truth(index: int, cell: str) -> bool:
    truth = _TRUTHS.get(cell.lower())
    if truth is None:
        raise _malformed(f"/carriers/{index}/enabled", f"{cell[:40]!r} is neither true nor false")
    return truth


def _values(carrier: Carrier) -> tuple[object, ...]:
    """Return the values of one line in the order of the columns."""
    station = carrier.station
    values = {
        "station_name": None if station is None else station.name,
        "station_latitude_deg": None if station is None else station.latitude_deg,
        "station_longitude_deg": None if station is None else station.longitude_deg,
    }
    return tuple(values[name] if name in values else getattr(carrier, name) for name in COLUMNS)


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return guarded(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
        return str(int(value))
    return str(value)


def _malformed(pointer: str, detail: str) -> InvalidInputError:
    """Return the error of a file that is no carrier plan."""
    return InvalidInputError("csv.malformed", detail, (FieldError(pointer, "csv.malformed", detail),))
