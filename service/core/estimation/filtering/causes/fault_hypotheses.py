"""Choice between the causes that move several carriers at once.

    H_h: nu ~ N(0, S + B_h B_h'),   score = log p(nu | H_h) + log prior_h

B of an attitude jump holds the three gradients, of a transponder's gain step ones at its carriers, of the receiving
chain or rain ones at all. Under every hypothesis carriers that still contradict the others are taken out one by one,
each at the price of a fault of its own, down to the breakdown of the subset; without a common cause that is all there
is. The law of this file: a pure comparison of likelihoods, the state is not touched.
"""

import math
from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.filter_update import Innovation
from service.core.estimation.filtering.model.filter_model import CarrierModel, FloatArray
from service.core.estimation.filtering.model.filter_state import ATTITUDE

#: sizes that the causes have, one standard deviation
JUMP_DEG = 0.3
GROUP_STEP_DB = 2.0
COMMON_STEP_DB = 2.0
OWN_STEP_DB = 3.0
#: log of how likely each is in a row against nothing
_PRIOR = {"own": -5.0, "common": -4.0, "group": -5.0, "attitude": -9.0}
#: a carrier that contradicts the others by more than this many sigma is taken out
_CONTRADICTION = 4.0
_MIN_GROUP = 3


class Cause(StrEnum):
    """Cause of a simultaneous change of several carriers."""

    INDEPENDENT = "independent"
    COMMON = "common"
    GROUP = "group"
    ATTITUDE = "attitude"


class LikeliestCause(NamedTuple):
    """The likeliest cause."""

    cause: Cause
    #: number of the transponder of a group step, -1 else
    transponder: int = -1


#: decides what moved several carriers at once, from the innovations of a row before anything is taken out
Chooser = Callable[[CarrierModel, Innovation], LikeliestCause]


def choose_cause(model: CarrierModel, innovation: Innovation) -> LikeliestCause:
    """Return the likeliest cause of a row in which several carriers fail.

    Parameters
    ----------
    model : CarrierModel
        The carriers, with the transponder of each.
    innovation : Innovation
        Of all carriers that stood unflagged before the row.

    Returns
    -------
    LikeliestCause
        `INDEPENDENT` where each failing carrier is best explained by a fault of its own.
    """
    count = len(innovation.carriers)
    candidates = [
        (LikeliestCause(Cause.INDEPENDENT), np.zeros((count, 0)), 0.0),
        (LikeliestCause(Cause.COMMON), np.full((count, 1), COMMON_STEP_DB), _PRIOR["common"]),
        (LikeliestCause(Cause.ATTITUDE), JUMP_DEG * innovation.core_jacobian[:, ATTITUDE], _PRIOR["attitude"]),
    ]
    labels = model.transponder[innovation.carriers]
    for transponder in np.unique(labels).tolist():
        members = labels == transponder
        if _MIN_GROUP <= np.count_nonzero(members) < count:
            column = GROUP_STEP_DB * members[:, None].astype(np.float64)
            candidates.append((LikeliestCause(Cause.GROUP, transponder), column, _PRIOR["group"]))
    spread = innovation.covariance_db2
    scores = [
        prior + _log_likelihood(innovation.innovation_db, spread + column @ column.T)
        for _choice, column, prior in candidates
    ]
    return candidates[int(np.argmax(scores))][0]


def _log_likelihood(innovation_db: FloatArray, covariance_db2: FloatArray) -> float:
    """Return the log likelihood with contradicting carriers taken out at their price."""
    kept = np.arange(len(innovation_db))
    allowed = (len(kept) - 4) // 2
    price = 0.0
    while True:
        inverse = np.linalg.inv(covariance_db2[np.ix_(kept, kept)])
        weighted = inverse @ innovation_db[kept]
        alone = weighted**2 / np.diagonal(inverse)
        worst = int(alone.argmax())
        if alone[worst] <= _CONTRADICTION**2 or len(innovation_db) - len(kept) >= allowed:
            break
        # without the others' word the carrier's own step is spread over OWN_STEP_DB
        step_db = weighted[worst] / inverse[worst, worst]
        price += _PRIOR["own"] - math.log(OWN_STEP_DB) - 0.5 * (step_db / OWN_STEP_DB) ** 2
        kept = np.delete(kept, worst)
    half_log_det = 0.5 * float(np.linalg.slogdet(inverse)[1])
    normal = half_log_det - 0.5 * float(innovation_db[kept] @ weighted) - 0.5 * len(kept) * math.log(2.0 * math.pi)
    return normal + price - 0.5 * (len(innovation_db) - len(kept)) * math.log(2.0 * math.pi)
