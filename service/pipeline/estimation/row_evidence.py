"""One row as the chain leaves it, for the alarms."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from service.pipeline.estimation.method import CarrierLevels
from service.records.catalogue import CarrierPlan, Method
from service.records.inputs import Operation
from service.records.levels.attitude import AttitudeRow
from service.records.levels.measurement import Measurement


class RowEvidence(NamedTuple):
    """One row as the chain leaves it: neither late nor caught up with."""

    measurement: Measurement
    plan: CarrierPlan
    #: what the methods say; empty while none runs
    rows: tuple[AttitudeRow, ...]
    #: the one that drives control
    method: Method
    levels: CarrierLevels | None
    #: newest revision of each declared operation
    operations: Mapping[int, Operation]
    #: by how much the methods differ while they disagree, 0 while they agree; NaN: not compared
    disagreement_deg: float = math.nan
