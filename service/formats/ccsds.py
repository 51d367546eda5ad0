"""CCSDS messages: their key-value notation, and attitude ephemerides (AEM)."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice
from math import isfinite

import numpy as np

from service.core.geometry.frames import quaternion_of_attitude, with_continuous_sign
from service.errors import InvalidInputError
from service.records.epoch import parse_epoch
from service.records.levels.attitude import AttitudeRow, BoolArray, FloatArray, IntArray

LINE_LIMIT = 254
_KEYWORD = re.compile(r"([A-Z][A-Z0-9_]*)\s*=\s*(.*?)\s*")
_DAY_OF_YEAR = re.compile(r"(\d{4})-(\d{3})", re.ASCII)


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


#: mark -> places where it may stand, and the place it opens
Marks = Mapping[str, tuple[tuple[str, ...], str]]
_MARKS: Marks = {
    "META_START": (("header", "end"), "meta"),
    "META_STOP": (("meta",), "between"),
    "DATA_START": (("between",), "data"),
    "DATA_STOP": (("data",), "end"),
}


def read_segments(text: str, version_keyword: str, marks: Marks = _MARKS, end: str | None = "end") -> list[Segment]:
    """Return the segments of a message.

    Parameters
    ----------
    text : str
        The whole message.
    version_keyword : str
        ``CCSDS_AEM_VERS``, ``CCSDS_OEM_VERS`` or ``CCSDS_TDM_VERS``, which must come first.
    marks : mapping
        Lines that open a place.
    end : str or None
        Place at which the message ends; None: at any.

    Raises
    ------
    InvalidInputError
        ``ccsds.malformed`` with the line.
    """
    segments: list[Segment] = []
    position, lines = "header", list(_content_lines(text))
    if not lines or not lines[0][1].startswith(version_keyword):
        raise malformed(1, f"the message must begin with {version_keyword}")
    for number, content in lines:
        if content in marks:
            allowed, opened = marks[content]
            if position not in allowed:
                raise malformed(number, f"{content} stands at the wrong place")
            position = opened
            segments += [Segment()] if position == "meta" else []
        elif position == "data":
            segments[-1].data.append((number, content))
        elif position != "covariance":
            _parse_keyword(segments, position, number, keyword_and_value(number, content))
    if end is not None and position != end:
        raise malformed(len(text.splitlines()), "the message ends before DATA_STOP")
    return segments


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


def calendar_us(text: str) -> int:
    """Return microseconds of an epoch in the message's own time system; ValueError when it is none.

    Parameters
    ----------
    text : str
        Month and day or day of year; ``T`` or blanks before the time of day; ``Z`` may follow.

    Examples
    --------
    >>> calendar_us("1970-001T00:00:01"), calendar_us("1970-01-01 00:00:01.5Z")
    (1000000, 1500000)
    """
    date, _, clock = " ".join(text.removesuffix("Z").split()).replace(" ", "T", 1).partition("T")
    ordinal = _DAY_OF_YEAR.fullmatch(date)
    if ordinal is not None:
        first = np.datetime64(f"{ordinal.group(1)}-01-01", "D")
        date = str(first + np.timedelta64(int(ordinal.group(2)) - 1, "D"))
        if not date.startswith(f"{ordinal.group(1)}-"):
            message = f"{text[:8]} is no day of its year"
            raise ValueError(message)
    return parse_epoch(f"{date}T{clock}Z")


def is_useable(meta: Mapping[str, str], epochs_us: IntArray) -> BoolArray:
    """Return which epochs (T,), in the segment's own time, lie in the span that its metadata call useable.

    ValueError where the metadata state no epoch.
    """
    found = np.ones(len(epochs_us), dtype=np.bool_)
    if start := meta.get("USEABLE_START_TIME"):
        found &= epochs_us >= calendar_us(start)
    if stop := meta.get("USEABLE_STOP_TIME"):
        found &= epochs_us <= calendar_us(stop)
    return found


def epoch_of(number: int, text: str) -> int:
    """Return `calendar_us` of an epoch; ``ccsds.malformed`` with the line when it is none."""
    try:
        return calendar_us(text)
    except ValueError as error:
        raise malformed(number, str(error)) from error


def require_one_object(segments: Sequence[Segment]) -> None:
    """Refuse a message of several objects: ``ccsds.unsupported``."""
    objects = dict.fromkeys(each.meta.get("OBJECT_ID") or each.meta.get("OBJECT_NAME", "") for each in segments)
    if len(objects) > 1:
        detail = f"the message holds {len(objects)} objects ({', '.join(list(objects)[:5])}); keep the one"
        raise InvalidInputError("ccsds.unsupported", f"{detail} of this spacecraft")


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


#: rows of one segment at most: what is held in memory
SEGMENT_ROWS = 100_000
#: a distance of rows above this many usual ones is a gap
GAP_ROWS = 2.5
#: rows whose median distance is the usual one
_USUAL_OF_ROWS = 1000
_VERSION = "CCSDS_AEM_VERS"


@dataclass(frozen=True, slots=True)
class AttitudeMessage:
    """Header and segment metadata of an attitude message."""

    object_name: str
    #: international designator YYYY-NNNP, or another agreed name
    object_id: str
    message_id: str
    created_at_us: int
    #: method and version
    estimator: str
    originator: str = "SOO"


class AemWriter:
    """Writer of one message.

    Parameters
    ----------
    message : AttitudeMessage
        Header and object.
    """

    def __init__(self, message: AttitudeMessage) -> None:
        self._message = message

    def header(self) -> bytes:
        """Return what stands before the first segment."""
        message = self._message
        return message_header(_VERSION, message.created_at_us, message.originator, message.message_id)

    def segments(self, pages: Iterable[Sequence[AttitudeRow]]) -> Iterator[bytes]:
        """Yield each segment of rows that come in order of epoch; one segment is held at a time."""
        for rows in split_rows(pages):
            yield self._segment(rows)

    def _segment(self, rows: Sequence[AttitudeRow]) -> bytes:
        epochs_us = np.array([row.epoch_us for row in rows], dtype=np.int64)
        attitude_deg = np.array([row.attitude_deg for row in rows])
        return as_bytes([*self._meta(rows, epochs_us), "DATA_START", *_data(epochs_us, attitude_deg), "DATA_STOP"])

    def _meta(self, rows: Sequence[AttitudeRow], epochs_us: IntArray) -> list[str]:
        first = rows[0]
        yaw, roll, pitch = np.max([row.sigma_deg for row in rows], axis=0)
        allowed = sum(row.control_allowed for row in rows)
        start, stop = epoch_texts(epochs_us[[0, -1]])
        return [
            "META_START",
            comment(f"estimator={self._message.estimator} source=RF_CARRIER_POWER"),
            comment(f"calibration={first.calibration_id} alignment={first.alignment_id} status={first.status.value}"),
            comment(f"largest 1-sigma, deg: yaw={yaw:.4f} roll={roll:.4f} pitch={pitch:.4f}"),
            comment(f"control allowed in {allowed} of {len(rows)} rows"),
            line("OBJECT_NAME", self._message.object_name),
            line("OBJECT_ID", self._message.object_id),
            "CENTER_NAME = EARTH",
            "REF_FRAME_A = LVLH_ROTATING",
            "REF_FRAME_B = SC_BODY_1",
            "TIME_SYSTEM = UTC",
            f"START_TIME = {start}",
            f"STOP_TIME = {stop}",
            "ATTITUDE_TYPE = QUATERNION",
            *(("INTERPOLATION_METHOD = LINEAR", "INTERPOLATION_DEGREE = 1") if len(rows) > 1 else ()),
            "META_STOP",
        ]


def _data(epochs_us: IntArray, attitude_deg: FloatArray) -> list[str]:
    """Return one line a row: epoch Q1 Q2 Q3 QC."""
    quaternions = with_continuous_sign(quaternion_of_attitude(attitude_deg)).tolist()
    return [
        f"{epoch} {q1:.12f} {q2:.12f} {q3:.12f} {qc:.12f}"
        for epoch, (q1, q2, q3, qc) in zip(epoch_texts(epochs_us), quaternions, strict=True)
    ]


def split_rows(pages: Iterable[Sequence[AttitudeRow]]) -> Iterator[list[AttitudeRow]]:
    """Yield runs of rows with an attitude that belong into one segment."""
    run: list[AttitudeRow] = []
    usual_us = 0.0
    # pages of a size of our own: how rows came leaves no trace in the message
    rows = chain.from_iterable(pages)
    while page := list(islice(rows, _USUAL_OF_ROWS)):
        if len(page) > 1:
            usual_us = float(np.median(np.diff([row.epoch_us for row in page])))
        for row in page:
            has_attitude = all(map(isfinite, row.attitude_deg))
            if run and not (has_attitude and len(run) < SEGMENT_ROWS and _continues(run[-1], row, usual_us)):
                yield run
                run = []
            # two rows of one epoch (a prime and a backup source) cannot both stand in a segment
            if has_attitude and not (run and row.epoch_us == run[-1].epoch_us):
                run.append(row)
    if run:
        yield run


def _continues(last: AttitudeRow, row: AttitudeRow, usual_us: float) -> bool:
    """Return whether a row may stand in the segment of the row before it."""
    is_near = row.epoch_us - last.epoch_us <= GAP_ROWS * usual_us if usual_us > 0.0 else True
    same = (row.status, row.calibration_id, row.alignment_id) == (last.status, last.calibration_id, last.alignment_id)
    return is_near and same
