"""Program message -> units of header and data elements (IEEE 488.2, 7.3 to 7.7). No command is known here.

Law of this file: text in, frozen values out, or a :class:`ScpiError`. Splitting respects quotes and blocks; a data
element is read once, by the first byte, into one of five types. Which type a command wants is the business of
``scpi_parameters.py``.
"""

import re
from dataclasses import dataclass
from typing import NamedTuple

from analyzer_sim.scpi.errors import ScpiError

#: longest character datum, long mnemonics of the table included (SCPI allows 12; vendors go beyond)
CHARACTER_LIMIT = 32
#: longest number, characters (IEEE 488.2 7.7.2.4.1 allows 255)
NUMBER_LIMIT = 255
#: largest exponent (IEEE 488.2 7.7.2.4.1)
EXPONENT_LIMIT = 32000

_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))(?:\s*[eE]\s*([+-]?\d+))?")
_SUFFIX = re.compile(r"\s*([A-Za-z%][A-Za-z0-9./%-]*)?\s*")
_CHARACTER = re.compile(r"[A-Za-z][A-Za-z0-9_]*\s*")
_NON_DECIMAL = re.compile(r"#(?:[Hh]([0-9A-Fa-f]+)|[Qq]([0-7]+)|[Bb]([01]+))\s*")
_HEADER = re.compile(r"(\*[A-Za-z]+|:?[A-Za-z][A-Za-z0-9_]*(?::[A-Za-z][A-Za-z0-9_]*)*)(\?)?")
_SEPARATOR = re.compile(r"['\"#;,]")
_NON_DECIMAL_BASES = (16, 8, 2)
#: IEEE 488.2 white space: every control character and the blank, but the line feed
_WHITE = "".join(map(chr, range(0x21)))


class Number(NamedTuple):
    """A numeric datum with the suffix as it was written, upper case; empty when none stood there."""

    value: float
    suffix: str = ""


class Character(NamedTuple):
    """A bare word, upper case."""

    text: str


class Text(NamedTuple):
    """A quoted string, its quotes resolved."""

    text: str


class Block(NamedTuple):
    """An arbitrary block."""

    data: bytes


Datum = Number | Character | Text | Block


@dataclass(frozen=True, slots=True)
class Unit:
    """One program message unit: a header with its data, not yet looked up."""

    #: mnemonics from left to right, upper case; one with a star for a common command
    nodes: tuple[str, ...]
    #: the header began with a colon: it starts at the root
    is_absolute: bool
    #: the header ended with a question mark
    is_query: bool
    #: the text after the header, not yet read
    data: str

    @property
    def is_common(self) -> bool:
        """Return whether this is a command of IEEE 488.2, which leaves the header path alone."""
        return self.nodes[0].startswith("*")

    @property
    def header(self) -> str:
        """The header as text, for messages to people."""
        return ":".join(self.nodes) + ("?" if self.is_query else "")


def short_form(word: str) -> str:
    """Return the short form of a mnemonic as manuals write it: its letters that are not lower case.

    Examples
    --------
    >>> short_form("POSitive"), short_form("DB3")
    ('POS', 'DB3')
    """
    return "".join(c for c in word if not c.islower())


def split_outside(text: str, separator: str) -> list[str]:
    """Split at a separator that stands outside quotes and blocks; white space around the pieces is taken off.

    What ends a block is never white space, whatever byte it is.

    Examples
    --------
    >>> split_outside("A 'x;y' ;B #13;;;;C", ";")
    ["A 'x;y'", 'B #13;;;', 'C']
    """
    if "'" not in text and '"' not in text and "#" not in text:
        return [chunk.strip(_WHITE) for chunk in text.split(separator)]
    chunks = []
    start = solid = at = 0
    while (found := _SEPARATOR.search(text, at)) is not None:
        at = found.end()
        if found.group() == separator:
            chunks.append(_trimmed(text, start, solid, found.start()))
            start = solid = at
        elif found.group() == "#":
            solid = at = _block_end(text, found.start())
        elif found.group() in "'\"":
            closing = text.find(found.group(), at)
            at = closing + 1 if closing >= 0 else len(text)
    return [*chunks, _trimmed(text, start, solid, len(text))]


def _trimmed(text: str, start: int, solid: int, end: int) -> str:
    """Return a piece of text without white space around it; nothing before ``solid`` is taken off at its end."""
    return (text[start:solid] + text[solid:end].rstrip(_WHITE)).lstrip(_WHITE)


def _block_end(text: str, at: int) -> int:
    """Return the position after a block that starts at ``#``, or after the ``#`` when no block starts there."""
    if text[at + 1 : at + 2] == "0":
        return len(text)
    start = _definite_start(text, at)
    return at + 1 if start is None else start[0] + start[1]


