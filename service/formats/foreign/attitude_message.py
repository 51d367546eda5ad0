"""Attitude Ephemeris Messages (CCSDS 504.0, AEM 1.0 and 2.0, keyword = value) of a sensor: nadir frame to body."""

from collections.abc import Iterator

import numpy as np

from service.core.geometry.quaternion import attitude_of_quaternion
from service.errors import InvalidInputError
from service.formats.ccsds import Segment, epoch_of, read_segments, require
from service.formats.foreign.fault import ForeignCellError, ForeignTableError
from service.formats.foreign.sensor import check_quaternions, scalar_of

#: nadir frames: z to the Earth, y against the orbit's momentum; turning or not, the attitude of an instant is the same
_NADIR = ("LVLH_ROTATING", "LVLH_INERTIAL", "LVLH")
_BODY = ("SC_BODY_1", "SC_BODY")


def read_attitude_message(text: str) -> Iterator[tuple[int, list[float | None]]]:
    """Yield epochs, microseconds UTC, and yaw, roll and pitch, deg, of a message.

    Parameters
    ----------
    text : str
        The whole message.

    Raises
    ------
    ForeignTableError
        No message, another frame, type or time system, quaternions not of unit length, or a scalar at another position
        than the metadata state.
    """
    try:
        for segment in read_segments(text.strip(), "CCSDS_AEM_VERS"):
            yield from _rows(segment)
    except InvalidInputError as error:
        raise ForeignTableError(error.detail) from None
    except ForeignCellError as error:
        raise ForeignTableError(str(error)) from None


def _rows(segment: Segment) -> Iterator[tuple[int, list[float | None]]]:
    """Yield the rows of one segment."""
    require(segment, {"TIME_SYSTEM": ("UTC",), "ATTITUDE_TYPE": ("QUATERNION",)})
    is_reversed = _is_reversed(segment)
    epochs_us, quaternions = [], []
    for number, content in segment.data:
        epoch, *parts = content.split()
        try:
            values = [float(part) for part in parts]
        except ValueError:
            values = []
        if len(values) != 4:
            raise ForeignTableError(f"line {number}: a row is an epoch and the four parts of a quaternion")
        epochs_us.append(epoch_of(number, epoch))
        quaternions.append(values)
    found = np.array(quaternions, dtype=np.float64).reshape(-1, 4)
    check_quaternions(found)
    found = _scalar_last(segment, found)
    # the reverse rotation has the opposite vector
    angles_deg = attitude_of_quaternion(found * ([-1.0, -1.0, -1.0, 1.0] if is_reversed else 1.0))
    yield from zip(epochs_us, angles_deg.tolist(), strict=True)


def _is_reversed(segment: Segment) -> bool:
    """Return whether a segment states the rotation from the body to the nadir frame; refuse other frames."""
    first, second = (segment.meta.get(f"REF_FRAME_{which}", "").upper() for which in "AB")
    is_swapped = first in _BODY
    if is_swapped:
        first, second = second, first
    if first not in _NADIR or second not in _BODY:
        wanted = f"{', '.join(_NADIR)} and {', '.join(_BODY)}"
        raise ForeignTableError(
            f"REF_FRAME_A = {segment.meta.get('REF_FRAME_A')}, REF_FRAME_B = {segment.meta.get('REF_FRAME_B')};"
            f" understood: {wanted}; turn inertial attitudes into the orbital frame first"
        )
    direction = segment.meta.get("ATTITUDE_DIR", "A2B").upper()
    return is_swapped != (direction == "B2A")


def _scalar_last(segment: Segment, quaternions: np.ndarray) -> np.ndarray:
    """Return quaternions scalar last; refuse those whose numbers contradict the metadata."""
    stated = segment.meta.get("QUATERNION_TYPE", "LAST").lower()
    proven = scalar_of(quaternions)
    if proven != stated:
        shown = "at neither end" if proven is None else proven
        raise ForeignTableError(f"the message states the scalar {stated}, the numbers show it {shown}")
    return np.roll(quaternions, -1, axis=1) if stated == "first" else quaternions
