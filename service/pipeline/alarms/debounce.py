"""One watched value: debounce on the way in, deadband and debounce on the way out.

Time is that of the epochs told, so the same values at the same epochs lead to the same verdicts. A value that is not
known (NaN) says nothing: what was about to alarm begins again, what stands goes on standing.
"""

import math
from enum import Enum, auto

from service.pipeline.alarms.condition import Kind
from service.records.epoch import US_PER_S
from service.records.operations.alarm_limits import ConditionLimits
from service.records.operations.alarm_memory import ValueMemory


class ConditionChange(Enum):
    """Change of a condition by a value."""

    RAISE = auto()
    ESCALATE = auto()
    RETURN = auto()


def limit_of(limits: ConditionLimits, level: int) -> float:
    """Return the threshold of a severity, NaN where it has none."""
    threshold = limits.thresholds[level - 1] if level else None
    return math.nan if threshold is None else threshold


def outermost(kind: Kind, limits: ConditionLimits) -> float | None:
    """Return the limit that is passed first, None when all are switched off."""
    stated = [threshold for threshold in limits.thresholds if threshold is not None]
    if not stated:
        return None
    return max(stated) if kind is Kind.BELOW else min(stated)


def severity_level(kind: Kind, value: float, limits: ConditionLimits) -> int:
    """Return the worst severity whose limit a value has passed, 0 for none."""
    passed = 0
    for level, threshold in enumerate(limits.thresholds, start=1):
        if threshold is not None and _is_beyond(kind, value, threshold):
            passed = level
    return passed


def poll(
    watch: ValueMemory, kind: Kind, reported: float, epoch_us: int, limits: ConditionLimits
) -> ConditionChange | None:
    """Update the memory with a value and return the change of the condition, if any.

    Parameters
    ----------
    watch : ValueMemory
        Changed in place.
    kind : Kind
        How the value is held against the limits.
    reported : float
        The value; of a condition that lasts, 1 while it holds and 0 when not. NaN = not known.
    epoch_us : int
        Instant of the value; one that lies before the newest changes nothing.
    limits : ConditionLimits
        Those in force.
    """
    if epoch_us < watch.newest_us:
        return None
    watch.newest_us = epoch_us
    if math.isnan(reported):
        watch.pending_us, watch.gone_us = None, None
        return None
    is_gone = _is_gone(kind, reported, limits)
    watch.value = _value(watch, kind, reported, epoch_us)
    verdict = _worse(watch, severity_level(kind, watch.value, limits), epoch_us, limits)
    if verdict is not None:
        return verdict
    return _better(watch, epoch_us, limits, is_gone=is_gone)


def _value(watch: ValueMemory, kind: Kind, reported: float, epoch_us: int) -> float:
    """Return the value that is held against the limits; of what lasts, the time since it began, s."""
    if kind is not Kind.LASTING:
        return reported
    if reported <= 0.0:
        if watch.level == 0:
            watch.since_us = None
        return -1.0
    if watch.since_us is None:
        watch.since_us = epoch_us
    return (epoch_us - watch.since_us) / US_PER_S


def _worse(watch: ValueMemory, level: int, epoch_us: int, limits: ConditionLimits) -> ConditionChange | None:
    """Take in a severity; a verdict when one above the alarmed one has stood for its time."""
    if level <= watch.level:
        watch.pending_us = None
        return None
    watch.gone_us = None
    if watch.pending_us is None:
        watch.pending_us, watch.pending_level = epoch_us, level
    watch.pending_level = min(watch.pending_level, level)
    if epoch_us - watch.pending_us < limits.on_s * US_PER_S:
        return None
    verdict = ConditionChange.RAISE if watch.level == 0 else ConditionChange.ESCALATE
    watch.since_us = watch.pending_us if watch.since_us is None else watch.since_us
    watch.level, watch.pending_us = watch.pending_level, None
    return verdict


def _better(watch: ValueMemory, epoch_us: int, limits: ConditionLimits, *, is_gone: bool) -> ConditionChange | None:
    """Return the verdict when what was alarmed has been gone for its time."""
    if watch.level == 0:
        return None
    if not is_gone:
        watch.gone_us = None
        return None
    if watch.gone_us is None:
        watch.gone_us = epoch_us
    if epoch_us - watch.gone_us < limits.off_s * US_PER_S:
        return None
    watch.level, watch.since_us, watch.gone_us = 0, None, None
    return ConditionChange.RETURN


def _is_gone(kind: Kind, reported: float, limits: ConditionLimits) -> bool:
    """Return whether a value lies inside every limit by the deadband."""
    bound = outermost(kind, limits)
    if bound is None:
        return True
    if kind is Kind.LASTING:
        return reported <= 0.0
    if kind is Kind.BELOW:
        return reported >= bound + limits.deadband
    # values above limits are sizes: a deadband wider than the limit still lets nothing at all count as gone
    return reported <= (max(bound - limits.deadband, 0.0) if bound >= 0.0 else bound - limits.deadband)


def _is_beyond(kind: Kind, value: float, threshold: float) -> bool:
    """Return whether a value has passed a limit."""
    if kind is Kind.LASTING:
        return value >= threshold
    return value < threshold if kind is Kind.BELOW else value > threshold
