"""Paging: intervals, limits and opaque cursors, the same on every list that may grow.

Lists run from the oldest row to the newest, or with ``order=desc`` back from the newest.

A cursor is the place (start, number) of the last row given, so rows that arrive meanwhile neither shift nor repeat a
page, and a mark of the query that it belongs to: with another query it is refused. It is URL-safe base64 and means
nothing to a client.
"""

import binascii
import struct
import zlib
from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
from fastapi import Depends, Query, Request, Response
from pydantic import BaseModel
from pydantic_core import PydanticCustomError

from service.api.problems.problems import invalid_request
from service.errors import FieldError
from service.ports.archive import ListPart
from service.records.calibration import Window
from service.records.epoch import EARLIEST_EPOCH_US, LATEST_EPOCH_US, format_epoch, is_leap_second, parse_epoch
from service.records.levels.attitude import IntArray

_FORM = np.array([ord(c) for c in "0000-00-00T00:00:00.000000Z"], dtype=np.uint32)
_IS_DIGIT = np.equal(_FORM, ord("0"))
_LENGTH = len(_FORM)
#: below it one by one is the faster way
_MANY = 10


class ParsedEpochs(NamedTuple):
    """Epochs of many texts."""

    #: (T,) microseconds UTC
    epochs_us: IntArray
    #: places of instants within a leap second
    leap_positions: tuple[int, ...]


class EpochTextError(Exception):
    """One text of a sequence is no epoch.

    Parameters
    ----------
    index : int
        Position in the sequence.
    detail : str
        What is wrong with it.
    """

    def __init__(self, index: int, detail: str) -> None:
        super().__init__(detail)
        self.index = index
        self.detail = detail


def parse_epochs(texts: Sequence[str]) -> ParsedEpochs:
    """Return the epochs of many texts.

    Parameters
    ----------
    texts : sequence of str
        RFC 3339 instants.

    Raises
    ------
    EpochTextError
        Names the first text that is no instant.
    """
    fast = _parse_exact_form(texts) if len(texts) >= _MANY else None
    if fast is not None:
        # second 60 is never of the exact form
        return ParsedEpochs(fast, ())
    epochs_us = np.empty(len(texts), dtype=np.int64)
    leap_positions: list[int] = []
    for index, text in enumerate(texts):
        try:
            epochs_us[index] = parse_epoch(text)
        except ValueError as error:
            raise EpochTextError(index, str(error)) from None
        if is_leap_second(text):
            leap_positions.append(index)
    return ParsedEpochs(epochs_us, tuple(leap_positions))


def _parse_exact_form(texts: Sequence[str]) -> IntArray | None:
    """Return the epochs when every text has the exact form and is a day and hour of the calendar, otherwise None."""
    if set(map(len, texts)) != {_LENGTH}:
        return None
    array = np.array(texts, dtype=f"U{_LENGTH}")
    codes = array.view(np.uint32).reshape(len(texts), _LENGTH)
    digits = codes[:, _IS_DIGIT]
    if not (np.all(codes[:, ~_IS_DIGIT] == _FORM[~_IS_DIGIT]) and np.all((digits >= ord("0")) & (digits <= ord("9")))):
        return None
    try:
        moments = array.astype(f"U{_LENGTH - 1}").astype("datetime64[us]")
    except ValueError:  # 30 February, second 60: the careful way decides
        return None
    if np.any(moments < np.datetime64("0001-01-01")):  # year 0, which no calendar of ours has
        return None
    return np.asarray(moments.astype(np.int64), dtype=np.int64)


def epoch_of(value: object) -> int:
    """Return one epoch, for a pydantic validator; ``epoch.malformed`` when the value is no RFC 3339 text."""
    try:
        return parse_epoch(value if isinstance(value, str) else "")
    except ValueError as error:
        raise PydanticCustomError("epoch.malformed", "{reason}", {"reason": str(error)}) from None


def plausible_epoch(epoch_us: int) -> int:
    """Return an epoch of this century, for a pydantic validator; ``epoch.range`` for any other."""
    if not EARLIEST_EPOCH_US <= epoch_us <= LATEST_EPOCH_US:
        bounds = {"first": format_epoch(EARLIEST_EPOCH_US), "last": format_epoch(LATEST_EPOCH_US)}
        raise PydanticCustomError("epoch.range", "the epoch lies outside {first} .. {last}", bounds)
    return epoch_us


T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)
Position = tuple[int, int]
DEFAULT_LIMIT = 100
MAX_LIMIT = 10_000
#: version byte, start in microseconds, number, mark of the query
_CURSOR = struct.Struct(">BqqI")
_CURSOR_VERSION = 2
#: parameters that may change from page to page
_FREE_PARAMETERS = ("cursor", "limit")


