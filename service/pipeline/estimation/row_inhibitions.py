"""Inhibitions of control by a row, and the disagreement of both methods."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from service.pipeline.config import InterlockConfig, RobustConfig
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow, Status


@dataclass(frozen=True)
class Disagreement:
    """The methods as they were compared last."""

    #: since when they have been apart, None while they are not
    since_us: int | None = None
    #: whether they have been apart for long enough
    is_standing: bool = False
    #: by how much, 0 unless it stands; NaN: the newest row compares nothing
    apart_deg: float = math.nan


def compare(watch: Disagreement, rows: Sequence[AttitudeRow], config: RobustConfig) -> Disagreement:
    """Return the watch after the rows of one measurement; a row without angles says nothing."""
    reported = [row for row in rows if row.status is Status.ACQUIRED]
    if len(reported) < 2:
        return watch if math.isnan(watch.apart_deg) else replace(watch, apart_deg=math.nan)
    one, other = reported[0].attitude_deg, reported[1].attitude_deg
    apart_deg = max(abs(one.roll - other.roll), abs(one.pitch - other.pitch))
    if not apart_deg > config.disagreement_deg:
        return Disagreement(apart_deg=0.0)
    since_us = reported[0].epoch_us if watch.since_us is None else watch.since_us
    is_standing = reported[0].epoch_us - since_us >= config.disagreement_s * US_PER_S
    return Disagreement(since_us, is_standing, apart_deg if is_standing else 0.0)


#: reasons in the order in which they are listed, with what each one says
INHIBITIONS: dict[str, str] = {
    "no_calibration": "no calibration serves this method",
    "not_aligned": "no alignment was made with this calibration",
    "late": "the row came late or out of order; its fix stands alone",
    "catch_up": "rows stored before are worked off: after an alignment, or while a restarted chain is brought back",
    "settling": "fewer rows than the mean needs since the alignment or the last gap",
    "no_fix": "too few carriers present for an attitude",
    "redundancy": "too few carriers beyond the unknowns to detect a wrong one",
    "downlink_fade": "rain on the downlink or a change of the receiving chain could appear as attitude",
    "common_change": "all levels have risen alike, which looks like attitude: the gain of the receiving chain or the "
    "powers of all users changed; look at the receiving chain, and align again if the change stays",
    "chain_step": "the level of all carriers has just changed; the gain of the receiving chain is estimated again",
    "innovations": "the powers contradict the model more than its noise allows",
    "unannounced_motion": "roll or pitch moves without an announced cause",
    "no_ephemeris": "no ephemeris covers this epoch, so the daily change is unknown",
    "beyond_validity": "roll or pitch lies beyond the range in which the model holds",
    "sigma_roll": "the roll estimate is too uncertain",
    "sigma_pitch": "the pitch estimate is too uncertain",
    "integrity_unmonitored": "no protection level of roll and pitch is known: the references of the alignment have not "
    "been asked for half an hour",
    "protection_level": "the error of roll or pitch could be greater than the alert limit",
    "operation": "a declared operation forbids control",
    "undeclared_operation": "telemetry says that thrusters act, and no operation is declared that explains it",
    "smoothed": "the row is about the past: later rows are in it, and it never drives control",
    "internal_error": "the computation of this row failed; the service log says where",
}
#: reasons under which the torque and the rates known from the hours before are balanced on: they doubt the angles of
#: the present, not what was learned before them
BALANCED = frozenset(
    {
        *("no_fix", "redundancy", "downlink_fade", "chain_step", "sigma_roll", "sigma_pitch"),
        *("integrity_unmonitored", "protection_level", "undeclared_operation"),
    }
)


def judge(
    angles_deg: Sequence[float], carriers_used: int, conditions: Mapping[str, bool], config: InterlockConfig
) -> tuple[str, ...]:
    """Return what a fix of the paper method, yaw, roll and pitch by some carriers, and its row inhibit control for.

    `conditions` says which of `INHIBITIONS` stand beside the fix.
    """
    standing = {reason for reason, stands in conditions.items() if stands}
    standing |= _of_fix(angles_deg, carriers_used, config)
    return tuple(sorted(standing, key=tuple(INHIBITIONS).index)) if standing else ()


def _of_fix(angles_deg: Sequence[float], carriers_used: int, config: InterlockConfig) -> set[str]:
    """Return the reasons that lie in the fix itself."""
    _, roll_deg, pitch_deg = angles_deg
    if not all(map(math.isfinite, angles_deg)):
        return {"no_fix"}
    conditions = {
        "redundancy": carriers_used - 3 < config.min_redundancy,
        "beyond_validity": max(abs(roll_deg), abs(pitch_deg)) > config.model_range_deg,
    }
    return {reason for reason, stands in conditions.items() if stands}
