"""One condition that alarms: how its value is held against limits, and where the value comes from."""

from dataclasses import dataclass
from enum import StrEnum

from service.records.operations.alarm_limits import ConditionLimits


class Kind(StrEnum):
    """Comparison of a value with its limits."""

    #: alarms above the limit
    ABOVE = "above"
    #: alarms below the limit
    BELOW = "below"
    #: the value is the time for which something has been so, s; it alarms from the limit on
    LASTING = "lasting"


class Origin(StrEnum):
    """Origin of the value of a condition."""

    ROW = "every row that is neither late nor from a catch-up"
    CLOCK = "intervals of `SOO_ALARMS__CHECK_PERIOD_S` of the spacecraft's clock"
    REFERENCE = "every attitude reference near a row in time"


@dataclass(frozen=True, slots=True)
class AlarmCondition:
    """One condition."""

    name: str
    kind: Kind
    unit: str
    #: what its alarms are about: carrier, axis, link ..
    thing: str
    origin: Origin
    #: what happened, a sentence with a place for the thing and one for the value
    says: str
    next_step: str
    limits: ConditionLimits
