"""Reader of the attitude messages that the service writes."""

from dataclasses import dataclass

import numpy as np

from service.core.geometry.frames import attitude_of_quaternion
from service.formats.ccsds import _VERSION, Segment, epoch_of, malformed, read_segments
from service.records.levels.attitude import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class AttitudeTrack:
    """One segment as read: (T,) microseconds UTC and (T, 3) deg, yaw, roll, pitch."""

    object_name: str
    epochs_us: IntArray
    attitude_deg: FloatArray


def read_aem(text: str) -> tuple[AttitudeTrack, ...]:
    """Return the segments of a message with quaternions LVLH_ROTATING -> SC_BODY_1.

    Raises
    ------
    InvalidInputError
        ``ccsds.malformed`` with the line, ``ccsds.unsupported`` with the keyword.
    """
    return tuple(_track(segment) for segment in read_segments(text, _VERSION))


def _track(segment: Segment) -> AttitudeTrack:
    epochs_us: list[int] = []
    quaternions: list[list[float]] = []
    for number, content in segment.data:
        fields = content.split()
        try:
            values = [float(text) for text in fields[1:]]
        except ValueError:
            values = []
        length = float(np.linalg.norm(values)) if len(values) == 4 else 0.0
        if not abs(length - 1.0) < 1e-3:
            raise malformed(number, "a row is an epoch and the four parts of a unit quaternion, scalar last")
        epochs_us.append(epoch_of(number, fields[0]))
        quaternions.append(values)
    attitude_deg = attitude_of_quaternion(np.array(quaternions).reshape(-1, 4))
    return AttitudeTrack(segment.meta.get("OBJECT_NAME", ""), np.array(epochs_us, dtype=np.int64), attitude_deg)
