"""Effects of declared operations on the detectors of a step; the prediction handles the state vector.

The law of this file: what the ground declared is no fault. A masked carrier is neither used nor missed, a declared
step of levels empties the sums it would have filled, a declared change of the chain holds control as a found one does.
Steps too small to be told from noise, of which an operation that lasts makes one a row, widen the state and no more.
"""

import numpy as np

from service.core.estimation.filtering.causes.carrier_faults import SAME_LEVEL_DB, CarrierWatch
from service.core.estimation.filtering.causes.common_change import quiet_cusum, reset_cusum
from service.core.estimation.filtering.causes.rain_state import HOLD_MINUTES
from service.core.estimation.filtering.filter_records import FilterState
from service.core.estimation.filtering.model.declared import Declared
from service.core.estimation.filtering.model.filter_model import BoolArray, CarrierModel
from service.core.estimation.filtering.watches.motion_watch import forget_shifts

#: smallest declared step of an attitude that the watch on motion must not take for its own, deg
_STEP_DEG = 0.05


def with_declared(model: CarrierModel, state: FilterState, declared: Declared) -> FilterState:
    """Return the state whose detectors know what was declared about the step.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    state : FilterState
        Predicted state.
    declared : Declared
        Effect of the declared operations on the step.
    """
    reported = state._replace(carriers=_levels_declared(model, state.carriers, declared))
    if declared.chain_step_db > SAME_LEVEL_DB:
        rain = state.rain._replace(hold_minutes=HOLD_MINUTES, cusum=quiet_cusum(1))
        reported = reported._replace(rain=rain)
    if np.any(declared.attitude_step_deg > _STEP_DEG):
        reported = reported._replace(motion=forget_shifts(state.motion, state.epoch_us))
    return reported


def is_chain_worked(declared: Declared | None) -> bool:
    """Return whether the receiving chain is being worked on, so that a common fall is not taken for rain."""
    return declared is not None and (declared.chain_walk_db > 0.0 or declared.chain_step_db > SAME_LEVEL_DB)


def stepped_carriers(model: CarrierModel, declared: Declared) -> BoolArray:
    """Return the carriers (N,) whose levels were declared to step, alone or with their transponder."""
    group_db = declared.group_step_db[model.transponder]
    return np.asarray((declared.reference_step_db > SAME_LEVEL_DB) | (group_db > SAME_LEVEL_DB))


def _levels_declared(model: CarrierModel, watch: CarrierWatch, declared: Declared) -> CarrierWatch:
    """Return the watch on carriers of which some were declared to step or not to be used."""
    is_stepped = stepped_carriers(model, declared)
    step_db2 = declared.reference_step_db**2 + declared.group_step_db[model.transponder] ** 2
    return watch._replace(
        skip_minutes=np.where(is_stepped, 0.0, watch.skip_minutes),
        cusum=reset_cusum(watch.cusum, is_stepped),
        absent_minutes=np.where(declared.is_masked, 0.0, watch.absent_minutes),
        saved_variance_db2=watch.saved_variance_db2 + step_db2,
        is_relearned=watch.is_relearned | (declared.reference_step_db > SAME_LEVEL_DB),
    )
