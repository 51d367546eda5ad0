"""Lines, epochs and sections of CCSDS messages in keyword = value notation.

Lines are ASCII of at most 254 characters without tabs (503.0-B-2, 4.3); longer lines are cut, other characters become
question marks. Epochs are calendar dates without zone; the time system stands in the metadata, here always UTC.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from service.errors import InvalidInputError
from service.records.epoch import parse_epoch
from service.records.levels.attitude import IntArray

LINE_LIMIT = 254
_KEYWORD = re.compile(r"([A-Z][A-Z0-9_]*)\s*=\s*(.*?)\s*")
_DAY_OF_YEAR = re.compile(r"(\d{4})-(\d{3})T(.*)")


def plain(text: str) -> str:
    r"""Return a text as it may stand in a message.

    Examples
    --------
    >>> plain("Ямал 202\tA")
    '???? 202 A'
    """
    return " ".join(text.encode("ascii", "replace").decode("ascii").split())[: LINE_LIMIT - 32]


def line(keyword: str, value: str) -> str:
    """Return one line of header or metadata."""
    return f"{keyword} = {plain(value)}"[:LINE_LIMIT]


def comment(text: str) -> str:
    """Return one line of comment."""
    return f"COMMENT {plain(text)}"[:LINE_LIMIT]


def epoch_texts(epochs_us: IntArray) -> list[str]:
    """Return calendar epochs with six decimals, without zone.

    Examples
    --------
    >>> epoch_texts(np.array([1_000_500]))
    ['1970-01-01T00:00:01.000500']
    """
    return [str(text) for text in np.datetime_as_string(epochs_us.astype("datetime64[us]"))]


def as_bytes(lines: Iterable[str]) -> bytes:
    """Return lines, each with its end."""
    return "".join(f"{each}\n" for each in lines).encode("ascii")


def message_header(version: str, created_at_us: int, originator: str, message_id: str) -> bytes:
    """Return what stands before the first segment of a message."""
    return as_bytes(
        (
            f"{version} = 2.0",
            line("CREATION_DATE", epoch_texts(np.array([created_at_us]))[0]),
            line("ORIGINATOR", originator),
            line("MESSAGE_ID", message_id),
        )
    )


@dataclass(slots=True)
class Segment:
    """One block of metadata and the lines of its data."""

    meta: dict[str, str] = field(default_factory=dict)
    #: number of the line in the message, and the line
    data: list[tuple[int, str]] = field(default_factory=list)


def read_segments(text: str, version_keyword: str) -> list[Segment]:
    """Return the segments of a message.

    Parameters
    ----------
    text : str
        The whole message.
    version_keyword : str
        ``CCSDS_AEM_VERS`` or ``CCSDS_TDM_VERS``, which must come first.

    Raises
    ------
    InvalidInputError
        ``ccsds.malformed`` with the line.
    """
    segments: list[Segment] = []
    position = "header"
    for number, content in _content_lines(text):
        if number == 1 and not content.startswith(version_keyword):
            raise malformed(number, f"the message must begin with {version_keyword}")
        if content in _MARKS:
            position = _entered(position, content, number)
            segments += [Segment()] if position == "meta" else []
        elif position == "data":
            segments[-1].data.append((number, content))
        else:
            keyword, value = keyword_and_value(number, content)
            _parse_keyword(segments, position, number, (keyword, value))
    if position != "end":
        raise malformed(len(text.splitlines()), "the message ends before DATA_STOP")
    return segments


#: mark -> places where it may stand, and the place it opens
_MARKS = {
    "META_START": (("header", "end"), "meta"),
    "META_STOP": (("meta",), "between"),
    "DATA_START": (("between",), "data"),
    "DATA_STOP": (("data",), "end"),
}


def _entered(position: str, mark: str, number: int) -> str:
    """Return the place that a mark opens."""
    allowed, opened = _MARKS[mark]
    if position not in allowed:
        raise malformed(number, f"{mark} stands at the wrong place")
    return opened


def _parse_keyword(segments: list[Segment], position: str, number: int, pair: tuple[str, str]) -> None:
    """Keep a line of metadata; those of the header say nothing that is needed."""
    if position == "meta":
        segments[-1].meta[pair[0]] = pair[1]
    elif position != "header":
        raise malformed(number, f"{pair[0]} stands outside of metadata and data")


def _content_lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield lines that are neither empty nor comments; the first one counts as line 1 whatever stands before."""
    is_first = True
    for number, each in enumerate(text.splitlines(), start=1):
        content = each.strip()
        if content and not content.startswith("COMMENT"):
            yield (1 if is_first else number), content
            is_first = False


def keyword_and_value(number: int, content: str) -> tuple[str, str]:
    """Return both sides of a line; ``ccsds.malformed`` when it has none."""
    match = _KEYWORD.fullmatch(content)
    if match is None:
        raise malformed(number, f"{content[:40]!r} is not keyword = value")
    return match.group(1), match.group(2)


def epoch_of(number: int, text: str) -> int:
    """Return microseconds UTC of a calendar or ordinal date; ``ccsds.malformed`` when it is none."""
    ordinal = _DAY_OF_YEAR.fullmatch(text)
    try:
        if ordinal is not None:
            day = np.datetime64(f"{ordinal.group(1)}-01-01", "D") + np.timedelta64(int(ordinal.group(2)) - 1, "D")
            text = f"{day}T{ordinal.group(3)}"
        return parse_epoch(text.removesuffix("Z") + "Z")
    except ValueError as error:
        raise malformed(number, str(error)) from error


def require(segment: Segment, wanted: dict[str, Sequence[str]]) -> None:
    """Refuse a segment whose metadata say something else than what is understood: ``ccsds.unsupported``."""
    for keyword, values in wanted.items():
        found = segment.meta.get(keyword, "").upper()
        if found not in values:
            detail = f"{keyword} = {found or 'nothing'}; understood: {', '.join(values)}"
            raise InvalidInputError("ccsds.unsupported", detail)


def malformed(number: int, what: str) -> InvalidInputError:
    """Return the error of a line."""
    return InvalidInputError("ccsds.malformed", f"line {number}: {what}")
