"""Attitude Ephemeris Messages (CCSDS 504.0-B-2, AEM 2.0, keyword = value): written page by page, and read.

Frames: ``LVLH_ROTATING`` (z nadir, y opposite to the orbit's momentum, hence x East, y South) to ``SC_BODY_1``: the
service's nadir and body axes. Quaternions are scalar last, of unit length, of one sign through a segment. A new segment
begins at every gap and wherever status, calibration or alignment change, so that nobody interpolates across; rows
without an attitude end a segment and are not written. AEM has no place for uncertainty: the largest one standard
deviation of each axis of a segment stands in a comment; a reader who needs it row by row takes CSV or Parquet.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from math import isfinite

import numpy as np

from service.core.geometry.quaternion import quaternion_of_attitude, with_continuous_sign
from service.formats.ccsds import as_bytes, comment, epoch_texts, line, message_header
from service.records.levels.attitude import AttitudeRow, FloatArray, IntArray

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
