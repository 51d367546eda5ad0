"""Numbers as text: the fewest digits that give the stored value back.

A power is kept as float32, so nine digits at most name it; printed as the float64 it is widened to, -42.1 would read
-42.099998474121094, which is true of no one's measurement.
"""

import math
import re

import numpy as np
from numpy.typing import NDArray


def shortest_float32(values: NDArray[np.float64]) -> list[float | None]:
    """Return float32 values as the float64 numbers of fewest digits that round to them; NaN becomes None.

    Parameters
    ----------
    values : ndarray, shape (N,)
        Values that float32 holds exactly.

    Examples
    --------
    >>> shortest_float32(np.array([np.float32(-42.1), np.nan], dtype=np.float64))
    [-42.1, None]
    """
    texts = np.asarray(values, dtype=np.float32).astype(str).tolist()
    return [None if text == "nan" else float(text) for text in texts]


def text_of_float32(values: NDArray[np.floating]) -> list[str]:
    """Return float32 values as the shortest texts that read back to them; NaN becomes an empty text.

    Parameters
    ----------
    values : ndarray, any shape
        Values that float32 holds exactly; the texts stand in row-major order.

    Examples
    --------
    >>> text_of_float32(np.array([np.float32(-42.1), np.nan], dtype=np.float64))
    ['-42.1', '']
    """
    texts = np.asarray(values, dtype=np.float32).ravel().astype(str).tolist()
    return ["" if text == "nan" else text for text in texts]


def text_of_level(value: float) -> str:
    """Return the text of a number that `shortest_float32` gave, as files of measurements have it.

    Examples
    --------
    >>> text_of_level(-42.0), text_of_level(-42.1)
    ('-42', '-42.1')
    """
    return text_of_float(value).removesuffix(".0")


def text_of_float(value: float) -> str:
    """Return the shortest text that reads back to a float64; NaN becomes an empty text.

    Examples
    --------
    >>> text_of_float(0.1), text_of_float(math.nan)
    ('0.1', '')
    """
    return "" if math.isnan(value) else repr(float(value))


#: what separates fields or lines
_SEPARATES = re.compile('[,"\r\n]').search


def csv_field(text: str) -> str:
    r"""Return a field, quoted when it holds what separates fields or lines.

    Examples
    --------
    >>> csv_field('a "b", c')
    '"a ""b"", c"'
    """
    if _SEPARATES(text):
        return '"' + text.replace('"', '""') + '"'
    return text