@dataclass(frozen=True, slots=True)
class PageQuery:
    """Requested page of a list: window, limit and start position."""

    window: Window
    limit: int
    after: Position | None
    request: Request
    response: Response
    newest_first: bool = False

    @property
    def most(self) -> int:
        """Rows to be read: one more than the page has tells that there is a next page."""
        return self.limit + 1

    @property
    def part(self) -> ListPart:
        """Rows to be read, as the archive is asked for them."""
        return ListPart(self.window, self.most, self.after, newest_first=self.newest_first)

    def cut(self, found: Sequence[T], position: Callable[[T], Position]) -> tuple[Sequence[T], str | None]:
        """Return the rows of the page and the cursor of the next, and set the Link header.

        Parameters
        ----------
        found : sequence
            Up to ``most`` rows.
        position : callable
            Gives the place of a row.
        """
        if len(found) <= self.limit:
            return found, None
        cursor = encode_cursor(position(found[self.limit - 1]), mark_of(self.request))
        url = self.request.url.include_query_params(cursor=cursor)
        # relative: the host that a client reached us by is for the client to know
        self.response.headers["Link"] = f'<{url.path}?{url.query}>; rel="next"'
        return found[: self.limit], cursor

    def answer(
        self, model: type[M], found: Sequence[T], position: Callable[[T], Position], of: Callable[[T], Any], **more: Any
    ) -> M:
        """Return the page as an answer with range, rows, next and ``more``; ``of`` gives the answer for a row."""
        rows, cursor = self.cut(found, position)
        return model.model_validate({"range": self.window, "rows": [of(row) for row in rows], "next": cursor, **more})


by_epoch: Callable[[Any], Position] = attrgetter("epoch_us", "number")


def mark_of(request: Request) -> int:
    """Return the identity of a query: CRC-32 of path and parameters, in any order."""
    pairs = sorted(pair for pair in request.query_params.multi_items() if pair[0] not in _FREE_PARAMETERS)
    return zlib.crc32(repr((request.url.path, pairs)).encode())


def encode_cursor(position: Position, mark: int = 0) -> str:
    """Return the cursor that stands behind a place of a query.

    Examples
    --------
    >>> decode_cursor(encode_cursor((5, 7), 3), 3)
    (5, 7)
    """
    return urlsafe_b64encode(_CURSOR.pack(_CURSOR_VERSION, *position, mark)).decode("ascii").rstrip("=")


def decode_cursor(text: str, mark: int = 0) -> Position:
    """Return the place of a cursor; problem ``cursor.invalid`` for any text that was not given for this query."""
    try:
        packed = urlsafe_b64decode(text.encode("ascii") + b"=" * (-len(text) % 4))
        version, start_us, number, its_mark = _CURSOR.unpack(packed)
    except (UnicodeEncodeError, binascii.Error, struct.error):
        version, start_us, number, its_mark = 0, 0, 0, 0
    detail = None
    if version != _CURSOR_VERSION or encode_cursor((start_us, number), its_mark) != text:
        detail = "this cursor is not from this service; use next of the previous page"
    elif its_mark != mark:
        detail = "this cursor belongs to another query"
    if detail is not None:
        raise invalid_request([FieldError("/query/cursor", "cursor.invalid", detail)])
    return start_us, number


def window_of(start: str | None, stop: str | None, default: Window) -> Window:
    """Return the interval that was asked for.

    Parameters
    ----------
    start, stop : str or None
        RFC 3339, or None for the default's.
    default : Window
        Holds where nothing is stated; the answer says so under ``range``.

    Raises
    ------
    ProblemError
        422 ``epoch.malformed`` or ``range.invalid``.
    """
    start_us = default.start_us if start is None else _parameter_epoch("start", start)
    stop_us = default.stop_us if stop is None else _parameter_epoch("stop", stop)
    if start_us >= stop_us:
        detail = "start must lie before stop"
        raise invalid_request([FieldError("/query/start", "range.invalid", detail)])
    return Window(start_us, stop_us)


def _parameter_epoch(name: str, text: str) -> int:
    return _epoch_at(f"/query/{name}", text)


def path_epoch(name: str, text: str) -> int:
    """Return the epoch that stands in a path; problem ``epoch.malformed`` for any other text."""
    return _epoch_at(f"/path/{name}", text)


def _epoch_at(pointer: str, text: str) -> int:
    """Return an epoch, or raise the problem that points to it."""
    try:
        return parse_epoch(text)
    except ValueError as error:
        raise invalid_request([FieldError(pointer, "epoch.malformed", str(error))]) from None


#: all that the archive can hold
EVERYTHING = Window(EARLIEST_EPOCH_US, LATEST_EPOCH_US)
StartParameter = Annotated[str | None, Query(description="RFC 3339, inclusive", max_length=64)]
StopParameter = Annotated[str | None, Query(description="RFC 3339, exclusive", max_length=64)]
LimitParameter = Annotated[int, Query(ge=1, le=MAX_LIMIT, description="Most rows of one page")]
CursorParameter = Annotated[str | None, Query(description="next of the page before", max_length=64)]


async def page_query(
    request: Request,
    response: Response,
    start: StartParameter = None,
    stop: StopParameter = None,
    limit: LimitParameter = DEFAULT_LIMIT,
    cursor: CursorParameter = None,
) -> PageQuery:
    """Return the part of a list that is asked for, everything by default."""
    window = window_of(start, stop, EVERYTHING)
    after = None if cursor is None else decode_cursor(cursor, mark_of(request))
    return PageQuery(window, limit, after, request, response)


#: of lists that are made from their start
ForwardPage = Annotated[PageQuery, Depends(page_query)]
OrderParameter = Annotated[Literal["asc", "desc"], Query(description="desc = from the newest row backwards")]


async def ordered_page_query(query: ForwardPage, order: OrderParameter = "asc") -> PageQuery:
    """Return the part of a list that is asked for, in the order that is asked for."""
    return replace(query, newest_first=order == "desc")


Page = Annotated[PageQuery, Depends(ordered_page_query)]
