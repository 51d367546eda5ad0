"""Records of the attitude filter: state handed from one step to the next, and result of a step.

The law of this file: values only; a step never changes the state it was given.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.anchor.anchor_watch import AnchorWatch, calm_anchor
from service.core.estimation.filtering.causes.carrier_faults import CarrierWatch, healthy
from service.core.estimation.filtering.causes.common_cause import Cause, RainWatch, dry_watch
from service.core.estimation.filtering.filter_update import EffectiveUpdate
from service.core.estimation.filtering.model.filter_model import CarrierModel, Gaussian
from service.core.estimation.filtering.watches.command_watch import CommandWatch, executed_commands
from service.core.estimation.filtering.watches.drift_watch import DriftWatch, usual_drift
from service.core.estimation.filtering.watches.integrity import Integrity, good_figures
from service.core.estimation.filtering.watches.minute_sums import MinuteSums, empty_minute
from service.core.estimation.filtering.watches.motion_watch import MotionWatch, still_watch
from service.core.estimation.filtering.watches.noise_watch import NoiseWatch, calm_watch


class FilterState(NamedTuple):
    """State of the filter between two steps."""

    epoch_us: int
    gaussian: Gaussian
    carriers: CarrierWatch
    rain: RainWatch
    noise: NoiseWatch
    #: test values of the carriers, the common one last
    minute: MinuteSums
    motion: MotionWatch
    model_variance_db2: FloatArray
    anchor: AnchorWatch
    drift: DriftWatch = usual_drift()
    command: CommandWatch = executed_commands()
    #: until when each figure of integrity inhibits at least
    beyond_until_us: IntArray = good_figures()


class FilterStep(NamedTuple):
    """State after a row and the result of the row."""

    state: FilterState
    #: (3,) deg and (3, 3) deg^2
    attitude_deg: FloatArray
    covariance_deg2: FloatArray
    #: (3,) deg, levels that the error passes with a probability of 1e-4, NaN = not known
    protection_deg: FloatArray
    #: (3,) deg, those levels if nothing were wrong with any carrier
    nominal_deg: FloatArray
    #: (3,) deg, loss by two hours without control
    waiting_loss_deg: FloatArray
    #: (N,) dB, NaN = absent or flagged
    innovation_db: FloatArray
    #: (n,) carriers used
    used: IntArray
    cause: Cause | None
    common_db: float
    rain_db: float
    integrity: Integrity
    #: (N,) dB, measured minus what attitude, chain, rain and common parts explain; NaN = absent
    residual_db: FloatArray
    #: whether nothing was found that takes a row through its stages one by one
    is_ordinary: bool = True
    #: update as it acted; None where no row was used
    effective: EffectiveUpdate | None = None


def start(model: CarrierModel, epoch_us: int, gaussian: Gaussian) -> FilterState:
    """Return the state of a filter that was just aligned.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    epoch_us : int, microseconds UTC
        Epoch of the alignment.
    gaussian : Gaussian
        From `initial_gaussian`.
    """
    count = model.carriers
    return FilterState(
        epoch_us,
        gaussian,
        healthy(np.diagonal(gaussian.covariance)[-count:].copy()),
        dry_watch(),
        calm_watch(count),
        empty_minute(count + 1, epoch_us),
        still_watch(epoch_us),
        np.zeros(count),
        calm_anchor(count, epoch_us),
    )