def _definite_start(text: str, at: int) -> tuple[int, int] | None:
    """Return the position and the length of the payload of ``#<n><length>``."""
    digits = ord(text[at + 1]) - ord("0") if at + 1 < len(text) else 0
    if not 1 <= digits <= 9:
        return None
    length = text[at + 2 : at + 2 + digits]
    if len(length) < digits or not (length.isascii() and length.isdigit()):
        return None
    return at + 2 + digits, int(length)


def split_units(message: bytes) -> list[str]:
    """Return the non-empty program message units of a message; one character is one byte."""
    return [unit for unit in split_outside(message.decode("latin-1"), ";") if unit]


def parse_unit(text: str) -> Unit:
    """Read the header of one unit.

    Raises
    ------
    ScpiError
        -101 a byte no header may hold, -102 malformed header, -103 no blank between header and data.

    Examples
    --------
    >>> unit = parse_unit(":freq:cent 1 MHZ")
    >>> unit.nodes, unit.is_absolute, unit.is_query, unit.data
    (('FREQ', 'CENT'), True, False, '1 MHZ')
    """
    found = _HEADER.match(text)
    if found is None:
        raise ScpiError(-102 if text[0] in ":*?" else -101, text)
    rest = text[found.end() :]
    if rest and rest[0] not in _WHITE:
        raise ScpiError(_separator_error(rest[0]), text)
    header = found.group(1).upper()
    return Unit(
        nodes=tuple(header.removeprefix(":").split(":")),
        is_absolute=header.startswith(":"),
        is_query=found.group(2) is not None,
        data=rest.lstrip(_WHITE),
    )


def _separator_error(byte: str) -> int:
    """Return the error for a byte that stands where a header should have ended."""
    if byte in ":*?":
        return -102
    return -103 if byte in ",'\"#+-.=()" or byte.isalnum() else -101


def parse_data(text: str) -> tuple[Datum, ...]:
    """Read the data elements of a unit.

    Raises
    ------
    ScpiError
        -102 an element is missing, -104 a type SCPI does not have here, -12x -14x -15x -16x malformed elements.

    Examples
    --------
    >>> parse_data("1.5 GHz, MAX ,'a''b'")
    (Number(value=1.5, suffix='GHZ'), Character(text='MAX'), Text(text="a'b"))
    """
    if not text:
        return ()
    return tuple(_parse_datum(element) for element in split_outside(text, ","))


def _parse_datum(text: str) -> Datum:
    if not text:
        raise ScpiError(-102, "empty parameter")
    first = text[0]
    if first in "'\"":
        return _parse_string(text)
    if first == "#":
        return _parse_hash(text)
    if first.isascii() and first.isalpha():
        return _parse_character(text)
    if first in "+-.0123456789":
        return _parse_number(text)
    raise ScpiError(-104 if first == "(" else -101, text)


def _parse_string(text: str) -> Text:
    quote = text[0]
    inner = text[1:-1]
    if len(text) < 2 or text[-1] != quote or quote in inner.replace(quote * 2, ""):
        raise ScpiError(-151, text)
    return Text(inner.replace(quote * 2, quote))


def _parse_character(text: str) -> Character:
    if _CHARACTER.fullmatch(text) is None:
        raise ScpiError(-141, text)
    if len(text) > CHARACTER_LIMIT:
        raise ScpiError(-144, text)
    return Character(text.upper())


def _parse_number(text: str) -> Number:
    if len(text) > NUMBER_LIMIT:
        raise ScpiError(-124)
    found = _NUMBER.match(text)
    if found is None:
        raise ScpiError(-120, text)
    mantissa, exponent = found.group(1), found.group(2) or "0"
    if abs(int(exponent)) > EXPONENT_LIMIT:
        raise ScpiError(-123, text)
    suffix = _SUFFIX.fullmatch(text, found.end())
    if suffix is None:
        raise ScpiError(-121, text)
    return Number(float(f"{mantissa}e{exponent}"), (suffix.group(1) or "").upper())


def _parse_hash(text: str) -> Number | Block:
    if len(text) > 1 and text[1] in "HhQqBb":
        found = _NON_DECIMAL.fullmatch(text) if len(text) <= NUMBER_LIMIT else None
        if found is None:
            raise ScpiError(-121, text)
        digits, base = next((g, b) for g, b in zip(found.groups(), _NON_DECIMAL_BASES, strict=True) if g)
        return Number(float(int(digits, base)))
    if text.startswith("#0"):
        return Block(text[2:].encode("latin-1"))
    start = _definite_start(text, 0)
    if start is None or start[0] + start[1] != len(text):
        raise ScpiError(-161, text)
    return Block(text[start[0] :].encode("latin-1"))
