"""Text tables of other programs, read line by line: separator found, byte order mark dropped, memory bounded."""

import csv
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import BinaryIO, NamedTuple

from service.formats.foreign.layout import ForeignTableError

SEPARATORS = (",", ";", "\t", "|")
#: lines from which separator and layout are found
SAMPLE_LINES = 5000
#: no line of a table is longer
_MAX_LINE_BYTES = 1 << 20
_MARKS_OF_UTF16 = (b"\xff\xfe", b"\xfe\xff")
#: fault of a line that is split by another separator than the header
MIXED = "the line has another separator than the header"
_CUT = "the last line does not end; the file may be cut off"


class TableRow(NamedTuple):
    """One row of a foreign table."""

    line: int
    cells: Sequence[object]
    #: why the row cannot be read
    fault: str | None = None


class TextTable:
    """A CSV file of any separator.

    Parameters
    ----------
    file : binary file
        Opened at its beginning; it is read again for each `rows`.

    Raises
    ------
    ForeignTableError
        No UTF-8, a line too long for a table, or no separator that splits header and lines alike.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.line = 0
        #: bytes read
        self.done = 0
        self._is_cut = False
        if file.read(2) in _MARKS_OF_UTF16:
            raise ForeignTableError("the file is UTF-16; save it as CSV UTF-8")
        head = list(islice(self._texts(), SAMPLE_LINES))
        self.separator = _separator_of([text for text in head if text.strip()])
        self.header = [name.strip() for name in next(self._cells())]

    def rows(self) -> Iterator[TableRow]:
        """Yield the rows; empty lines are none."""
        lines = self._cells()
        next(lines, None)
        width = len(self.header)
        for cells in lines:
            if any(cell.strip() for cell in cells):
                yield TableRow(self.line, cells, _CUT if self._is_cut else self._length_fault(cells, width))

    def _length_fault(self, cells: list[str], width: int) -> str | None:
        """Return why a line of another length is of no use."""
        if len(cells) == width:
            return None
        others = [mark for mark in SEPARATORS if mark != self.separator]
        is_mixed = len(cells) == 1 and any(len(cells[0].split(mark)) == width for mark in others)
        return MIXED if is_mixed else f"{len(cells)} cells, the header has {width}"

    def _cells(self) -> Iterator[list[str]]:
        """Yield the cells of each line from the beginning."""
        reader = csv.reader(self._texts(), delimiter=self.separator)
        try:
            yield from (cells for cells in reader if cells)
        except csv.Error as error:
            raise ForeignTableError(f"line {self.line}: {error}; check the quotes") from error

    def _texts(self) -> Iterator[str]:
        """Yield lines as text from the beginning, and count what was read."""
        self._file.seek(0)
        self.line = self.done = 0
        while raw := self._file.readline(_MAX_LINE_BYTES):
            self.line += 1
            self.done += len(raw)
            self._is_cut = not raw.endswith(b"\n")
            if len(raw) == _MAX_LINE_BYTES:
                raise ForeignTableError(f"line {self.line} is longer than {_MAX_LINE_BYTES} bytes; this is no table")
            try:
                yield raw.decode("utf-8-sig" if self.line == 1 else "utf-8")
            except UnicodeDecodeError as error:
                raise ForeignTableError(f"line {self.line} is not UTF-8: save the file as CSV UTF-8") from error


def _separator_of(lines: list[str]) -> str:
    """Return the separator that splits the header and nine of ten lines alike."""
    if len(lines) < 2:
        raise ForeignTableError("the file has no header with lines below it")
    fitting: dict[str, int] = {}
    found: list[str] = []
    for mark in SEPARATORS:
        try:
            counts = [len(cells) for cells in csv.reader(lines, delimiter=mark)]
        except csv.Error:
            continue
        width, alike = counts[0], sum(count == counts[0] for count in counts[1:])
        if width >= 2:
            found.append(f"{mark!r}: {width} cells in the header, as many in {alike} of {len(counts) - 1} lines")
            fitting |= {mark: width} if alike >= 0.9 * (len(counts) - 1) else {}
    if not fitting:
        detail = "; ".join(found) or "no comma, semicolon, tab or bar in the header"
        raise ForeignTableError(f"mixed separators ({detail}); a decimal comma needs another separator or quotes")
    if len(fitting) > 1:
        raise ForeignTableError(f"several separators fit ({'; '.join(found)}); quote the cells that hold one")
    return next(iter(fitting))
