"""Feed of a polarimeter by quiet days and turns, when sensors tell the angles: its turn, its leakage, its daily wave.

    r = 10^(D/20) = tan(d0 + p) + e,    atan r - p = d0 + e cos^2 d0 + slow,    d(atan r)/dp = 1 - e sin(2 d0)

d0 turn of the feed, e leakage, p turn of the body about the line of sight. A constant leakage and a turn of the feed
are one; only the slope tells them apart, from which turns know e to some degrees. What the isolation of a usual feed
says is better known, and both count. The law of this file: blocks are taken by the filter's own equations and its own
judgement, at angles that are known.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.checks.angle_response import AngleResponse
from service.core.estimation.filtering.model.filter_model import (
    FilterSettings,
    LearnedFeed,
    PolarimeterModel,
)
from service.core.estimation.filtering.model.filter_state import RATE, Gaussian
from service.core.estimation.filtering.model.polarimeter import (
    POLARIMETER,
    WANDER,
    polarimeter_covariance,
)
from service.core.estimation.filtering.watches.polarimeter_watch import AngleBlock, PolarimeterWatch, push_block

#: behind attitude, drift and rates
_FIRST = RATE.stop
_US_PER_H = 3.6e9
#: leakage of a feed of 35 dB of isolation, one sigma of its real part
_LEAKAGE = 10.0 ** (-35.0 / 20.0) / math.sqrt(2.0)


class Leakage(NamedTuple):
    """Leakage of a feed, real part, and one standard deviation; deg, as the turn that it looks like."""

    leakage_deg: float
    sigma_deg: float


def feed_turn(blocks: Sequence[AngleBlock], polarimeter: PolarimeterModel) -> LearnedFeed | None:
    """Return what blocks tell of the feed; None where there are none, or they contradict one another.

    Parameters
    ----------
    blocks : sequence of AngleBlock
        Of quiet days and turns, ascending; their angles less those about the line of sight by the sensors.
    polarimeter : PolarimeterModel
        As the catalogue states it.
    """
    if not blocks:
        return None
    settings = FilterSettings(polarimeters=(polarimeter,))
    covariance = np.zeros((_FIRST + POLARIMETER,) * 2)
    covariance[_FIRST:, _FIRST:] = polarimeter_covariance(settings)
    gaussian, newest_us = Gaussian(np.zeros(len(covariance)), covariance), blocks[0].epoch_us
    watch = PolarimeterWatch(newest_us)
    for block in blocks:
        gaussian = _wandered(gaussian, (block.epoch_us - newest_us) / _US_PER_H, polarimeter)
        newest_us = block.epoch_us
        watch, gaussian, _ = push_block(watch, gaussian, _FIRST, block, newest_us, polarimeter)
    if watch.is_refused:
        return None
    own = slice(_FIRST, _FIRST + WANDER)
    return LearnedFeed(tuple(gaussian.mean[own].tolist()), tuple(map(tuple, gaussian.covariance[own, own].tolist())))


def feed_leakage(response: AngleResponse, turn_deg: float) -> Leakage:
    """Return the leakage by the slope of the angle on the turns of the body and by the isolation of a usual feed.

    Parameters
    ----------
    response : AngleResponse
        Response of the angle to the turns, 1 - e sin(2 d0).
    turn_deg : float, deg
        Turn of the feed, its leakage taken for a turn.
    """
    slope = math.sin(math.radians(2.0 * turn_deg))
    weight = 1.0 / _LEAKAGE**2
    if not response.is_determined:
        return Leakage(0.0, math.degrees(_LEAKAGE))
    turned = (slope / response.sigma) ** 2
    leakage = (1.0 - response.coefficient) / slope * turned / (turned + weight)
    return Leakage(math.degrees(leakage), math.degrees(1.0 / math.sqrt(turned + weight)))


def _wandered(gaussian: Gaussian, hours: float, polarimeter: PolarimeterModel) -> Gaussian:
    """Return the state after a time in which only the wander moves."""
    keep = np.ones(len(gaussian.mean))
    keep[_FIRST + WANDER] = kept = math.exp(-hours / polarimeter.wander_h)
    covariance = keep[:, None] * gaussian.covariance * keep
    covariance[_FIRST + WANDER, _FIRST + WANDER] += (1.0 - kept**2) * polarimeter.wander_deg**2
    return Gaussian(keep * gaussian.mean, covariance)
