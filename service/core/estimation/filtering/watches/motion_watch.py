"""Motion that nobody announced: the attitude's own shifts, watched for one sign.

While the model holds, what a row adds to an angle, in units of its sigma, is white and of unit variance. A correction
that was lost, doubled or turned round, or a coupling that does not act, makes shifts of one sign: the two-sided sum
finds them, the axis is followed with a wide drift for an hour and control is told. Where a torque that nobody feeds
forward is among the states it may be greater than it was thought to be: the first alarm of an axis widens it, and
control goes on, for to stop it would leave the spacecraft to that torque. The second within the hour widens it again
and is reported for a quarter of an hour. What moves the axis on after that is something else. The law of this file:
one value a minute and axis, order yaw, roll, pitch.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray
from service.core.estimation.filtering.causes.common_change import (
    THRESHOLD,
    Cusum,
    push_cusum,
    quiet_cusum,
    reset_cusum,
)
from service.core.estimation.filtering.watches.minute_sums import MinuteSums, empty_minute, push_minute

#: minutes for which an axis is followed after an alarm
FOLLOWED_MINUTES = 60.0
#: minutes for which the second alarm of an axis is reported where a torque may explain it
EXPLAINED_MINUTES = 15.0
#: alarms of an axis, each within an hour of the one before, that a torque may explain
_EXPLAINED_ALARMS = 2


class MotionWatch(NamedTuple):
    """Shifts seen so far."""

    minute: MinuteSums
    cusum: Cusum
    #: (3,) minutes for which each axis is still followed
    minutes_left: FloatArray
    #: (3,) minutes for which the motion of each axis is still reported as unannounced
    reported_minutes: FloatArray
    #: (3,) alarms of each axis since it was last still
    alarms: FloatArray
    #: minutes for which a jump of all axes together is still reported
    jump_minutes: float = 0.0

    @property
    def is_followed(self) -> tuple[bool, bool, bool]:
        """Return whether each axis is followed with a wide drift."""
        yaw, roll, pitch = (self.minutes_left > 0.0).tolist()
        return yaw, roll, pitch

    @property
    def is_unannounced(self) -> tuple[bool, bool, bool]:
        """Return whether the motion of each axis is reported as unannounced."""
        yaw, roll, pitch = (self.reported_minutes > 0.0).tolist()
        return yaw, roll, pitch


def still_watch(epoch_us: int) -> MotionWatch:
    """Return the watch of a spacecraft that does what it is told."""
    return MotionWatch(empty_minute(3, epoch_us), quiet_cusum(3), np.zeros(3), np.zeros(3), np.zeros(3))


def push_shift(watch: MotionWatch, epoch_us: int, shift: FloatArray) -> MotionWatch:
    """Return the watch with the shifts (3,) of one row, in sigmas."""
    sums, is_over, values = push_minute(watch.minute, epoch_us, shift)
    cusum = push_cusum(watch.cusum, values) if is_over else watch.cusum
    return MotionWatch(sums, cusum, watch.minutes_left, watch.reported_minutes, watch.alarms, watch.jump_minutes)


def alarmed_axes(watch: MotionWatch) -> BoolArray:
    """Return the axes (3,) whose shifts are beyond their limit."""
    is_alarm: BoolArray = np.maximum(watch.cusum.up, watch.cusum.down) > THRESHOLD
    return is_alarm


def with_alarms(watch: MotionWatch, *, is_pushed: bool) -> MotionWatch:
    """Return the watch after its alarms; `is_pushed` = a torque is among the states."""
    is_alarm = alarmed_axes(watch)
    left = np.where(is_alarm, FOLLOWED_MINUTES, watch.minutes_left)
    alarms = watch.alarms + is_alarm
    minutes = np.full(3, FOLLOWED_MINUTES)
    if is_pushed:
        minutes = np.select(
            [alarms < _EXPLAINED_ALARMS, alarms == _EXPLAINED_ALARMS], [0.0, EXPLAINED_MINUTES], minutes
        )
    reported = np.where(is_alarm, np.maximum(minutes, watch.reported_minutes), watch.reported_minutes)
    return watch._replace(
        cusum=reset_cusum(watch.cusum, is_alarm), minutes_left=left, reported_minutes=reported, alarms=alarms
    )


def with_explained(watch: MotionWatch, axes: BoolArray) -> MotionWatch:
    """Return the watch after motion about some axes (3,) that a torque is to explain."""
    left = np.where(axes, FOLLOWED_MINUTES, watch.minutes_left)
    return watch._replace(cusum=reset_cusum(watch.cusum, axes), minutes_left=left, alarms=watch.alarms + axes)


def newly_explained(before: MotionWatch, after: MotionWatch) -> BoolArray:
    """Return the axes (3,) whose motion a greater torque is to explain from this row on."""
    return np.asarray((after.alarms > before.alarms) & (after.alarms <= _EXPLAINED_ALARMS))


def forget_shifts(watch: MotionWatch, epoch_us: int) -> MotionWatch:
    """Return the watch with sums of nothing: what moved the row is known and was no motion."""
    minutes = watch.minutes_left, watch.reported_minutes
    return MotionWatch(empty_minute(3, epoch_us), quiet_cusum(3), *minutes, watch.alarms, watch.jump_minutes)


def follow_all(watch: MotionWatch) -> MotionWatch:
    """Return the watch of a spacecraft that has jumped: all axes are followed, and no torque explains it."""
    left, alarms = np.full(3, FOLLOWED_MINUTES), watch.alarms + _EXPLAINED_ALARMS
    return MotionWatch(watch.minute, quiet_cusum(3), left, left, alarms, FOLLOWED_MINUTES)


def pass_motion(watch: MotionWatch, minutes: float) -> MotionWatch:
    """Return the watch some minutes of data later."""
    if not watch.minutes_left.any():
        return watch
    left = np.maximum(0.0, watch.minutes_left - minutes)
    reported = np.maximum(0.0, watch.reported_minutes - minutes)
    alarms = np.where(left > 0.0, watch.alarms, 0.0)
    return MotionWatch(watch.minute, watch.cusum, left, reported, alarms, max(0.0, watch.jump_minutes - minutes))
