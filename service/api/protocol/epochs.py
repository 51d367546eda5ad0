"""Epochs at the border: text in, microseconds out.

The exact form ``YYYY-MM-DDTHH:MM:SS.ffffffZ`` of a whole batch is read by array operations, ten times faster than one
by one; every other legal form goes through ``records.epoch``, and so does every batch in which anything is odd.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pydantic_core import PydanticCustomError

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
