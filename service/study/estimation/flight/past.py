"""Smoothed answer of the product in one world: every row after all later ones, and some rows at a fixed lag."""

from dataclasses import dataclass, field

import numpy as np

from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.estimation.smoothed import MOST_ROWS, SmoothedRow, SpanSmoother, lagged_angles
from service.records.levels.attitude import FloatArray, IntArray

#: fixed lag, and how far the rows lie apart at which it is asked, h
LAG_H, _PERIOD_H = 2.0, 0.5
_US_PER_H = 3.6e9
_ANGLES = slice(0, 3)


@dataclass(frozen=True)
class PastSeries:
    """Smoothed angles of M rows."""

    #: (M,) microseconds UTC
    epochs_us: IntArray
    #: (M, 3) deg, yaw, roll, pitch
    estimate_deg: FloatArray
    sigma_deg: FloatArray


@dataclass
class Past:
    """Smoothers beside the chain of a study.

    Parameters
    ----------
    recorder : RowRecorder
        Recorder of the chain.
    """

    recorder: RowRecorder = field(default_factory=lambda: RowRecorder(MOST_ROWS))

    def __post_init__(self) -> None:
        """Begin with no row."""
        self._span = SpanSmoother(self.recorder)
        self._whole: list[SmoothedRow] = []
        self._lagged: list[SmoothedRow] = []

    def push_newest(self) -> None:
        """Take in the newest row of the recorder."""
        rows = self.recorder.rows
        if rows and (not self._lagged or self._is_due(rows[-1].epoch_us)):
            found = lagged_angles(rows, int(LAG_H * _US_PER_H))
            self._lagged += [] if found is None else [found]
        self._whole += self._span.pop()

    def series(self) -> dict[str, PastSeries]:
        """Return the smoothed answers by name after the last row."""
        self._whole += self._span.rest()
        return {"smoothed": _series(self._whole), "smoothed_2h": _series(self._lagged)}

    def _is_due(self, newest_us: int) -> bool:
        newest = self._lagged[-1]
        return newest_us >= newest.epoch_us + newest.lag_us + int(_PERIOD_H * _US_PER_H)


def _series(found: list[SmoothedRow]) -> PastSeries:
    """Return smoothed rows as arrays."""
    sigma = [np.sqrt(np.diag(each.state.covariance)[_ANGLES]) for each in found]
    return PastSeries(
        np.array([each.epoch_us for each in found], dtype=np.int64),
        np.array([each.state.mean[_ANGLES] for each in found]).reshape(-1, 3),
        np.array(sigma).reshape(-1, 3),
    )
