"""Common cause of changes of several carriers in one row, and the unknown that is set free for it.

The common level is tested before any single carrier. Several suspects at once, or a sudden common value, go to the
chooser; a cumulative sum beyond its limit is a common change. The law of this file: what is freed is one unknown for
all that moved together, so that the carriers keep what they know relative to one another.
"""

from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.causes.carrier_faults import CarrierWatch
from service.core.estimation.filtering.causes.common_change import common_value, quiet_cusum
from service.core.estimation.filtering.causes.fault_hypotheses import (
    GROUP_STEP_DB,
    JUMP_DEG,
    Cause,
    LikeliestCause,
)
from service.core.estimation.filtering.causes.rain_state import (
    SUDDEN,
    RainWatch,
    common_fell,
    common_rose,
    is_down,
    is_up,
)
from service.core.estimation.filtering.filter_update import Innovation
from service.core.estimation.filtering.model.filter_model import CarrierModel, FloatArray
from service.core.estimation.filtering.model.filter_state import (
    ATTITUDE,
    Gaussian,
    freed,
    hidden_count,
    reference_states,
)

#: carriers beyond this many sigma are suspects; this many at once have a common cause
_SUSPECT = 3.0
_SEVERAL = 3


#: what a row says of a common change: none, one of the sums, one that a chooser must explain
NOTHING, SLOW_CHANGE, SUDDEN_CHANGE = 0, 1, 2


class CommonInnovation(NamedTuple):
    """Median innovation of the fully affected band; NaN with too few of them."""

    median_db: float
    #: in units of its sigma
    value: float


class Widened(NamedTuple):
    """State in which the cause's unknown is free."""

    gaussian: Gaussian
    carriers: CarrierWatch
    rain: RainWatch


def common_innovation(model: CarrierModel, innovation: Innovation) -> CommonInnovation:
    """Return the common part of a row's innovations."""
    is_full = (model.rain_share >= 0.5 * model.rain_share.max())[innovation.carriers]
    full = np.flatnonzero(is_full)
    if len(full) < _SEVERAL:
        return CommonInnovation(np.nan, np.nan)
    spread = (innovation.predicted_db2 + np.diag(innovation.white_db2))[full][:, full]
    median_db, value = common_value(innovation.innovation_db[full], spread)
    return CommonInnovation(median_db, value)


def suspicion(rain: RainWatch, excess: FloatArray, common: CommonInnovation) -> int:
    """Return whether carriers changed together in a row: `NOTHING`, `SLOW_CHANGE` or `SUDDEN_CHANGE`.

    Parameters
    ----------
    rain : RainWatch
        Sums of the common level, this row included.
    excess : ndarray, shape (n,)
        abs(innovation) / sigma of all carriers that are not flagged.
    common : CommonInnovation
        Common part of them.
    """
    if np.count_nonzero(excess > _SUSPECT) >= _SEVERAL or abs(common.value) > SUDDEN:
        return SUDDEN_CHANGE
    return SLOW_CHANGE if is_down(rain) or is_up(rain) else NOTHING


def widen(
    model: CarrierModel,
    gaussian: Gaussian,
    carriers: CarrierWatch,
    rain: RainWatch,
    choice: LikeliestCause,
    common: CommonInnovation,
    *,
    is_chain_worked: bool = False,
) -> Widened:
    """Return the state in which the unknown of a cause is free.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    gaussian, carriers, rain : Gaussian, CarrierWatch, RainWatch
        Predicted state and watches.
    choice : LikeliestCause
        Cause, not `INDEPENDENT`.
    common : CommonInnovation
        Common part of the row.
    is_chain_worked : bool
        Whether the ground declared work on the receiving chain: a common fall is the chain's then, and no rain.

    Returns
    -------
    Widened
        The sums of single carriers begin again: what they had gathered belongs to the common cause.
    """
    calm = carriers._replace(cusum=quiet_cusum(model.carriers))
    if choice.cause is Cause.GROUP:
        members = np.flatnonzero((model.transponder == choice.transponder) & ~carriers.is_flagged)
        positions = reference_states(model, members, hidden_count(model, len(gaussian.mean)))
        return Widened(freed(gaussian, positions, GROUP_STEP_DB**2), calm, rain)
    if choice.cause is Cause.ATTITUDE:
        for axis in range(ATTITUDE.start, ATTITUDE.stop):
            gaussian = freed(gaussian, np.array([axis]), JUMP_DEG**2)
        return Widened(gaussian, calm, rain)
    # the sums decide where they spoke, else the row itself
    falls = not is_chain_worked and (is_down(rain) or (common.median_db < 0.0 and not is_up(rain)))
    changed, watch = (common_fell if falls else common_rose)(gaussian, rain, common.median_db)
    return Widened(changed, calm, watch)
