"""Which alarm explains a value (ISA-18.2, suppression by design): fade, angle beyond its limit, lost chain or link.

What follows from a cause is recorded inside it and told nobody, as long as the cause explains its size within sigma. A
carrier's level is explained but for its residual: what neither attitude nor chain nor rain leave of it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from service.pipeline.alarms.alarm_engine import Explanation, Key
from service.pipeline.estimation.method import CarrierLevels

SITE = "receiving site"
FADE, CHAIN_LOST, CHAIN_LEVEL = ("downlink_fade", SITE), ("chain_lost", SITE), ("chain_level", SITE)
AXES = ("yaw", "roll", "pitch")
ANGLES = tuple(("attitude_angle", axis) for axis in AXES)

#: one standard deviation of what a cause does to a level, by its size: bands differ, slopes are calibrated to a tenth
_EFFECT_ERROR = 0.1
#: the same of a level of which nothing better than the nominal one is expected, dB
_NOMINAL_SIGMA_DB = 1.0
#: the paper method takes a common change of level for an angle of at most so much, deg/dB
_MISREAD_DEG_DB = 0.5
#: noise temperature of rain over that of the receiver in the dry
_RAIN_NOISE = 2.75

#: explanation of a carrier's level, and the change in dB that it explains
LevelCause = tuple[Explanation, float]


@dataclass(frozen=True, slots=True)
class RowCauses:
    """Causes at one row with their sizes; whether their alarms stand is asked of the engine."""

    stands: Callable[[Key], bool]
    fade_db: float = 0.0
    chain_db: float = 0.0
    #: greatest size of each cause since it stands, dB or deg: means of methods are slow
    greatest: Mapping[Key, float] = field(default_factory=dict)

    def after(self, fade_db: float, chain_db: float, angles_deg: Sequence[float]) -> Self:
        """Return the causes at the next row; an angle that is not known is NaN."""
        sizes = {FADE: fade_db, CHAIN_LEVEL: abs(chain_db), **dict(zip(ANGLES, angles_deg, strict=True))}
        for cause, before in self.greatest.items():
            # where the size is not known, the one before
            sizes[cause] = max(before, sizes[cause]) if self.stands(cause) or math.isnan(sizes[cause]) else sizes[cause]
        return replace(self, fade_db=fade_db, chain_db=chain_db, greatest=sizes)

    def first(self, *causes: Key) -> Explanation | None:
        """Return the first of some causes that stands."""
        return next((Explanation(cause) for cause in causes if self.stands(cause)), None)

    def angle(self) -> tuple[Key, float] | None:
        """Return the greatest angle whose alarm stands, and its size, deg."""
        beyond = [(key, self.greatest.get(key, 0.0)) for key in ANGLES if self.stands(key)]
        return max(beyond, key=lambda one: one[1], default=None)

    def of_answer(self, apart_deg: float, *lost: Key) -> Explanation | None:
        """Return what explains that answers of a method are apart or wide: a lost fix, or a change read as an angle."""
        deg_of = dict.fromkeys(ANGLES, 1.0) | {FADE: _MISREAD_DEG_DB, CHAIN_LEVEL: _MISREAD_DEG_DB}
        explaining = (key for key, share in deg_of.items() if apart_deg <= share * self.greatest.get(key, 0.0))
        return self.first(*lost, *explaining)

    def of_levels(self, levels: CarrierLevels) -> dict[str, LevelCause]:
        """Return by carrier what explains its level, and the change that it explains, dB."""
        angle = self.angle()
        if angle is None and self.first(FADE, CHAIN_LEVEL) is None:
            return {}
        change_db = levels.deviation_db - levels.residual_db
        sigmas = np.abs(levels.residual_db) / np.hypot(levels.sigma_db, _EFFECT_ERROR * change_db)
        explained = {}
        for name, change, left in zip(levels.carrier_ids, change_db.tolist(), sigmas.tolist(), strict=True):
            cause = self._greatest(change, angle)
            if cause is not None:
                explained[name] = Explanation(cause, left), change
        return explained

    def of_nominal(self, deviation_db: float) -> Explanation | None:
        """Return what explains the level of a carrier of which no more than a nominal one is known."""
        change_db = self.chain_db - self.fade_db
        cause = self._greatest(change_db, None)
        if cause is None:
            return None
        sigma_db = math.hypot(_NOMINAL_SIGMA_DB, _EFFECT_ERROR * change_db)
        return Explanation(cause, abs(deviation_db - change_db) / sigma_db)

    def _greatest(self, change_db: float, angle: tuple[Key, float] | None) -> Key | None:
        """Return the cause that makes the greatest part of a change; None where it is not the better half of it."""
        parts_db = {FADE: self.fade_db, CHAIN_LEVEL: abs(self.chain_db)}
        if angle is not None:
            parts_db[angle[0]] = abs(change_db + self.fade_db - self.chain_db)
        cause, part_db = max(
            ((cause, part) for cause, part in parts_db.items() if self.stands(cause)),
            key=lambda one: one[1],
            default=(None, 0.0),
        )
        return None if part_db < abs(change_db) / 2.0 else cause


def c_n_loss_db(cause: Key, change_db: float) -> float:
    """Return by how much a change of level lowers carrier to noise; rain brings noise of its own.

    Examples
    --------
    >>> round(c_n_loss_db(CHAIN_LEVEL, -6.0), 1), round(c_n_loss_db(FADE, -6.0), 1), c_n_loss_db(FADE, 1.0)
    (6.0, 10.9, 0.0)
    """
    loss_db = max(0.0, -change_db)
    return loss_db + rain_noise_db(loss_db) if cause == FADE else loss_db


def rain_noise_db(fade_db: float) -> float:
    """Return by how much the noise of the receiver rises in rain that fades so much."""
    return 10.0 * math.log10(1.0 + _RAIN_NOISE * (1.0 - 10.0 ** (-fade_db / 10.0)))


def with_own_level(
    explained: Mapping[str, LevelCause], stands: Callable[[Key], bool], levels: CarrierLevels
) -> dict[str, LevelCause]:
    """Return what explains residual and C/N0 of each carrier: an alarm of its own level goes before other causes."""
    own = {
        name: (Explanation(key), deviation)
        for name, deviation in zip(levels.carrier_ids, levels.deviation_db.tolist(), strict=True)
        if stands(key := ("carrier_level", name))
    }
    return {**explained, **own}
