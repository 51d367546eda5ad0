"""Disagreement of the two methods: roll or pitch apart by more than a limit for longer than a time."""

from dataclasses import dataclass

from service.pipeline.config import RobustConfig
from service.records.attitude import AttitudeRow, Status
from service.records.epoch import US_PER_S


@dataclass(frozen=True)
class Disagreement:
    """Since when the methods have been apart, None while they are not."""

    since_us: int | None = None

    def is_standing(self, epoch_us: int, config: RobustConfig) -> bool:
        """Return whether they have been apart for long enough."""
        return self.since_us is not None and epoch_us - self.since_us >= config.disagreement_s * US_PER_S


def compare(watch: Disagreement, rows: tuple[AttitudeRow, ...], config: RobustConfig) -> Disagreement:
    """Return the watch after the rows of one measurement; a row without angles says nothing."""
    told = [row for row in rows if row.status is Status.ACQUIRED]
    if len(told) < 2:
        return watch
    one, other = told[0].attitude_deg, told[1].attitude_deg
    apart_deg = max(abs(one.roll - other.roll), abs(one.pitch - other.pitch))
    if apart_deg <= config.disagreement_deg:
        return Disagreement()
    return watch if watch.since_us is not None else Disagreement(told[0].epoch_us)
