"""Disagreement of the two methods: roll or pitch apart by more than a limit for longer than a time.

The one rule for it: status, alarms and interlock read what it has found.
"""

import math
from dataclasses import dataclass, replace

from service.pipeline.config import RobustConfig
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow, Status


@dataclass(frozen=True)
class Disagreement:
    """The methods as they were compared last."""

    #: since when they have been apart, None while they are not
    since_us: int | None = None
    #: whether they have been apart for long enough
    is_standing: bool = False
    #: by how much, 0 unless it stands; NaN: the newest row compares nothing
    apart_deg: float = math.nan


def compare(watch: Disagreement, rows: tuple[AttitudeRow, ...], config: RobustConfig) -> Disagreement:
    """Return the watch after the rows of one measurement; a row without angles says nothing."""
    reported = [row for row in rows if row.status is Status.ACQUIRED]
    if len(reported) < 2:
        return replace(watch, apart_deg=math.nan)
    one, other = reported[0].attitude_deg, reported[1].attitude_deg
    apart_deg = max(abs(one.roll - other.roll), abs(one.pitch - other.pitch))
    if not apart_deg > config.disagreement_deg:
        return Disagreement(apart_deg=0.0)
    since_us = reported[0].epoch_us if watch.since_us is None else watch.since_us
    is_standing = reported[0].epoch_us - since_us >= config.disagreement_s * US_PER_S
    return Disagreement(since_us, is_standing, apart_deg if is_standing else 0.0)
