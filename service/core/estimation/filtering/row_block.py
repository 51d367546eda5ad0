"""Rows of the filter as arrays: what goes in with each, and what is left of it.

Shapes: T rows of N carriers, n commands that nobody has reported, a state of D numbers, E of them hidden. Triples stand
in the order yaw, roll, pitch.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import BoolArray, FloatArray
from service.core.estimation.filtering.filter_model import KnownMotion
from service.core.estimation.filtering.plant import FilterModel

#: what became of a row: it moved the state, it was not newer than the state, or its numbers were lost
TAKEN, OLD, LOST = 0, 1, 2

#: why a carrier is not in use
EXCLUSIONS = ("", "manual", "frozen", "absent", "group", "step", "uplink_fade", "interference")
NOT_EXCLUDED, MANUAL, FROZEN, ABSENT, GROUP_MOVED, STEPPED, UPLINK_FADE, INTERFERENCE = range(len(EXCLUSIONS))

#: a row, and what was known of the time before it
ROW = np.dtype(
    [
        # microseconds UTC
        ("epoch_us", "i8"),
        # deg, commanded angles and those that became known after their time; deg/h, rates that torques added
        ("correction_deg", "f8", (3,)),
        ("late_correction_deg", "f8", (3,)),
        ("rate_change_deg_h", "f8", (3,)),
        # declared operations, as in `Declared`
        ("is_declared", "?"),
        ("chain_walk_db", "f8"),
        ("chain_step_db", "f8"),
        ("attitude_walk_deg", "f8", (3,)),
        ("attitude_step_deg", "f8", (3,)),
    ],
    align=True,
)
#: a carrier in a row
ROW_CARRIER = np.dtype(
    [
        # dB, measured minus reference minus harmonic, NaN = absent
        ("deviation_db", "f8"),
        # whether its reading stands still, which is why it is absent
        ("is_frozen", "?"),
        # 1 where rain over the carrier's station is reported, 0 where none is, NaN where nobody says
        ("reported_wet", "f8"),
        # declared operations, as in `Declared`
        ("is_masked", "?"),
        ("white_db", "f8"),
        ("reference_walk_db", "f8"),
        ("reference_step_db", "f8"),
        # by which the carriers of its transponder may have moved together
        ("group_step_db", "f8"),
    ],
    align=True,
)
#: what is left of a row
RESULT = np.dtype(
    [
        # `TAKEN`, `OLD` or `LOST`; cause of a common change, 0 = none; whether something was found or declared
        ("status", "i8"),
        ("cause", "i8"),
        ("has_event", "?"),
        # what the update raised rain below zero by, dB, over its variance after it, dB^2
        ("rain_push_1_db", "f8"),
        # levels that the error passes with a probability of 1e-4, NaN = not known, and those if nothing were wrong with
        # any carrier; loss by two hours without control
        ("protection_deg", "f8", (3,)),
        ("nominal_deg", "f8", (3,)),
        ("waiting_loss_deg", "f8", (3,)),
        # bits of `REASONS`
        ("reasons", "i8"),
        ("is_yaw_allowed", "?"),
        ("is_realignment_advised", "?"),
        # as `sensor_records.motion_advice` has it
        ("motion_advice", "i8"),
        # yaw, roll, pitch after it, their sigmas, and the rates that attitude, drift and commanded rate imply
        ("attitude_deg", "f8", (3,)),
        ("sigma_deg", "f8", (3,)),
        ("rates_deg_s", "f8", (3,)),
        ("carriers_used", "i8"),
        # root mean square of the residuals of the carriers used, NaN = none
        ("residual_rms_db", "f8"),
        ("rain_db", "f8"),
        ("is_raining", "?"),
        # what all carriers have in common, without rain
        ("common_db", "f8"),
        # whether a torque shows itself, as motion of an axis or among the states, and the one that is not fed forward,
        # as `write_wave` has it, zero without states
        ("is_torque_shown", "?"),
        ("torque_deg_h2", "f8", (4, 3)),
        # logarithm of the likelihood of "no effect" or "reversed" over that of commands that are carried out
        ("missed_log_ratio", "f8"),
    ],
    align=True,
)
#: what is left of a carrier
RESULT_CARRIER = np.dtype(
    [
        # dB, measured minus predicted, NaN = absent or flagged
        ("innovation_db", "f8"),
        # dB, measured minus what attitude, chain, rain and common parts explain; NaN = absent
        ("residual_db", "f8"),
        ("is_used", "?"),
        # place in `EXCLUSIONS`
        ("exclusion", "i8"),
        # likeliest of the hypotheses from 1 on, 0 before an answer
        ("hypothesis", "i8"),
    ],
    align=True,
)
#: what a record of a sensor of motion tells
WHEELS, ANGLE, BODY_RATE = 0, 1, 2
#: a record of a sensor of motion, due before a row
RECORD = np.dtype(
    [
        # number of the row in its block; `WHEELS`, `ANGLE` or `BODY_RATE`; number of the polarimeter
        ("row", "i8"),
        ("kind", "i8"),
        ("feed", "i8"),
        ("epoch_us", "i8"),
        # momentum of the wheels along roll, pitch, yaw; whether they unload, and whether none can hold as much
        ("momentum_n_m_s", "f8", (3,)),
        ("is_unloading", "?"),
        ("is_impossible", "?"),
        # some minutes of a polarimeter, as in `AngleBlock`
        ("angle_deg", "f8"),
        ("variance_deg2", "f8"),
        ("co_power_dbm", "f8"),
        # about yaw, roll and pitch, pitch without the turn of the orbit
        ("rate_deg_h", "f8", (3,)),
    ],
    align=True,
)


class Declared(NamedTuple):
    """Effect of the declared operations on one step: they explain a change or mask carriers for a while.

    One-time values belong to the first row at or after the instant they are declared for.
    """

    #: (N,) carriers that are not to be used
    is_masked: BoolArray
    #: (N,) dB, white noise in addition
    white_db: FloatArray
    #: (N,) dB/sqrt(h), walk of the references in addition
    reference_walk_db: FloatArray
    #: dB/sqrt(h), walk of the receiving chain in addition
    chain_walk_db: float
    #: (3,) deg/sqrt(h), walk of the attitude in addition
    attitude_walk_deg: FloatArray
    #: (N,) dB, one time: each reference may have moved by this on its own
    reference_step_db: FloatArray
    #: (G,) dB, one time: the references of each transponder may have moved together by this
    group_step_db: FloatArray
    #: dB, one time: the receiving chain may have moved by this
    chain_step_db: float
    #: (3,) deg, one time: the attitude may have moved by this
    attitude_step_deg: FloatArray


def nothing_declared(carriers: int, transponders: int) -> Declared:
    """Return the effect of no operation.

    Parameters
    ----------
    carriers, transponders : int
        N and G.
    """
    none, still = np.zeros(carriers), np.zeros(3)
    return Declared(
        np.zeros(carriers, dtype=np.bool_), none, none, 0.0, still, none, np.zeros(transponders), 0.0, still
    )


class RowBlock(NamedTuple):
    """Rows in order."""

    #: (T,) of `ROW` and (T, N) of `ROW_CARRIER`
    rows: NDArray[np.void]
    carriers: NDArray[np.void]
    #: (T, n, 2, 3) turns of unreported commands if executed, deg, and their rates at the end, deg/h
    unreported: FloatArray
    #: (M,) of `RECORD`, by kind and epoch
    records: NDArray[np.void]


class BlockResult(NamedTuple):
    """Results of rows."""

    #: (T,) of `RESULT` and (T, N) of `RESULT_CARRIER`
    rows: NDArray[np.void]
    carriers: NDArray[np.void]


class RowTrace(NamedTuple):
    """Step and update of a row as they acted, for who goes back over the rows; empty where nobody asks."""

    #: (D,) by which each number decayed, and (12, 9 + E) how attitude, drift, rate and momentum moved
    factor: FloatArray
    transition: FloatArray
    #: (n, 2 D + 1) whitened by the covariance of the innovations, L L': L^-1 H, L^-1 H P and L^-1 nu, linearised where
    #: they led; rows of NaN where there was none
    update: FloatArray
    #: (M, 3, 2 D + 1) the records before it in the same form, and (M + 1, D) the states that began again at each, and
    #: at the rate of the body, which is the last
    record_updates: FloatArray
    is_restarted: BoolArray


def empty_block(rows: int, carriers: int, shares: int = 0) -> RowBlock:
    """Return rows without readings, of which nothing is known."""
    block = RowBlock(
        np.zeros(rows, ROW),
        np.zeros((rows, carriers), ROW_CARRIER),
        np.zeros((rows, shares, 2, 3)),
        np.zeros(0, RECORD),
    )
    block.carriers["deviation_db"] = block.carriers["reported_wet"] = np.nan
    return block


def write_known(block: RowBlock, number: int, known: KnownMotion) -> None:
    """Write what was commanded before a row."""
    row = block.rows[number]
    row["correction_deg"], row["late_correction_deg"] = known.correction_deg, known.late_correction_deg
    row["rate_change_deg_h"] = known.rate_change_deg_h
    block.unreported[number] = known.unreported


def write_declared(model: FilterModel, block: RowBlock, number: int, declared: Declared) -> None:
    """Write what was declared about the time before a row."""
    row, carriers = block.rows[number], block.carriers[number]
    row["is_declared"] = True
    for name in ("chain_walk_db", "chain_step_db", "attitude_walk_deg", "attitude_step_deg"):
        row[name] = getattr(declared, name)
    for name in ("is_masked", "white_db", "reference_walk_db", "reference_step_db"):
        carriers[name] = getattr(declared, name)
    carriers["group_step_db"] = declared.group_step_db[model.carriers["transponder"]]


def empty_result(rows: int, carriers: int) -> BlockResult:
    """Return room for what is left of rows."""
    return BlockResult(np.zeros(rows, RESULT), np.zeros((rows, carriers), RESULT_CARRIER))


def empty_trace(states: int, hidden: int, carriers: int, records: int = 0) -> RowTrace:
    """Return room for the trace of a row that some records precede, none where all are zero."""
    return RowTrace(
        np.ones(states),
        np.zeros((12, 9 + hidden) if states else (0, 0)),
        np.full((carriers, 2 * states + 1), np.nan),
        np.full((records, 3, 2 * states + 1), np.nan),
        np.zeros((records + 1, states), dtype=np.bool_),
    )
