"""New start of the filter where the references of the alignment contradict its attitude.

The attitude is moved by the error that the anchor found and set free; carriers that are likely dry have the reference
of the alignment again, those that are not are set aside. Drift, rates, receiving chain and rain go on as they are. The
rows that follow settle the attitude, so that no reading counts twice.
"""

import numpy as np

from service.core.estimation.filtering.anchor.anchor_watch import ERROR_SIGMA_DEG, moved_anchor
from service.core.estimation.filtering.anchor.carrier_mixture import DRY, LEARNED, Mixture
from service.core.estimation.filtering.causes.carrier_faults import give_back, set_aside
from service.core.estimation.filtering.causes.common_change import quiet_cusum
from service.core.estimation.filtering.filter_records import FilterState
from service.core.estimation.filtering.model.filter_model import CarrierModel
from service.core.estimation.filtering.model.filter_state import ATTITUDE, Gaussian
from service.core.estimation.filtering.watches.motion_watch import forget_shifts

#: a hypothesis that is likelier than all others together
_LIKELY = 0.5
#: what a reference may have moved since the alignment, dB
_MOVED_DB = 0.05


def start_again(model: CarrierModel, state: FilterState, mixture: Mixture) -> FilterState:
    """Return the state at the attitude that the references of the alignment ask for, with these references."""
    watch, mean, covariance = state.carriers, state.gaussian.mean.copy(), state.gaussian.covariance.copy()
    # as the anchor was asked: the error that it found, and what the filter did not know before
    sigma_deg = np.hypot(ERROR_SIGMA_DEG, state.gaussian.attitude_sigma_deg)
    anchor = moved_anchor(model, state.anchor, mean[ATTITUDE], sigma_deg, mixture)
    mean[ATTITUDE] += mixture.error_deg
    covariance[ATTITUDE, :] = covariance[:, ATTITUDE] = 0.0
    covariance[ATTITUDE, ATTITUDE] = np.diag(sigma_deg**2)
    is_dry = (mixture.branch_probability[:, DRY] > _LIKELY) & np.isfinite(watch.aligned_reference_db)
    is_out = ~is_dry & ~watch.is_flagged & (mixture.branch_probability[:, LEARNED] < _LIKELY)
    gaussian, watch = give_back(model, Gaussian(mean, covariance), watch, is_dry, _MOVED_DB**2)
    gaussian, watch = set_aside(model, gaussian, watch, is_out, watch.aligned_reference_db, watch.aligned_variance_db2)
    return state._replace(
        gaussian=gaussian,
        anchor=anchor,
        carriers=watch._replace(cusum=quiet_cusum(model.carriers)),
        motion=forget_shifts(state.motion, state.epoch_us),
    )
